from pathlib import Path

import pytest

from footfall.messages.clock import Clock
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.log_timeline import Tick, ticks
from footfall.messages.score import Score
from footfall.messages.topics import CLOCK, SCORE

MS = 1_000_000


def score(n: int) -> Score:
    return Score(n, n, 0, 0, 0.0, 0.0, 0.0, 0)


class Script:
    """Writes a log as a sequence of sendings, 10 ms of wall time apart unless said otherwise."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.writer = LogWriter(path, chunk_bytes=300)
        self.sent = 0
        self.count = 0

    def tick(self, step: int, paused: bool = False, after: int = 10) -> None:
        self.sent += after * MS
        message = Clock(step, 100 * MS, "realtime", paused)
        self.writer.write_message(CLOCK, "simulator", step, step * 100 * MS, self.sent, message)

    def score(self, stamp: int, after: int = 10) -> None:
        self.sent += after * MS
        self.writer.write_message(
            SCORE, "referee", self.count, stamp * 100 * MS, self.sent, score(self.count)
        )
        self.count += 1

    def read(self, topics=("score",), **options) -> list[Tick]:
        self.writer.close()
        return list(ticks(LogReader(self.path), topics, **options))


@pytest.fixture
def script(tmp_path):
    return Script(tmp_path / "a.mcap")


def shape(timeline: list[Tick]) -> list[tuple[int, list[int]]]:
    """Step and the numbers of the messages before it."""
    return [(tick.step, [item.sequence for item in tick.messages]) for tick in timeline]


def test_messages_come_before_the_tick_they_were_sent_before(script):
    """A late message, stamped 0 and sent after tick 2, stays behind tick 2."""
    script.score(0)
    script.tick(0)
    script.tick(1)
    script.score(1)
    script.tick(2)
    script.score(0)
    script.tick(3)
    script.score(3)
    timeline = script.read()
    assert shape(timeline) == [(0, [0]), (1, []), (2, [1]), (3, [2]), (3, [3])]
    assert [tick.stamp_ns for tick in timeline] == [0, 100 * MS, 200 * MS, 300 * MS, 300 * MS]
    assert [tick.repeats for tick in timeline] == [False] * 4 + [True]


def test_places_between_ticks(script):
    script.tick(0)
    script.score(0, after=30)
    script.score(0, after=30)
    script.tick(1, after=40)
    assert script.read()[1].places == pytest.approx([0.3, 0.6])


def test_standing_still_is_not_a_tick(script):
    script.tick(0)
    script.tick(0, paused=True)
    script.score(0)
    script.tick(1)
    assert shape(script.read()) == [(0, []), (1, [0])]


def test_start_and_end(script):
    for step in range(10):
        script.score(max(0, step - 3))
        script.tick(step)
    assert shape(script.read(start_ns=400 * MS, end_ns=600 * MS)) == [(4, [4]), (5, [5])]
    assert script.read(start_ns=5_000 * MS) == []


def test_a_jump_back_is_played_as_it_was(script):
    for step in (0, 1, 2, 1, 2):
        script.score(step)
        script.tick(step)
    assert shape(script.read()) == [(0, [0]), (1, [1]), (2, [2]), (1, [3]), (2, [4])]


def test_without_a_clock_stamps_make_the_ticks(script):
    for stamp in (0, 0, 2, 5):
        script.score(stamp)
    timeline = script.read()
    assert shape(timeline) == [(0, [0, 1]), (1, [2]), (2, [3])]
    assert [tick.step_ns for tick in timeline] == [0, 200 * MS, 300 * MS]


def test_nothing_to_play(script):
    script.tick(0)
    assert shape(script.read(topics=())) == [(0, [])]
