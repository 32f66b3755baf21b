"""A node that hangs is found, leaves its stacks behind, and its restart policy decides."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from footfall.launch.check import check
from footfall.launch.vital_signs import VitalSigns, innermost_frame, waited_for_processor
from footfall.launch.wiring import complete, with_recorder
from footfall.messages.config import ConfigError
from footfall.messages.graph import ClockSpec, Graph, Input, NodeSpec, Restart, patience
from footfall.messages.topics import TOPICS

FOLDER = Path(__file__).parent / "little"


def with_watchdog(tmp_path: Path, more: str = "watchdog: 1.5") -> str:
    own = tmp_path / "own.yaml"
    own.write_text(f"include: [{FOLDER}/little.yaml]\nnodes: {{echoer: {{{more}}}}}")
    return str(own)


def alone(node: NodeSpec, mode: str = "realtime") -> Graph:
    clock = NodeSpec("sim", "m", outputs={"clock": "clock", "agents": "agents"})
    return Graph("g", [clock, node], clock=ClockSpec(mode, timeout=20.0))  # type: ignore[arg-type]


def test_patience() -> None:
    node = NodeSpec("a", "m", outputs={"plans": "plans"})
    assert patience(alone(node), node) == 10.0
    assert patience(alone(node, "lockstep"), node) == 18.0  # before the clock gives up
    slow = NodeSpec("b", "m", {"plans": Input("plans", "reliable", 1, timeout=30.0)})
    graph = alone(node)
    graph.nodes.append(slow)
    assert patience(graph, node) == 60.0  # it may have to wait twice for its subscriber
    assert patience(graph, slow) == 10.0
    for given, expected in ((0.0, float("inf")), (3.0, 3.0)):
        given_node = NodeSpec("a", "m", watchdog=given)
        assert patience(alone(given_node), given_node) == expected
    recorded = with_recorder(complete(alone(node)), {"path": "x.mcap"})
    assert patience(recorded, recorded.node("recorder")) == 60.0


def test_only_who_has_spoken_can_fall_silent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    now = 100.0
    monkeypatch.setattr("footfall.launch.vital_signs.monotonic", lambda: now)
    signs = VitalSigns(alone(NodeSpec("a", "m", watchdog=3.0)), lambda name: None)

    def look_for(seconds: float) -> list[tuple[str, signal.Signals]]:
        nonlocal now
        found = []
        for _ in range(round(seconds * 10)):
            now += 0.1
            found += signs.hanging({"a"})
        return found

    assert look_for(5.0) == []
    signs.heard("a")
    assert look_for(2.9) == []
    now += 100.0  # the launcher itself was held up: that counts as a quarter of a second
    assert look_for(0.1) == [("a", signal.SIGABRT)]
    assert look_for(1.9) == []
    assert look_for(5.0) == [("a", signal.SIGKILL)]
    assert signs.died("a", tmp_path / "none") == "hung, no sign of life for 3 s"
    assert signs.died("a", tmp_path / "none") is None
    assert look_for(5.0) == []  # the next life is only starting


def test_who_waits_for_a_processor_does_not_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    now, waited = 100.0, 7.0
    monkeypatch.setattr("footfall.launch.vital_signs.monotonic", lambda: now)
    monkeypatch.setattr("footfall.launch.vital_signs.waited_for_processor", lambda pid: waited)
    signs = VitalSigns(alone(NodeSpec("a", "m", watchdog=3.0)), lambda name: 1)
    signs.heard("a")
    for _ in range(100):  # ten seconds, of which nine on the run queue
        now, waited = now + 0.1, waited + 0.09
        assert list(signs.hanging({"a"})) == []
    found = []
    for _ in range(25):
        now += 0.1
        found += signs.hanging({"a"})
    assert found == [("a", signal.SIGABRT)]


def test_the_kernel_tells_who_waited() -> None:
    assert waited_for_processor(os.getpid()) > 0.0
    assert waited_for_processor(None) == 0.0


def test_the_innermost_frame_is_that_of_the_last_dump(tmp_path: Path) -> None:
    path = tmp_path / "a.out"
    assert innermost_frame(path) is None
    path.write_text("hello\n")
    assert innermost_frame(path) is None
    dump = (
        'Fatal Python error: Aborted\n\nThread 0x01 (most recent call first):\n  File "/x/zmq_bus.py", line 9'
        ' in drain\n\nCurrent thread 0x02 (most recent call first):\n  File "/x/{}.py", line 5 in step\n'
        '  File "/x/spin.py", line 7 in run\n'
    )
    path.write_text(dump.format("old") + dump.format("new"))
    assert innermost_frame(path) == "new.py:5 (step)"


def test_the_owner_of_the_clock_cannot_be_restarted() -> None:
    clock = NodeSpec("sim", "footfall.nodes.simulator", outputs={"clock": "clock"}, restart=Restart("always"))
    with pytest.raises(ConfigError, match="node sim owns the clock, and with it time would begin anew"):
        check(complete(Graph("g", [clock])), TOPICS)


@pytest.mark.slow
def test_a_hanging_node_is_ended_and_leaves_its_stacks(launch: Callable, tmp_path: Path) -> None:
    own = with_watchdog(tmp_path)
    run = launch(own, "--mode", "realtime", "--json", "--set", "at=10", "--set", "how=hang")
    summary = run.summary()
    assert run.process.returncode == 1
    failure = summary["first_failure"]
    assert (failure["node"], failure["ended"]) == ("echoer", "killed by SIGABRT")
    assert "hung, no sign of life for 1.5 s in echoer.py:" in failure["reason"]
    assert "(_misbehave)" in failure["reason"]
    stacks = (Path(summary["run_dir"]) / "log" / "echoer.out").read_text()
    assert "in _misbehave" in stacks and "in step" in stacks and "in run_process" in stacks
    run.gone_within(1.0)


@pytest.mark.slow
def test_in_lockstep_the_hanging_node_is_named_and_not_the_clock(launch: Callable, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(f"include: [{FOLDER}/little.yaml]\nclock: {{timeout: 3}}")
    summary = launch(str(own), "--json", "--set", "at=10", "--set", "how=hang").summary()
    assert summary["first_failure"]["node"] == "echoer"
    assert "hung, no sign of life for 2.7 s in echoer.py:" in summary["first_failure"]["reason"]


@pytest.mark.slow
def test_a_node_that_is_stopped_altogether_is_killed_and_restarted(launch: Callable, tmp_path: Path) -> None:
    own = with_watchdog(tmp_path, "watchdog: 1.5, restart: on-failure")
    run = launch(own, "--mode", "realtime", "--duration", "12", "--json")
    (pid,) = run.wait_for("-m echoer")
    run.wait_until_running()
    os.kill(pid, signal.SIGSTOP)
    summary = run.summary()
    assert summary["restarts"] == {"echoer": 1}
    assert summary["first_failure"] is None
    assert summary["sim_seconds"] == 12.0


@pytest.mark.slow
def test_without_a_watchdog_a_node_may_take_its_time(launch: Callable, tmp_path: Path) -> None:
    own = with_watchdog(tmp_path, "watchdog: 0")
    arguments = ("--set", "at=10", "--set", "how=hang", "--duration", "6")
    summary = launch(own, "--mode", "realtime", "--json", *arguments).summary()
    assert summary["first_failure"] is None
    assert summary["sim_seconds"] == 6.0
