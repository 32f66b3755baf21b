"""Ends a run: a word, then SIGINT, SIGTERM, SIGKILL, each after a short grace."""

import signal
from collections.abc import Iterable
from time import monotonic
from typing import TYPE_CHECKING

from ..messages.graph import NodeSpec
from ..messages.link import Stop
from ..messages.topics import DIAGNOSTICS, DONE, LOG, PARAMETERS, STEPS

if TYPE_CHECKING:
    from .runner import Runner

LAST_WORD = 0.05
"""Wait for messages that are still under way when everybody has ended [s]."""
PATIENCE = 4.0
"""From the word to stop to SIGINT when all is well [s]; a step under way may be long."""
HASTE = 0.8
"""The same after a failure or an interrupt [s]."""
SIGNAL_GRACE = 0.4
"""From one signal to the next [s]."""
WRITING = 10.0
"""Longest wait for a node that is still writing [s]."""

_OF_EVERY_NODE = {topic.name for topic in (DIAGNOSTICS, DONE, LOG, PARAMETERS, STEPS)}


class Shutdown:
    """Stops all nodes of a run: first those that speak, then those that only listen.

    So the recorder hears everything. Each further Ctrl-C skips to the next, ruder stage.
    """

    def __init__(self, runner: "Runner") -> None:
        self._runner = runner
        hurried = runner.failure is not None or runner.interrupts > 0
        self._grace = HASTE if hurried else PATIENCE

    def run(self) -> None:
        """Stop everything; returns when all processes have ended."""
        runner = self._runner
        runner.supervisor.cancel_restarts()
        nodes = {node.name: node for node in runner.graph.nodes}
        listeners = {name for name in runner.supervisor.alive if _only_listens(nodes[name])}
        self._stop(runner.supervisor.alive - listeners)
        runner.forgiving = False
        self._stop(listeners)
        runner.look(LAST_WORD)

    def _stop(self, group: set[str]) -> None:
        runner = self._runner
        for name in group & runner.supervisor.alive:
            runner.link.send(name.encode(), Stop())
        self._wait(group, self._grace, patient=True)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            left = group & runner.supervisor.alive
            if not left:
                return
            runner.supervisor.signal(left, number)
            self._wait(left, SIGNAL_GRACE if number != signal.SIGKILL else WRITING, patient=False)

    def _wait(self, group: set[str], grace: float, patient: bool) -> None:
        """Wait for a group to end; longer for one that is still writing."""
        runner = self._runner
        begin, interrupts = monotonic(), runner.interrupts
        progress = Progress()
        while left := group & runner.supervisor.alive:
            waited = monotonic() - begin
            writes = patient and waited < WRITING and progress.seen(runner.supervisor.pid(n) for n in left)
            if (waited > grace and not writes) or runner.interrupts > interrupts:
                return
            runner.look(0.02)


class Progress:
    """Whether processes have written anything lately."""

    WINDOW = 0.5

    def __init__(self) -> None:
        self._written = -1
        self._since = monotonic()

    def seen(self, pids: Iterable[int | None]) -> bool:
        """Whether any of the processes has written within the last half second."""
        import psutil

        written = 0
        for pid in pids:
            try:
                written += psutil.Process(pid).io_counters().write_chars if pid else 0
            except (psutil.Error, AttributeError):
                continue
        if written != self._written:
            self._written, self._since = written, monotonic()
        return monotonic() - self._since < self.WINDOW


def _only_listens(node: NodeSpec) -> bool:
    return not set(node.outputs) - _OF_EVERY_NODE
