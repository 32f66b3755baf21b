"""A graph launched as a process of its own, to be watched, killed and counted from outside."""

import json
import os
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import psutil

from ..messages.bus import LIFE_BITS, take
from ..messages.graph import Graph
from ..messages.link import load_graph
from ..messages.topics import CLOCK, STEPS
from ..messages.zmq_bus import ZmqBus
from .observe import observer

PATIENCE = 60.0
"""Longest wait for a run to begin or to end [s]."""
MARK = "FOOTFALL_BENCH_MARK"


def set_words(settings: Sequence[str]) -> list[str]:
    """The words of a command line that hand KEY=VALUE settings to `footfall launch`."""
    return [word for setting in settings for word in ("--set", setting)]


class Launched:
    """One run of a graph as a process of its own, known by a mark in its environment.

    Args:
        name: Launch file or scene.
        mode: How time passes.
        restart: Nodes that are restarted on failure.
        begin: Wait until every node has taken a step.
        topics: What to listen to.
        arguments: More arguments of `footfall launch`.

    Raises:
        RuntimeError: it does not begin.
    """

    def __init__(
        self,
        name: str,
        mode: str,
        restart: Sequence[str] = (),
        *,
        begin: bool = True,
        topics: Sequence[str] = (),
        arguments: Sequence[str] = (),
    ) -> None:
        self._home = tempfile.TemporaryDirectory(prefix="ffrun-")
        home = Path(self._home.name)
        self._run_dir = home / "run"
        self._mark = uuid.uuid4().hex
        self._begin = begin
        self._topics = {STEPS.name, CLOCK.name, *topics}
        if restart:
            file = home / "restart.yaml"
            policies = {node: {"restart": {"policy": "on-failure"}} for node in restart}
            file.write_text(json.dumps({"include": [f"{name}.yaml"], "nodes": policies}))
            name = str(file)
        words = ["launch", name, "--mode", mode, "--json", "--quiet", "--run-dir", str(self._run_dir)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "footfall.tools.cli", *words, *arguments],
            env={**os.environ, MARK: self._mark, "XDG_RUNTIME_DIR": str(home)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        self._bus: ZmqBus | None = None

    @property
    def bus(self) -> ZmqBus:
        """What listens to the run, once it has begun."""
        assert self._bus is not None
        return self._bus

    def __enter__(self) -> "Launched":
        try:
            if self._begin:
                self._wait_for_steps()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _wait_for_steps(self) -> None:
        deadline = monotonic() + PATIENCE
        while not (self._run_dir / "graph.json").exists():
            self._check(deadline)
        self.graph: Graph = load_graph(str(self._run_dir / "graph.json"))
        self._bus = observer(self.graph, self._topics)
        waiting = set(self.graph.publishers(STEPS.name)) - {"recorder"}
        while waiting:
            self._check(deadline)
            self.bus.poll(0.05)
            waiting -= {received.publisher for received in take(self.bus) if received.topic == STEPS.name}

    def __exit__(self, *error: object) -> None:
        """End whatever is left."""
        for process in self.survivors():
            with suppress(psutil.Error):
                process.kill()
        self.process.communicate()
        if self._bus:
            self._bus.close()
        self._home.cleanup()

    def _check(self, deadline: float) -> None:
        if self.process.poll() is not None or monotonic() > deadline:
            raise RuntimeError(f"the graph did not begin within {PATIENCE:g} s")
        sleep(0.01)

    def survivors(self) -> list[psutil.Process]:
        """Everything of this run that lives."""
        found = []
        for process in psutil.process_iter():
            with suppress(psutil.Error):
                if process.environ().get(MARK) == self._mark and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    def wait_for(self, words: str) -> psutil.Process:
        """The process with these words in its command line, once there is one."""
        deadline = monotonic() + PATIENCE
        while True:
            for process in self.survivors():
                with suppress(psutil.Error):
                    if words in " ".join(process.cmdline()):
                        return process
            self._check(deadline)

    def kill(self, words: str) -> float:
        """SIGKILL a process; returns when that was [s]."""
        process = self.wait_for(words)
        begin = monotonic()
        process.kill()
        return begin

    def gone(self) -> None:
        """Wait until nothing is left."""
        deadline = monotonic() + PATIENCE
        while self.process.poll() is None or self.survivors():
            if monotonic() > deadline:
                return
            sleep(0.01)

    def first_step(self, node: str, life: int) -> float | None:
        """When a node took its first step of a life; None if it did not [s]."""
        deadline = monotonic() + PATIENCE
        while monotonic() < deadline:
            self.bus.poll(0.05)
            for received in take(self.bus):
                lives = received.sequence >> LIFE_BITS
                if (received.topic, received.publisher, lives) == (STEPS.name, node, life):
                    return received.sent_ns * 1e-9
        return None

    def next_tick(self) -> float | None:
        """Simulated time of the newest tick, once there is a new one; None if none comes [s]."""
        deadline = monotonic() + PATIENCE
        while monotonic() < deadline:
            self.bus.poll(0.05)
            if stamps := [r.stamp_ns for r in take(self.bus) if r.topic == CLOCK.name]:
                return max(stamps) * 1e-9
        return None

    def summary(self) -> dict[str, Any]:
        """What the launcher said in its last line."""
        out = self.process.communicate(timeout=PATIENCE)[0].strip()
        return json.loads(out.splitlines()[-1]) if out else {}
