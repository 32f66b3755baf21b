"""The launcher's hold on its processes: starts, signals and deaths, by way of the watchdog."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

from ..messages.graph import NodeSpec, Restart
from .run_dir import RUN_VARIABLE, RunDir

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)

USAGE = 2
"""Exit code of a node that was configured wrongly."""


class WatchdogError(RuntimeError):
    """The watchdog has ended, and with it all nodes."""


@dataclass(frozen=True)
class Death:
    """How a node's process has ended."""

    node: str
    code: int
    """Exit code; negative for the signal that killed it."""
    reason: str = ""
    """Why it could not even be started."""

    @property
    def text(self) -> str:
        """`exit code 1`, `killed by SIGSEGV`."""
        if self.reason:
            return self.reason
        if self.code >= 0:
            return f"exit code {self.code}"
        try:
            return f"killed by {signal.Signals(-self.code).name}"
        except ValueError:
            return f"killed by signal {-self.code}"


@dataclass
class _Child:
    spec: NodeSpec
    pid: int | None = None
    """None while it is not running."""
    starting: bool = False
    restarts: int = 0
    deaths: list[float] = field(default_factory=list)
    due: float | None = None
    """When it is to be started again."""


class Supervisor:
    """Starts the nodes of a graph as processes that end with the launcher, however that ends."""

    def __init__(self, run: RunDir, nodes: list[NodeSpec]) -> None:
        self._run = run
        self._children = {node.name: _Child(node) for node in nodes}
        self._pending = b""
        self._watchdog = subprocess.Popen(
            [sys.executable, "-I", "-S", str(Path(__file__).with_name("watchdog.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._watchdog.stdin and self._watchdog.stdout
        self._orders, self._events = self._watchdog.stdin, self._watchdog.stdout
        os.set_blocking(self._events.fileno(), False)

    @property
    def names(self) -> list[str]:
        """All nodes, running or not."""
        return list(self._children)

    @property
    def alive(self) -> set[str]:
        """Nodes whose process runs, or is about to."""
        return {name for name, child in self._children.items() if child.pid or child.starting}

    @property
    def expected(self) -> set[str]:
        """Nodes that run, or will again."""
        return self.alive | {name for name, child in self._children.items() if child.due is not None}

    @property
    def restarts(self) -> dict[str, int]:
        """How often each node was restarted."""
        return {name: child.restarts for name, child in self._children.items()}

    def pid(self, name: str) -> int | None:
        """Process id of a node that runs."""
        return self._children[name].pid

    def start_all(self) -> None:
        """Start every node."""
        for name in self._children:
            self._start(name)

    def _start(self, name: str) -> None:
        child = self._children[name]
        child.starting, child.due = True, None
        argv = [sys.executable, "-m", child.spec.module, "--graph", str(self._run.graph_file), "--node", name]
        output = str(self._run.output_of(name))
        self._order({"start": name, "argv": argv, "env": self._environment(child), "output": output})

    def _environment(self, child: _Child) -> dict[str, str]:
        spec = child.spec
        return {
            **os.environ,
            **dict.fromkeys(THREAD_VARIABLES, str(spec.threads)),
            "PYTHONUNBUFFERED": "1",
            "PYTHONFAULTHANDLER": "1",
            "FOOTFALL_RESTARTS": str(child.restarts),
            RUN_VARIABLE: str(self._run.path),
            **spec.env,
        }

    def poll(self) -> list[Death]:
        """Deaths since the last call; starts again what waited long enough.

        Raises:
            WatchdogError: and all nodes with it.
        """
        deaths: list[Death] = []
        while data := self._read():
            *lines, self._pending = (self._pending + data).split(b"\n")
            deaths += [death for line in lines if (death := self._take(json.loads(line)))]
        for name, child in self._children.items():
            if child.due is not None and monotonic() >= child.due:
                self._start(name)
        return deaths

    def _read(self) -> bytes | None:
        try:
            data = os.read(self._events.fileno(), 65536)
        except BlockingIOError:
            return None
        if data == b"":
            raise self._watchdog_died()
        return data

    def _watchdog_died(self) -> WatchdogError:
        """Kill what the kernel has not: it ends the nodes, but not what they have started."""
        from .leftovers import processes_of

        for child in self._children.values():
            child.pid, child.starting, child.due = None, False, None
        for process in processes_of({str(self._run.path)}):
            process.kill()
        return WatchdogError("the launcher's watchdog process has died, and all nodes with it")

    def _take(self, event: dict) -> Death | None:
        if name := event.get("started"):
            self._children[name].pid, self._children[name].starting = event["pid"], False
            return None
        name = event.get("ended") or event["broken"]
        child = self._children[name]
        child.pid, child.starting = None, False
        return Death(name, event.get("code", 127), event.get("reason", ""))

    def restart(self, death: Death) -> float | None:
        """Restart a dead node if its policy allows; returns after which wait [s], or None.

        A fault of the user's input is not cured by another try.
        """
        child = self._children[death.node]
        policy: Restart = child.spec.restart
        if death.code == USAGE or policy.policy == "never":
            return None
        if policy.policy == "on-failure" and death.code == 0:
            return None
        now = monotonic()
        child.deaths = [at for at in child.deaths if now - at < policy.window]
        if len(child.deaths) >= policy.max:
            return None
        wait = policy.backoff * 2 ** len(child.deaths)
        child.deaths.append(now)
        child.restarts += 1
        child.due = now + wait
        return wait

    def cancel_restarts(self) -> None:
        """Start nothing again: the graph ends."""
        for child in self._children.values():
            child.due = None

    def signal(self, names: set[str], number: int) -> None:
        """Send a signal to the process groups of nodes."""
        for name in names:
            self._order({"signal": name, "number": int(number)})

    def _order(self, order: dict) -> None:
        try:
            self._orders.write(json.dumps(order).encode() + b"\n")
            self._orders.flush()
        except BrokenPipeError:
            raise self._watchdog_died() from None

    def close(self) -> None:
        """End whatever still runs."""
        with suppress(BrokenPipeError):
            self._orders.close()
        try:
            self._watchdog.wait(15)
        except subprocess.TimeoutExpired:
            self._watchdog.kill()
            self._watchdog.wait()
        self._events.close()
