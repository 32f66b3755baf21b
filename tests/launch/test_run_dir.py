"""Every run has a directory of its own, whatever runs before it have left."""

import os
import shutil
from pathlib import Path

import pytest

from footfall.launch.run_dir import OwnRunDir, all_runs, runs_home
from footfall.messages.graph import Graph

GRAPH = Graph("yard", [])
OWN = f"yard-{os.getpid()}"
pytestmark = pytest.mark.usefixtures("runs_home")


def linked() -> list[Path]:
    return [link.resolve() for link in runs_home().iterdir() if link.is_symlink()]


def test_logs_of_an_ended_process_of_the_same_number_stay() -> None:
    for _ in range(3):
        OwnRunDir(GRAPH).close()
    assert {run.path.name for run in all_runs()} == {OWN, f"{OWN}-2", f"{OWN}-3"}


def test_link_to_a_removed_directory_is_in_nobodys_way(tmp_path: Path) -> None:
    OwnRunDir(GRAPH, tmp_path / "gone").close()
    shutil.rmtree(tmp_path / "gone")
    OwnRunDir(GRAPH).close()
    assert [run.path.name for run in all_runs()] == [f"{OWN}-2"]
    OwnRunDir(GRAPH, tmp_path / "next").close()
    assert linked() == [tmp_path / "next"]


def test_directory_used_again_is_linked_once(tmp_path: Path) -> None:
    for _ in range(2):
        OwnRunDir(GRAPH, tmp_path / "again").close()
    assert linked() == [tmp_path / "again"]
