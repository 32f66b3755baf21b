"""A steered run, replayed: the recorded commands bring about the same again."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from footfall.launch.running import find_graph
from footfall.messages.config import ConfigError
from footfall.messages.link import Steer
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.objectives import TargetSpeed, Waypoint
from footfall.messages.steering import DropObstacle, SetSpeed, SetWaypoint, Steering
from footfall.messages.topics import MAP, OBJECTIVES, STEERING
from footfall.tools.cli import main
from footfall.tools.control import ask

pytestmark = pytest.mark.slow
COMMANDS = (
    SetWaypoint(0, (1.5, 0.5)),
    SetSpeed(1, 0.6),
    DropObstacle("crate", [(0.0, 0.0), (0.4, 0.0), (0.4, 0.4), (0.0, 0.4)]),
)


@pytest.fixture(scope="module")
def steered(tmp_path_factory) -> Path:
    """A log of a run that was steered while it ran."""
    folder = tmp_path_factory.mktemp("steered")
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "footfall.tools.cli", "launch", "corridor", "--set", "count=3"),
            *("--duration", "8", "--rate", "1", "--record", "run.mcap", "--run-dir", str(folder / "r")),
        ],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 90
        left = list(COMMANDS)
        while left:
            try:
                ask(find_graph(str(folder / "r")), Steer(left[0]))
                left.pop(0)
            except ConfigError:  # not there yet
                assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.3)
        assert process.wait(120) == 0
    finally:
        process.kill()
    return folder / "run.mcap"


def test_commands_are_recorded_and_obeyed(steered):
    reader = LogReader(steered)
    assert [item.message.command for item in reader.read(STEERING)] == list(COMMANDS)
    wishes = {a.id: a.objectives for item in reader.read(OBJECTIVES) for a in item.message.agents}
    every = [w for item in reader.read(OBJECTIVES) for a in item.message.agents for w in a.objectives]
    assert any(isinstance(w, Waypoint) and w.position == (1.5, 0.5) for w in every)
    assert any(isinstance(w, TargetSpeed) and w.speed == 0.6 for w in wishes[1])
    assert "crate" in {o.name for o in list(reader.read(MAP))[-1].message.obstacles}


@pytest.mark.parametrize("node", ["director", "map_server", "simulator", "controller"])
def test_every_node_does_the_same_with_the_recorded_commands(steered, node):
    assert main(["regress", str(steered), "--node", node]) == 0


def test_other_commands_would_be_noticed(steered, tmp_path):
    """The same log with another speed asked for is not what the director did."""
    reader, path = LogReader(steered), tmp_path / "other.mcap"
    with LogWriter(path, reader.graph) as writer:
        for item in reader.messages(order="file"):
            if item.topic != STEERING.name or item.message.command != COMMANDS[1]:
                writer.copy(item)
                continue
            other = Steering(SetSpeed(1, 0.7))
            writer.write_message(STEERING, item.publisher, item.sequence, item.stamp_ns, item.sent_ns, other)
    assert main(["regress", str(path), "--node", "director"]) == 1
