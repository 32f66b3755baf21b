"""`footfall bench kill`: SIGKILL every process of a graph in turn; what ends, what comes back, what is left."""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import psutil

from ..messages.bus import LIFE_BITS, take
from ..messages.graph import LAUNCHER, Graph
from ..messages.link import load_graph
from ..messages.topics import CLOCK, STEPS
from ..messages.zmq_bus import ZmqBus
from .observe import observer
from .results import table, write_section

STOP_LIMIT = 3.0
"""From the death of a required node, or of the launcher, until nothing is left [s]."""
BACK_LIMIT = 2.0
"""From the death of a restartable node to the first step of its next life [s]."""
LOG_LIMIT = 1.2
"""What a killed recorder's log may lack: it is written once a second, and not on the dot [s]."""
PATIENCE = 60.0
"""Longest wait for a run to begin or to end [s]."""
MARK = "FOOTFALL_BENCH_MARK"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bench."""
    parser.add_argument(
        "name", nargs="?", default="crossing", help="launch file or scene (default: crossing)"
    )
    parser.add_argument("--mode", choices=("realtime", "free", "lockstep"), default="realtime")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")


@dataclass(frozen=True)
class Row:
    """What came of one kill."""

    killed: str
    when: str
    expected: str
    happened: str
    right: bool
    """Whether what happened is what was expected."""
    seconds: float
    limit: float

    @property
    def met(self) -> bool:
        """Whether it was right, and in time."""
        return self.right and self.seconds < self.limit


def run(args: argparse.Namespace) -> int:
    """Kill, one after the other; 1 if anything did not end as it should."""
    rows = []
    for row in kills(args.name, args.mode):
        rows.append(row)
        print(f"{row.killed}, {row.when}: {row.happened}, {row.seconds:.2f} s", file=sys.stderr, flush=True)
    met = all(row.met for row in rows)
    if args.json:
        print(json.dumps({"rows": [{**asdict(row), "met": row.met} for row in rows], "all_met": met}))
    else:
        print(markdown(rows))
    if args.write:
        title = f"### SIGKILL of every process (`footfall bench kill {args.name} --mode {args.mode}`)"
        write_section(args.write, f"kill-{args.mode}", f"{title}\n\n{markdown(rows)}")
    return 0 if met else 1


def markdown(rows: list[Row]) -> str:
    """The rows as a table."""
    head = ("killed", "when", "expected", "happened", "after [s]", "limit [s]", "met")
    cells = [(r.killed, r.when, r.expected, r.happened, round(r.seconds, 2), r.limit, r.met) for r in rows]
    return table(head, cells)


def kills(name: str, mode: str) -> Iterator[Row]:
    """Kill every node of a graph, then the recorder, the launcher and its watchdog."""
    with Victim(name, mode) as victim:
        nodes = [node.name for node in victim.graph.nodes if node.name != LAUNCHER]
        owner = next(node.name for node in victim.graph.nodes if CLOCK.name in node.outputs)
        yield _required(victim, nodes[0])
    for node in nodes[1:]:
        with Victim(name, mode) as victim:
            yield _required(victim, node)
    restartable = [node for node in nodes if node != owner]
    with Victim(name, mode, restart=restartable) as victim:
        for node in restartable:
            yield restart(victim, node)
    with Victim(name, mode, record=True) as victim:
        yield _recorder(victim)
    with Victim(name, mode, begin=False) as victim:
        victim.wait_for("--node")
        yield _launcher(victim, "nodes are importing")
    with Victim(name, mode) as victim:
        yield _launcher(victim, "mid-run")
    with Victim(name, mode) as victim:
        yield _watchdog(victim)


def _required(victim: "Victim", node: str) -> Row:
    begin = victim.kill(f"--node {node}")
    victim.gone()
    seconds = monotonic() - begin
    failure = victim.summary().get("first_failure") or {}
    said = f"{failure.get('node')}: {failure.get('ended')}"
    named = failure.get("node") == node and failure.get("ended") == "killed by SIGKILL"
    code = victim.process.returncode
    return Row(
        node,
        "mid-run",
        "graph stops, first failure named",
        f"exit code {code}, {said}",
        named and code == 1,
        seconds,
        STOP_LIMIT,
    )


def restart(victim: "Victim", node: str) -> Row:
    begin = victim.kill(f"--node {node}")
    back = victim.first_step(node, life=1)
    seconds = (back or monotonic()) - begin
    return Row(
        node,
        "mid-run, `restart: on-failure`",
        "steps again, the others go on",
        "stepped again" if back else "did not come back",
        back is not None,
        seconds,
        BACK_LIMIT,
    )


def _recorder(victim: "Victim") -> Row:
    from ..messages.log import LogReader

    sleep(2.0)
    at = victim.next_tick() or 0.0
    victim.kill("--node recorder")
    sleep(1.0)
    victim.next_tick()  # all that has come meanwhile
    goes_on = victim.next_tick() is not None
    victim.process.send_signal(signal.SIGINT)
    victim.gone()
    lost = at - max(logged.stamp_ns for logged in LogReader(victim.log).messages([CLOCK.name])) * 1e-9
    happened = f"the others {'go on' if goes_on else 'stand still'}, log ends {max(lost, 0.0):.2f} s early"
    return Row(
        "recorder", "mid-run", "the others go on, log lacks 1 s", happened, goes_on, max(lost, 0.0), LOG_LIMIT
    )


def _launcher(victim: "Victim", when: str) -> Row:
    begin = monotonic()
    victim.process.kill()
    victim.gone()
    seconds = monotonic() - begin
    left = len(victim.survivors())
    return Row(
        LAUNCHER,
        when,
        "no survivor",
        f"{left} survivors" if left else "no survivor",
        not left,
        seconds,
        STOP_LIMIT,
    )


def _watchdog(victim: "Victim") -> Row:
    begin = victim.kill("watchdog.py")
    victim.gone()
    seconds = monotonic() - begin
    code = victim.process.returncode
    return Row(
        "launcher's watchdog", "mid-run", "graph stops", f"exit code {code}", code == 1, seconds, STOP_LIMIT
    )


class Victim:
    """One run of a graph as a process of its own, known by a mark in its environment.

    Args:
        name: Launch file or scene.
        mode: How time passes.
        restart: Nodes that are restarted on failure.
        record: Record it.
        begin: Wait until every node has taken a step.
    """

    def __init__(
        self, name: str, mode: str, restart: list[str] | None = None, record: bool = False, begin: bool = True
    ) -> None:
        self._home = tempfile.TemporaryDirectory(prefix="ffkill-")
        home = Path(self._home.name)
        self.log = home / "run.mcap"
        self._run_dir = home / "run"
        self._mark = uuid.uuid4().hex
        self._begin = begin
        if restart:
            file = home / "restart.yaml"
            policies = {node: {"restart": {"policy": "on-failure"}} for node in restart}
            file.write_text(json.dumps({"include": [f"{name}.yaml"], "nodes": policies}))
            name = str(file)
        arguments = ["launch", name, "--mode", mode, "--json", "--quiet", "--run-dir", str(self._run_dir)]
        arguments += ["--record", str(self.log)] if record else []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "footfall.tools.cli", *arguments],
            env={**os.environ, MARK: self._mark, "XDG_RUNTIME_DIR": str(home)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        self._bus: ZmqBus | None = None

    def __enter__(self) -> "Victim":
        if not self._begin:
            return self
        deadline = monotonic() + PATIENCE
        while not (self._run_dir / "graph.json").exists():
            self._check(deadline)
        self.graph: Graph = load_graph(str(self._run_dir / "graph.json"))
        self._bus = observer(self.graph, [STEPS.name, CLOCK.name])
        waiting = {
            edge.publisher for edge in (inlet.edge for inlet in self._bus.inlets) if edge.topic == STEPS.name
        } - {"recorder"}
        while waiting:
            self._check(deadline)
            self._bus.poll(0.05)
            waiting -= {received.publisher for received in take(self._bus) if received.topic == STEPS.name}
        return self

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
        assert self._bus
        deadline = monotonic() + PATIENCE / 4
        while monotonic() < deadline:
            self._bus.poll(0.05)
            for received in take(self._bus):
                lives = received.sequence >> LIFE_BITS
                if (received.topic, received.publisher, lives) == (STEPS.name, node, life):
                    return received.sent_ns * 1e-9
        return None

    def next_tick(self) -> float | None:
        """Simulated time of the newest tick, once there is a new one; None if none comes [s]."""
        assert self._bus
        deadline = monotonic() + PATIENCE / 4
        while monotonic() < deadline:
            self._bus.poll(0.05)
            if stamps := [r.stamp_ns for r in take(self._bus) if r.topic == CLOCK.name]:
                return max(stamps) * 1e-9
        return None

    def summary(self) -> dict[str, Any]:
        """What the launcher said in its last line."""
        out = self.process.communicate(timeout=PATIENCE)[0].strip()
        return json.loads(out.splitlines()[-1]) if out else {}
