"""The shipped graph as `footfall launch` runs it: from the command line to the summary and the log."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

pytestmark = pytest.mark.slow
KEYS = {
    "agents",
    "sim_seconds",
    "real_time_factor",
    "dropped",
    "topics",
    "collisions",
    "goals_reached",
    "first_failure",
    "agent_seconds",
    "agent_overlap_share",
    "obstacle_overlap_share",
    "track_distance",
    "entered",
    "restarts",
    "log",
}


@pytest.fixture
def footfall(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., subprocess.Popen]]:
    home = tempfile.mkdtemp(prefix="ff")
    monkeypatch.setenv("XDG_RUNTIME_DIR", home)
    started: list[subprocess.Popen] = []

    def start(*words: str, cwd: Path | None = None) -> subprocess.Popen:
        command = [sys.executable, "-m", "footfall.tools.cli", *words]
        pipe = subprocess.PIPE
        started.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=cwd))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate()
    shutil.rmtree(home, ignore_errors=True)


def test_crossing_runs_records_and_sums_up(footfall: Callable, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    process = footfall(
        "launch", "crossing", "--duration", "2", "--set", "count=4", "--record", str(log), "--json"
    )
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    summary = json.loads(out.splitlines()[-1])
    assert set(summary) >= KEYS
    assert summary["sim_seconds"] == 2.0
    assert (summary["dropped"], summary["first_failure"]) == (0, None)
    assert summary["topics"]["body_states"]["sent"] == 61
    assert summary["topics"]["body_states"]["received"] == {"controller": 61, "recorder": 61}
    with log.open("rb") as file:
        statistics = make_reader(file).get_summary()
    assert statistics is not None and statistics.statistics is not None
    by_topic: dict[str, int] = {}
    for number, count in statistics.statistics.channel_message_counts.items():
        topic = statistics.channels[number].topic.partition("@")[0]
        by_topic[topic] = by_topic.get(topic, 0) + count
    assert by_topic["body_states"] == 61
    assert by_topic["agents"] == summary["topics"]["agents"]["sent"]


def test_faults_found_by_nodes_are_the_users(footfall: Callable) -> None:
    process = footfall("launch", "pedestrians", "--set", "scene=nowhere", "--duration", "1")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    last = err.strip().splitlines()[-1]
    assert last.startswith("footfall: error: ")
    assert "nowhere" in last
    assert "Traceback" not in err


def test_running_graph_can_be_steered(footfall: Callable) -> None:
    run = footfall("launch", "corridor", "--set", "count=4", "--rate", "4", "--json")

    def say(*words: str) -> tuple[int, str]:
        process = footfall(*words)
        out, err = process.communicate(timeout=30)
        return process.returncode, out + err

    deadline = time.monotonic() + 40
    while say("param", "list", "planner")[0]:
        assert run.poll() is None and time.monotonic() < deadline
    assert re.search(r'planner.method = "orca"', say("param", "list", "planner")[1])
    assert say("param", "set", "planner", "rate_hz", "2.5") == (0, "")
    time.sleep(0.5)
    assert "planner.rate_hz = 2.5" in say("param", "list")[1]
    code, text = say("param", "set", "planner", "rate_hs", "2.5")
    assert (code, "did you mean 'rate_hz'" in text) == (2, True)
    assert "simulator" in say("graph")[1]
    assert say("control", "rate", "1")[0] == 0  # from here on; what went by faster is not waited for
    rates = say("topic", "hz", "clock", "--count", "3", "--json")[1].splitlines()
    assert 10.0 < json.loads(rates[-1])["hz"] < 40.0, rates
    code, text = say("control", "rate", "-1")
    assert (code, "must be a number from 0 on" in text) == (2, True)
    assert say("control", "pause")[0] == 0
    assert say("control", "stop")[0] == 0
    out, err = run.communicate(timeout=20)
    assert run.returncode == 0, err
    assert json.loads(out.splitlines()[-1])["ended"] == "stopped on request"


def test_first_tick_comes_within_five_seconds(footfall: Callable) -> None:
    process = footfall("launch", "crossing", "--duration", "1", "--json")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    load = max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
    assert json.loads(out.splitlines()[-1])["start_seconds"] < 5.0 * load
