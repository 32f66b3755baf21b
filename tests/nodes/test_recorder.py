import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep

import msgspec
import numpy as np
import pytest
import zmq

from footfall.messages.body import BodyStates
from footfall.messages.clock import Clock
from footfall.messages.codec import Header
from footfall.messages.graph import Graph, Input, NodeSpec
from footfall.messages.link import Failed, Go, Ready, Stop, decode_line, encode_line, link_address
from footfall.messages.log import LogError, LogReader
from footfall.messages.map import SemanticMap
from footfall.messages.schema import schema_hash
from footfall.messages.score import Score
from footfall.messages.topics import BODY_STATES, CLOCK, MAP, SCORE
from footfall.messages.zmq_bus import ZmqBus
from footfall.nodes.recorder import Config, Recorder

TOPICS = (CLOCK, BODY_STATES, SCORE, MAP)
A_MAP = SemanticMap("yard", ["walkable"], np.ones((1, 90, 50), np.uint8), 0.1, (0.0, 0.0))
JOINTS = np.random.default_rng(1).normal(size=(30, 24, 13)).astype(np.float32)


def score(n: int) -> Score:
    return Score(n, n, 0, 0, 0.0, 0.0, 0.0, 0)


class RecorderRun:
    """A graph of this process, which publishes, and a recorder process; also plays its launcher."""

    def __init__(self, folder: Path, **config: object) -> None:
        names = {topic.name: topic.name for topic in TOPICS}
        inputs = {name: Input(name, "reliable", 1000) for name in names}
        own = {name: name for name in ("diagnostics", "log")}
        self.path = folder / "run.mcap"
        recorder = NodeSpec(
            "recorder",
            "footfall.nodes.recorder",
            inputs,
            own,
            config={"path": str(self.path), **config},
            lockstep=False,
        )
        graph = Graph("test", [NodeSpec("source", "x", {}, names), recorder], str(folder), seed=5)
        (folder / "graph.json").write_bytes(msgspec.json.encode(graph))
        self.context = zmq.Context()
        self.router = self.context.socket(zmq.ROUTER)
        self.router.bind(link_address(str(folder)))
        self.bus = ZmqBus(graph, "source")
        arguments = ["-m", recorder.module, "--graph", str(folder / "graph.json"), "--node", "recorder"]
        self.process = subprocess.Popen([sys.executable, *arguments], stderr=subprocess.PIPE, text=True)

    def start(self) -> None:
        assert self.bus.wait_connected(15) == []
        identity, line = self.receive()
        assert isinstance(line, Ready), line
        self.router.send_multipart([identity, encode_line(Go())])

    def receive(self) -> tuple[bytes, object]:
        assert self.router.poll(15_000), "the recorder says nothing"
        identity, data = self.router.recv_multipart()
        return identity, decode_line(data)

    def say(self, line: Stop) -> None:
        self.router.send_multipart([b"recorder", encode_line(line)])

    def publish(self, count: int, first: int = 0) -> None:
        """A clock of 1 kHz, joint states with it at 100 Hz, a score at 10 Hz."""
        for n in range(first, first + count):
            stamp = n * 1_000_000
            self.bus.publish(CLOCK, Clock(n, 1_000_000, "free"), stamp)
            if n % 10 == 0:
                self.bus.publish(BODY_STATES, BodyStates(np.arange(30, dtype=np.int32), JOINTS + n), stamp)
            if n % 100 == 0:
                self.bus.publish(SCORE, score(n), stamp)
        self.bus.poll(0)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        assert self.process.stderr
        self.process.stderr.close()
        self.bus.close()
        self.router.close(0)
        self.context.term()


