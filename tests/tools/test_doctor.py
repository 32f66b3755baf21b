"""`footfall doctor` sees what is missing and what was left behind."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from footfall.launch.run_dir import OwnRunDir
from footfall.messages.graph import Graph
from footfall.tools import cli, doctor


@pytest.fixture(autouse=True)
def runs_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def ended_run(name: str) -> OwnRunDir:
    run = OwnRunDir(Graph(name, []))
    run.close()
    return run


def test_sound_installation_passes(capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        doctor, "LOOKS", tuple(look for look in doctor.LOOKS if look is not doctor.run_directory)
    )
    assert cli.main(["doctor", "--json"]) == 0
    findings = {f["subject"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert findings["packages"]["grade"] == "ok"
    assert "pyzmq" in findings["packages"]["text"]
    assert {"python", "cores", "disk here"} <= set(findings)


def test_missing_and_old_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ["numpy>=99.1", "msgspec>=0.1", 'nosuchthing>=1; extra == "sim"', 'psutil; extra == "view"']
    monkeypatch.setattr(doctor, "requires", lambda name: lines)
    core, sim, view = doctor.packages()
    assert (core.grade, core.text) == ("bad", "missing: numpy>=99.1")
    assert (sim.grade, sim.text, sim.remedy) == (
        "note",
        "missing: nosuchthing>=1",
        "pip install 'footfall[sim]'",
    )
    assert view.grade == "ok"


def test_too_long_a_place_for_sockets_is_bad(runs_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = runs_home / ("d" * 80)
    deep.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(deep))
    (finding,) = doctor.run_directory()
    assert finding.grade == "bad"
    assert "107 bytes" in finding.text
    os.chmod(deep / f"footfall-{os.getuid()}", 0o755)
    (finding,) = doctor.run_directory()
    assert "must be a directory of yours with mode 0700" in finding.text


def test_left_over_processes_and_directories_are_found_and_cleaned(capsys: pytest.CaptureFixture) -> None:
    run = ended_run("gone")
    sleep = [sys.executable, "-c", "import time; time.sleep(100)", str(run.run.graph_file)]
    orphan = subprocess.Popen(sleep, env={**os.environ, "FOOTFALL_RUN_DIR": str(run.run.path)})
    reader = subprocess.Popen(sleep)  # knows the file, but does not belong to the run
    try:
        time.sleep(0.2)
        (finding,) = [f for f in doctor.runs() if f.subject == "orphan"]
        assert str(orphan.pid) in finding.text
        assert cli.main(["doctor", "--clean", "--json"]) in (0, 1)
        assert json.loads(capsys.readouterr().out)["cleaned"] == {"processes": 1, "directories": 1}
        assert orphan.wait(5) != 0
        assert reader.poll() is None
        assert not run.run.path.exists()
    finally:
        for process in (orphan, reader):
            process.kill()
            process.wait()


def test_running_graphs_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    alive = OwnRunDir(Graph("alive", []))
    try:
        assert [f.text for f in doctor.runs()] == [f"alive in {alive.run.path}"]
        assert cli.main(["doctor", "--clean"]) in (0, 1)
        assert alive.run.graph_file.exists()
    finally:
        alive.close()
