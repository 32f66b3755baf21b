"""Tells which nodes hang: those that have not reported for longer than their watchdog allows."""

import math
import re
import signal
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from ..messages.graph import LAUNCHER, Graph, patience

ABORT_GRACE = 2.0
"""From SIGABRT, at which a Python process writes down its stacks, to SIGKILL [s]."""
ATTENTION = 0.25
"""Time between two looks that counts; while the launcher itself is late, nobody is blamed for silence [s]."""


@dataclass
class _Node:
    patience: float
    heard: float | None = None
    """When it last reported; None while it is starting."""
    aborted: float | None = None
    """When it was found hanging."""
    waited: float = 0.0
    """How long it had waited for a processor when it last reported [s]."""


class VitalSigns:
    """When each node last reported.

    Args:
        graph: The nodes, with their watchdogs.
        pid_of: Process id of a node that runs.
    """

    def __init__(self, graph: Graph, pid_of: Callable[[str], int | None]) -> None:
        self._pid_of = pid_of
        self._nodes = {
            node.name: _Node(patience(graph, node)) for node in graph.nodes if node.name != LAUNCHER
        }
        self._looked = monotonic()
        self._watched = 0.0
        """Time spent watching so far [s]; what follows is told in it."""

    def heard(self, name: str) -> None:
        """A node has reported: it is watched from its first report on."""
        if (node := self._nodes.get(name)) and node.aborted is None:
            node.heard = self._watched
            node.waited = waited_for_processor(self._pid_of(name))

    def hanging(self, alive: Iterable[str]) -> Iterator[tuple[str, signal.Signals]]:
        """Who hangs, and the signal that is due: SIGABRT first, and SIGKILL for who does not end of that.

        Who waits for a processor on a machine with too much to do does not hang: that time does not count.
        To be asked often, after all reports that have come were `heard`.
        """
        before, self._looked = self._looked, monotonic()
        self._watched += min(self._looked - before, ATTENTION)
        now = self._watched
        for name in alive:
            node = self._nodes[name]
            if node.aborted is None and node.heard is not None and now - node.heard > node.patience:
                starved = waited_for_processor(self._pid_of(name)) - node.waited
                if now - node.heard - starved > node.patience:
                    node.aborted = now
                    yield name, signal.SIGABRT
            elif node.aborted is not None and now - node.aborted > ABORT_GRACE:
                node.aborted = math.inf
                yield name, signal.SIGKILL

    def died(self, name: str, output: Path) -> str | None:
        """Forget a life that has ended; says how it hung, if it did.

        Args:
            name: The node.
            output: What it has written to stderr, its stacks among it.
        """
        node = self._nodes[name]
        hung, node.heard, node.aborted = node.aborted is not None, None, None
        if not hung:
            return None
        place = innermost_frame(output)
        stacks = f" in {place}; all stacks are in {output}" if place else ""
        return f"hung, no sign of life for {node.patience:g} s{stacks}"


def waited_for_processor(pid: int | None) -> float:
    """How long the main thread of a process was ready to run and did not get a processor, so far [s].

    0 where the kernel does not tell (`/proc/PID/schedstat`, Linux).
    """
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0


def innermost_frame(output: Path) -> str | None:
    """Where a process was when faulthandler wrote down its stacks for the last time: `planner.py:80 (step)`.

    The main thread is the oldest, and written last.
    """
    try:
        dump = output.read_text(errors="replace").rpartition("Fatal Python error: Aborted")[2]
    except OSError:
        return None
    main = dump.rpartition("hread 0x")[2]
    match = re.search(r'File "(.*?)", line (\d+) in (.+)', main)
    return f"{Path(match[1]).name}:{match[2]} ({match[3]})" if match else None