@pytest.fixture
def run(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[RecorderRun]:
    run = RecorderRun(tmp_path, **getattr(request, "param", {}))
    yield run
    run.close()


@pytest.mark.slow
def test_everything_sent_is_in_the_log(run):
    run.bus.publish(MAP, A_MAP, 0)
    run.start()
    run.publish(3000)
    run.say(Stop())
    assert run.process.wait(15) == 0
    reader = LogReader(run.path)
    counts = {reader.index.channels[id].source: n for id, n in reader.index.counts.items()}
    assert counts.pop("log@recorder", 0) >= 0 and counts.pop("diagnostics@recorder", 0) >= 0
    assert counts == {"clock@source": 3000, "body_states@source": 300, "score@source": 30, "map@source": 1}
    assert reader.index.complete
    states = list(reader.read(BODY_STATES))
    np.testing.assert_array_equal(states[7].message.joints, JOINTS + 70)
    assert [m.sequence for m in reader.read(CLOCK)] == list(range(3000))
    assert reader.graph and reader.graph.seed == 5
    assert "msgspec" in reader.versions
    lines = (run.path.parent / "log" / "recorder.jsonl").read_text()
    assert "body_states@source: 300 received, 300 written, 0 lost" in lines


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_signal_finishes_the_log(run, number):
    run.start()
    run.publish(500)
    run.process.send_signal(number)
    assert run.process.wait(15) == 0
    reader = LogReader(run.path)
    assert reader.index.complete
    assert sum(1 for _ in reader.read(CLOCK)) == 500


@pytest.mark.slow
def test_killed_recorder_loses_the_last_second_only(run):
    """SIGKILL while messages stream in, at a tempo at which chunks are closed by time alone."""
    run.start()
    sent: list[tuple[float, int]] = []
    begin = monotonic()
    while monotonic() - begin < 3.0:
        n = len(sent)
        run.bus.publish(CLOCK, Clock(n, 1, "free"), n)
        if n % 50 == 0:
            run.bus.publish(SCORE, score(n), n)
        sent.append((monotonic(), n))
        sleep(0.002)
    os.kill(run.process.pid, signal.SIGKILL)
    killed = monotonic()
    run.process.wait()
    reader = LogReader(run.path)
    assert not reader.index.complete
    safe = [n for time, n in sent if time < killed - 1.3]
    assert len(safe) > 100
    clocks = [m.sequence for m in reader.read(CLOCK)]
    assert clocks == list(range(len(clocks))) and len(clocks) >= len(safe)
    scores = [m.message.entered for m in reader.read(SCORE)]
    assert set(scores) >= {n for n in safe if n % 50 == 0}


@pytest.mark.slow
@pytest.mark.parametrize("run", [{"quota": 0.5}], indirect=True)
def test_a_full_disk_stops_recording_but_not_the_graph(run):
    run.start()
    run.publish(2000)
    begin = monotonic()
    run.publish(2000, first=2000)
    assert monotonic() - begin < 4.0  # nobody waits for the recorder
    run.say(Stop())
    assert run.process.wait(15) == 0
    reader = LogReader(run.path)
    assert reader.index.complete and 10 < reader.message_count < 4000
    assert run.path.stat().st_size < 600_000
    lines = (run.path.parent / "log" / "recorder.jsonl").read_text()
    assert "the quota of 500000 bytes is reached; recording has stopped" in lines


@pytest.mark.slow
@pytest.mark.parametrize("run", [{"quota": 0.5, "strict": True}], indirect=True)
def test_strict_ends_in_failure(run):
    run.start()
    run.publish(2000)
    _, line = run.receive()
    assert isinstance(line, Failed) and "quota" in line.reason
    assert run.process.wait(15) == 1
    assert LogReader(run.path).index.complete


@pytest.mark.slow
def test_existing_log_is_the_users_fault(tmp_path):
    (tmp_path / "run.mcap").write_text("precious")
    run = RecorderRun(tmp_path)
    try:
        _, line = run.receive()
        assert isinstance(line, Failed) and line.usage and "exists already" in line.reason
        assert run.process.wait(15) == 2
        assert (tmp_path / "run.mcap").read_text() == "precious"
    finally:
        run.close()


def record_directly(recorder: Recorder, ticks: range) -> None:
    for n in ticks:
        header = Header(n, n * 1_000_000, n, schema_hash(Clock), 0)
        recorder.write(CLOCK, "source", header, msgspec.msgpack.encode(Clock(n, 1, "free")))


def test_splits_repeat_latched_messages(tmp_path):
    config = Config(str(tmp_path / "run.mcap"), split_duration=0.1)
    recorder = Recorder(config, Graph("test", []))
    record = msgspec.msgpack.encode(score(1))
    recorder.write(SCORE, "referee", Header(4, 0, 3, schema_hash(Score), 0), record)
    record_directly(recorder, range(250))
    recorder.close()
    assert [path.name for path in recorder.paths] == ["run.000.mcap", "run.001.mcap", "run.002.mcap"]
    for number, path in enumerate(recorder.paths):
        reader = LogReader(path)
        found = list(reader.read(SCORE))
        assert [m.sequence for m in found] == [4] and found[0].message == score(1)
        wanted = {"score@referee": 4} | ({"clock@source": 100 * number - 1} if number else {})
        assert reader.repeated == ({} if number == 0 else wanted)
    clocks = [[m.sequence for m in LogReader(path).read(CLOCK)] for path in recorder.paths]
    assert clocks == [list(range(100)), list(range(99, 200)), list(range(199, 250))]
    assert recorder.written == {"score@referee": 1, "clock@source": 250}


def test_split_by_size(tmp_path):
    config = Config(str(tmp_path / "run.mcap"), split_size=0.02, chunk_size=1)
    recorder = Recorder(config, Graph("test", []))
    record_directly(recorder, range(3000))
    recorder.close()
    assert len(recorder.paths) > 1
    readers = [LogReader(path) for path in recorder.paths]
    seen = {m.sequence for reader in readers for m in reader.read(CLOCK)}
    assert seen == set(range(3000))
    assert recorder.size == sum(path.stat().st_size for path in recorder.paths)


def test_quota_counts_what_is_lost(tmp_path):
    config = Config(str(tmp_path / "run.mcap"), quota=0.02, chunk_size=1)
    recorder = Recorder(config, Graph("test", []))
    record_directly(recorder, range(3000))
    assert recorder.full
    recorder.tick()
    recorder.close()
    count = LogReader(recorder.paths[0]).message_count
    assert recorder.written["clock@source"] == count > 100
    assert recorder.unwritten["clock@source"] == recorder.lost == 3000 - count


def test_no_room_for_the_next_split(tmp_path):
    config = Config(str(tmp_path / "run.mcap"), split_duration=0.1, quota=0.009, chunk_size=1)
    recorder = Recorder(config, Graph("test", []))
    record_directly(recorder, range(1000))
    assert recorder.full and recorder.lost > 0
    recorder.close()
    counts = [LogReader(path).message_count for path in recorder.paths]
    assert sum(counts) >= recorder.written["clock@source"] == 1000 - recorder.lost > 0


def test_existing_log(tmp_path):
    (tmp_path / "run.mcap").touch()
    with pytest.raises(LogError, match="exists already"):
        Recorder(Config(str(tmp_path / "run.mcap")), Graph("test", []))
