"""What ended runs have left behind: directories, and processes that should not be there."""

from dataclasses import dataclass

import psutil

from .run_dir import RunDir, all_runs


@dataclass(frozen=True)
class Orphan:
    """A node's process whose launcher has gone."""

    pid: int
    command: str
    run_dir: str


def dead_runs() -> list[RunDir]:
    """Directories of runs that have ended, oldest first."""
    return [run for run in all_runs() if not run.alive]


def orphans() -> list[Orphan]:
    """Processes of ended runs that still live."""
    graphs = {str(run.graph_file): str(run.path) for run in dead_runs()}
    found = []
    for process in psutil.process_iter(["cmdline"]):
        words = process.info["cmdline"] or []
        graph = words[words.index("--graph") + 1 :][:1] if "--graph" in words else []
        if graph and graph[0] in graphs:
            found.append(Orphan(process.pid, " ".join(words), graphs[graph[0]]))
    return found


def clean() -> tuple[int, int]:
    """Kill orphans and remove the directories of ended runs; returns how many of each."""
    killed = 0
    for orphan in orphans():
        try:
            psutil.Process(orphan.pid).kill()
            killed += 1
        except psutil.NoSuchProcess:
            continue
    dead = dead_runs()
    for run in dead:
        run.remove()
    return killed, len(dead)
