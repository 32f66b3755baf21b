"""Nothing outlives a run, however its launcher ends."""

import os
import signal
import time
from collections.abc import Callable

import pytest

pytestmark = pytest.mark.slow
LITTLE = "little.yaml"
WITH_CHILDREN = ("--mode", "realtime", "--set", "echoer.children=2")


def test_launcher_killed_mid_run(launch: Callable) -> None:
    run = launch(LITTLE, *WITH_CHILDREN)
    run.wait_for("sleep 1000", count=2)
    time.sleep(1.0)
    run.process.kill()
    run.gone_within(3.0)


def test_launcher_killed_while_a_node_imports(launch: Callable) -> None:
    run = launch(LITTLE, env={"SLOW_IMPORT": "60"})
    run.wait_for("sleep 1000")  # a grandchild in a session of its own
    run.process.kill()
    run.gone_within(3.0)


@pytest.mark.parametrize("delay", [0.02, 0.05, 0.1])
def test_launcher_killed_while_it_starts_nodes(launch: Callable, delay: float) -> None:
    run = launch(LITTLE, *WITH_CHILDREN)
    run.wait_for("watchdog.py")
    time.sleep(delay)
    run.process.kill()
    run.gone_within(3.0)


def test_launcher_killed_with_its_whole_group(launch: Callable) -> None:
    run = launch(LITTLE, *WITH_CHILDREN)
    run.wait_for("sleep 1000", count=2)
    os.killpg(run.process.pid, signal.SIGKILL)
    run.gone_within(3.0)


def test_launcher_killed_with_a_stubborn_node(launch: Callable) -> None:
    run = launch(LITTLE, *WITH_CHILDREN, "--set", "at=5", "--set", "how=hang")
    run.wait_for("sleep 1000", count=2)
    time.sleep(1.0)
    run.process.kill()
    run.gone_within(3.0)


def test_watchdog_killed(launch: Callable) -> None:
    run = launch(LITTLE, *WITH_CHILDREN)
    (watchdog,) = run.wait_for("watchdog.py")
    run.wait_for("sleep 1000", count=2)
    time.sleep(0.5)
    os.kill(watchdog, signal.SIGKILL)
    code, _, err = run.finish(timeout=5)
    assert code == 1
    assert "watchdog process has died" in err
    run.gone_within(1.0)


def test_children_of_a_node_that_died_are_gone_at_the_end(launch: Callable) -> None:
    run = launch(LITTLE, *WITH_CHILDREN, "--set", "at=10", "--set", "how=segv")
    assert run.finish()[0] == 1
    run.gone_within(0.5)
