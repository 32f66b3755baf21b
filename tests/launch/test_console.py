"""The status line, and counts added up over restarts."""

import sys
from io import StringIO

import pytest

from footfall.launch.console import Console, status_text
from footfall.launch.summary import Counts
from footfall.messages.diagnostics import Diagnostics, InputStats, OutputStats


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def test_status_tells_time_left() -> None:
    assert status_text(12.34, 4.06, 18, 2, 20.0) == (
        "12.3 s simulated, 4.1x real time, 18 agents, 2 dropped, 2 s left"
    )
    assert status_text(10.0, 0.5, None, 0, 100.0) == (
        "10.0 s simulated, 0.5x real time, 0 dropped, 3 min 0 s left"
    )
    assert status_text(1.0, 1.0, None, 0, None) == "1.0 s simulated, 1.0x real time, 0 dropped"


def test_lines_stay_above_the_status_line(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    console = Console()
    assert console.wants_status
    console.status("3 s")
    assert not console.wants_status
    console.say("a warning")
    console.clear()
    assert terminal.getvalue() == "\r\x1b[K3 s\r\x1b[Ka warning\n3 s\r\x1b[K"


def test_quiet_shows_only_what_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    console = Console(quiet=True)
    console.say("chatter")
    console.say("an error", important=True)
    assert terminal.getvalue() == "an error\n"
    assert not console.wants_status


def report(pid: int, received: int, dropped: int, sent: int) -> Diagnostics:
    wire = InputStats("plans", "planner", received, dropped, 1, 0, None)
    return Diagnostics("a", pid, 1, 0.0, 0.0, 0.0, 0, [wire], [OutputStats("agents", sent, 10, 1)])


def test_counts_add_lives_and_replace_reports() -> None:
    counts = Counts()
    for message in (report(1, 5, 0, 7), report(1, 9, 2, 8), report(2, 3, 1, 4)):
        counts.take(message)
    plans, agents = counts.topics()["plans"], counts.topics()["agents"]
    assert (plans.received, plans.dropped, plans.skipped) == ({"a": 12}, 3, 2)
    assert (agents.sent, agents.bytes, agents.refused) == (12, 20, 2)
    assert counts.dropped == 5
