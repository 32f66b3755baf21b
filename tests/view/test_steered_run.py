"""A steered run, replayed: the recorded commands bring about the same again."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from footfall.launch.running import find_graph
from footfall.messages.config import ConfigError
from footfall.messages.graph import Graph
from footfall.messages.link import Steer
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.objectives import TargetSpeed, Waypoint
from footfall.messages.steering import DropObstacle, SetSpeed, SetWaypoint, Steering
from footfall.messages.topics import AGENTS, MAP, OBJECTIVES, STEERING
from footfall.tools.cli import main
from footfall.tools.control import ask
from footfall.tools.observe import observer, stream

pytestmark = pytest.mark.slow
COMMANDS = (
    SetWaypoint(0, (1.5, 0.5)),
    SetSpeed(1, 0.6),
    DropObstacle("crate", [(2.0, -2.0), (2.4, -2.0), (2.4, -1.6), (2.0, -1.6)]),
)


def walking_graph(run_dir: Path) -> Graph:
    """The graph of a run, once people walk in it."""
    deadline = time.monotonic() + 90
    while True:
        try:
            graph = find_graph(str(run_dir))
            break
        except ConfigError:  # not there yet
            assert time.monotonic() < deadline
            time.sleep(0.3)
    bus = observer(graph, [AGENTS.name])
    try:
        for received in stream(bus, 90.0):
            if len(received.message.ids) == 3:
                return graph
    finally:
        bus.close()
    raise AssertionError("nobody walks")


@pytest.fixture(scope="module")
def steered(tmp_path_factory) -> Path:
    """A log of a run that was steered while it ran."""
    folder = tmp_path_factory.mktemp("steered")
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "footfall.tools.cli", "launch", "crossing", "--set", "count=3"),
            *("--duration", "9", "--rate", "1", "--record", "run.mcap", "--run-dir", str(folder / "r")),
        ],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.DEVNULL,
    )
    try:
        graph = walking_graph(folder / "r")
        for command in COMMANDS:
            ask(graph, Steer(command))
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
