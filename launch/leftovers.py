"""What ended runs have left behind: directories, and processes that should not be there."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass

import psutil

from .run_dir import RUN_VARIABLE, RunDir, all_runs


@dataclass(frozen=True)
class Orphan:
    """A process of an ended run: a node, or something a node has started."""

    pid: int
    command: str
    run_dir: str


def dead_runs() -> list[RunDir]:
    """Directories of runs that have ended, oldest first."""
    return [run for run in all_runs() if not run.alive]


def processes_of(run_dirs: Collection[str]) -> Iterator[psutil.Process]:
    """Processes of runs, whoever their parents are by now."""
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get(RUN_VARIABLE) in run_dirs:
                yield process


def orphans() -> list[Orphan]:
    """Processes of ended runs that still live."""
    found = []
    for process in processes_of({str(run.path.resolve()) for run in dead_runs()}):
        with suppress(psutil.NoSuchProcess):
            command = " ".join(process.cmdline())
            found.append(Orphan(process.pid, command, process.environ()[RUN_VARIABLE]))
    return found


def clean() -> tuple[int, int]:
    """Kill orphans and remove the directories of ended runs; returns how many of each."""
    killed = 0
    for orphan in orphans():
        with suppress(psutil.NoSuchProcess):
            psutil.Process(orphan.pid).kill()
            killed += 1
    dead = dead_runs()
    for run in dead:
        run.remove()
    return killed, len(dead)
