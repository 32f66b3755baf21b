"""Run directories: where a running graph has its sockets, its `graph.json` and its logs."""

import fcntl
import os
import stat
import tempfile
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

import msgspec

from ..messages.config import ConfigError
from ..messages.graph import Graph
from .check import check_paths

RUN_VARIABLE = "FOOTFALL_RUN_DIR"
"""Environment variable by which the processes of a run, and whatever they start, are known."""
KEPT = 20
"""Directories of ended runs that stay, for their logs."""


def runs_home() -> Path:
    """Where the run directories of this user are; made, and closed to others, if it is not there.

    Raises:
        PermissionError: the place belongs to somebody else or is open to others.
    """
    base = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    home = base / f"footfall-{os.getuid()}"
    home.mkdir(mode=0o700, exist_ok=True)
    facts = home.lstat()
    if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.getuid() or facts.st_mode & 0o077:
        raise PermissionError(
            f"{home}: must be a directory of yours with mode 0700; remove it or set XDG_RUNTIME_DIR"
        )
    return home


@dataclass(frozen=True)
class RunDir:
    """One run's directory; alive as long as its launcher holds the lock."""

    path: Path

    @property
    def alive(self) -> bool:
        """Whether the launcher of this run still lives."""
        try:
            with (self.path / "lock").open("rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    @property
    def graph_file(self) -> Path:
        """The resolved graph."""
        return self.path / "graph.json"

    def output_of(self, node: str) -> Path:
        """What a node's process has written to stdout and stderr."""
        return self.path / "log" / f"{node}.out"

    def log_of(self, node: str) -> Path:
        """A node's log, one JSON line a record."""
        return self.path / "log" / f"{node}.jsonl"

    def remove(self) -> None:
        """Delete the directory of an ended run."""
        import shutil

        target = self.path.resolve()
        if self.path.is_symlink():
            self.path.unlink()
        shutil.rmtree(target, ignore_errors=True)


def all_runs() -> list[RunDir]:
    """Run directories of this user, oldest first, ended ones too."""
    runs = [RunDir(path) for path in runs_home().iterdir() if (path / "graph.json").exists()]
    return sorted(runs, key=lambda run: run.graph_file.stat().st_mtime)


class OwnRunDir:
    """Makes a run directory and holds its lock; the sockets are removed at the end, the logs stay.

    Args:
        graph: The completed graph.
        path: The directory; by default a new one among this user's runs.

    Raises:
        ConfigError: another run holds the directory, or its path is too long for sockets.
        PermissionError: it cannot be written.
    """

    def __init__(self, graph: Graph, path: Path | None = None) -> None:
        home = runs_home()
        own = _unused(home, f"{graph.name}-{os.getpid()}")
        self.run = RunDir(path.resolve() if path else own)
        self.graph = msgspec.structs.replace(graph, run_dir=str(self.run.path))
        check_paths(self.graph)
        self.run.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.run.path.chmod(0o700)
        self._lock = (self.run.path / "lock").open("wb")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise ConfigError(
                f"{self.run.path}: another graph runs there; choose another --run-dir"
            ) from None
        if path:  # so that it is found where all the others are
            _drop_links(home, self.run.path)
            own.symlink_to(self.run.path)
        self._clear_sockets()
        (self.run.path / "log").mkdir(mode=0o700, exist_ok=True)
        unfinished = self.run.path / "graph.json.new"
        unfinished.write_bytes(msgspec.json.format(msgspec.json.encode(self.graph)))
        unfinished.replace(self.run.graph_file)

    def _clear_sockets(self) -> None:
        for entry in self.run.path.iterdir():
            if stat.S_ISSOCK(entry.lstat().st_mode):
                entry.unlink()

    def close(self) -> None:
        """Let go of the directory, and remove those of long ended runs."""
        self._clear_sockets()
        self._lock.close()
        ended = [run for run in all_runs() if not run.alive]
        for run in ended[:-KEPT]:
            if not run.path.is_symlink():
                run.remove()


def _unused(home: Path, name: str) -> Path:
    """A path of this name; numbered where an ended run's process had the same number."""
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(path for path in map(home.joinpath, names) if not os.path.lexists(path))


def _drop_links(home: Path, target: Path) -> None:
    """Remove links to directories that are gone, and to the one about to be linked."""
    for link in filter(Path.is_symlink, home.iterdir()):
        if not link.exists() or link.resolve() == target:
            link.unlink(missing_ok=True)
