import json
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import pytest

from footfall.messages.log import LogReader
from footfall.messages.topics import AGENTS, MAP

pytestmark = pytest.mark.slow


@pytest.fixture
def running(tiny_run, tmp_path):
    """The tiny graph in real time, in a run directory of its own."""
    run_dir = tmp_path / "run"
    arguments = ["launch", "yard.yaml", "--mode", "realtime", "--run-dir", run_dir, "--quiet"]
    process = subprocess.Popen(tiny_run.command(*arguments), cwd=tiny_run.folder)
    deadline = monotonic() + 20
    while not (run_dir / "agents@walker").exists() and monotonic() < deadline:
        sleep(0.05)
    yield run_dir
    process.terminate()
    process.wait(20)


def test_record_a_running_graph(tiny_run, running, tmp_path):
    log = tmp_path / "live.mcap"
    options = ["--graph", running, "--duration", "2", "--exclude", "steps,diagnostics"]
    facts = tiny_run.json("record", log, *options)
    assert facts["lost"] == 0 and facts["files"] == [str(log)]
    reader = LogReader(log)
    agents = [m.sequence for m in reader.read(AGENTS)]
    assert 15 <= len(agents) <= 40 and agents == list(range(agents[0], agents[-1] + 1))
    assert len(list(reader.read(MAP))) == 1  # latched, sent before we came
    assert reader.graph and reader.graph.name == "yard" and "steps" not in reader.topics
    text = tiny_run.footfall("record", log, "--graph", running).stderr
    assert "exists already" in text
    text = tiny_run.footfall("record", tmp_path / "b.mcap", "--graph", running, "--topics", "agent").stderr
    assert "nobody publishes 'agent'; did you mean 'agents'?" in text and not (tmp_path / "b.mcap").exists()


def test_ctrl_c_finishes_the_log(tiny_run, running, tmp_path):
    log: Path = tmp_path / "live.mcap"
    command = tiny_run.command("record", log, "--graph", running, "--json")
    process = subprocess.Popen(command, cwd=tiny_run.folder, stdout=subprocess.PIPE, text=True)
    deadline = monotonic() + 20
    while monotonic() < deadline and not (log.exists() and log.stat().st_size > 5000):
        sleep(0.1)
    process.send_signal(2)
    out, _ = process.communicate(timeout=20)
    assert process.returncode == 0 and json.loads(out)["lost"] == 0
    assert LogReader(log).index.complete


def test_no_graph(tiny_run, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "footfall.tools.cli", "record", tmp_path / "a.mcap", "--graph", "nobody"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and "running" in done.stderr and not (tmp_path / "a.mcap").exists()
