"""SIGKILL of every process of the shipped crossing: what must end ends, what may come back does."""

import os

import pytest

from footfall.tools.bench_kill import SETTINGS, kills, restart
from footfall.tools.launched import Launched

pytestmark = pytest.mark.slow


def patience() -> float:
    """Limits are those of a machine that has nothing else to do."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def test_every_process_of_the_crossing() -> None:
    rows = list(kills("crossing", "realtime", SETTINGS))
    assert [row for row in rows if not row.right] == []
    assert [row for row in rows if row.seconds > row.limit * patience()] == []
    assert {row.killed for row in rows} >= {"map_server", "director", "simulator", "planner", "controller"}
    assert {row.killed for row in rows} >= {"referee", "recorder", "launcher", "launcher's watchdog"}


def test_nodes_come_back_in_lockstep() -> None:
    nodes = ["map_server", "director", "planner", "controller", "referee"]
    with Launched("crossing", "lockstep", nodes, arguments=["--set", *SETTINGS]) as victim:
        rows = [restart(victim, node) for node in nodes]
    assert [row for row in rows if not row.right] == []
