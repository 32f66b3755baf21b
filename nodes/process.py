"""The process around a node: command line, bus, line to the launcher, log, diagnostics, signals."""

import argparse
import json
import logging
import os
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from types import FrameType, TracebackType
from typing import get_args

import msgspec
import psutil

from ..messages.bus import Bound, BusError, Inlet
from ..messages.codec import Codec, MessageError
from ..messages.config import ConfigError
from ..messages.custom_topics import resolve_topics
from ..messages.diagnostics import Diagnostics, InputStats, Level, LogLine, OutputStats
from ..messages.graph import OUTSIDE, Edge, Graph, NodeSpec, patience
from ..messages.link import Deliver, Failed, Finished, Go, Link, Ready, Stop, load_graph
from ..messages.remote import connect_remotes
from ..messages.topics import DIAGNOSTICS, LOG, Outgoing, Topic
from ..messages.zmq_bus import ZmqBus

log = logging.getLogger(__name__)

CONNECT_TIMEOUT = 20.0
"""Longest wait for declared subscribers at the start [s]."""
RECONNECT_TIMEOUT = 5.0
"""The same for a restarted node, which then goes on without those who are not there either [s]."""
DIAGNOSTICS_PERIOD = 1.0
"""[s] of wall time; shorter where the launcher would not wait for several of them."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask the process to end."""


class Stopped(Exception):  # noqa: N818 - not an error
    """The process was asked to end."""


class Process:
    """A node's process. Enter it as a context: sockets open, and close whatever happens."""

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph = graph
        self.spec: NodeSpec = graph.node(name)
        self.name = name
        self.topics: Mapping[str, Topic] = resolve_topics(graph)
        self.restarts = int(os.environ.get("FOOTFALL_RESTARTS", "0"))
        self.link = Link(graph.run_dir, name)
        self.bus = ZmqBus(graph, name, self.topics, self.restarts)
        connect_remotes(self.bus, graph, name, self.topics)
        self.facts: dict[str, float] = {}
        self.steps = 0
        self.now_ns = 0
        self._signalled = False
        self._outside: dict[str, list[Inlet]] = {}
        """By topic, what takes messages from outside the graph."""
        self._lines: deque[LogLine] = deque(maxlen=1000)
        self._errors = 0
        self._step_times: list[float] = []
        self._report_time = monotonic()
        self._report_period = min(DIAGNOSTICS_PERIOD, patience(graph, self.spec) / 4)
        self._usage = psutil.Process()
        self._cpu = sum(self._usage.cpu_times()[:2])
        self._log_file = _LogFile(Path(graph.run_dir) / "log" / f"{name}.jsonl", name, self._lines)

    def __enter__(self) -> "Process":
        for number in SIGNALS:
            signal.signal(number, self._on_signal)
        root = logging.getLogger()
        root.addHandler(self._log_file)
        root.setLevel(self.spec.log_level)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> bool:
        """Report how it ended to the launcher; a stop is a good end."""
        if error is not None and not isinstance(error, (Stopped, SystemExit)):
            usage = isinstance(error, ConfigError)
            if not usage:
                log.error("%s", "".join(traceback.format_exception(error)))
            known = isinstance(error, (ConfigError, BusError, MessageError))
            self.link.send(Failed(self.name, str(error) if known else f"{kind.__name__}: {error}", usage))  # type: ignore[union-attr]
        self._flush_log()
        self.report()
        logging.getLogger().removeHandler(self._log_file)
        self._log_file.close()
        self.bus.close()
        self.link.close()
        for number in SIGNALS:  # the interpreter is ending; a signal would make a failure of it
            signal.signal(number, signal.SIG_IGN)
        return isinstance(error, Stopped)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._signalled = True

    def ready(self) -> Go:
        """Wait for the subscribers, tell the launcher, wait for everybody else.

        Raises:
            BusError: a declared subscriber does not come.
            Stopped: the launcher gave up first.
        """
        deadline = monotonic() + (RECONNECT_TIMEOUT if self.restarts else CONNECT_TIMEOUT)
        while missing := self.bus.wait_connected(0.1):
            self.check_stop()
            if monotonic() > deadline:
                break
        if missing and not self.restarts:
            raise BusError(f"after {CONNECT_TIMEOUT:g} s still missing {'; '.join(missing)}")
        self.link.send(Ready(self.name, self.bus.sent))
        while True:
            line = self.link.receive(0.05)
            if isinstance(line, Go):
                self.report()  # from here on the launcher expects signs of life
                return line
            if isinstance(line, Stop) or self._signalled:
                raise Stopped
            self.bus.poll(0)

    def check_stop(self) -> None:
        """End the process if the launcher or a signal says so.

        Raises:
            Stopped: it does.
        """
        line = self.link.receive(0)
        if self._signalled or isinstance(line, Stop):
            raise Stopped
        if isinstance(line, Deliver):
            self._take_from_outside(line)

    def _take_from_outside(self, line: Deliver) -> None:
        """Put a message into an inlet that has no socket; steps and recordings see it as any other."""
        if line.topic not in self._outside:
            topic = self.topics[line.topic]
            wires = [(port, wire) for port, wire in self.spec.inputs.items() if wire.topic == line.topic]
            self._outside[line.topic] = [
                Inlet(
                    Edge(line.topic, OUTSIDE, self.name, port, wire, reliable=False, in_step=False),
                    Codec(line.topic, topic.type),
                    keep_all=False,
                )
                for port, wire in wires
            ]
            self.bus.inlets += self._outside[line.topic]
        for inlet in self._outside[line.topic]:
            inlet.put([line.message])

    def wait(self, ready: Callable[[], bool] | None = None, timeout: float = 0.05) -> bool:
        """Receive until `ready` or `timeout` [s]; keeps up the house meanwhile. See `Bus.poll`."""
        arrived = self.bus.poll(timeout, ready)
        self.keep_house()
        return arrived

    def keep_house(self) -> None:
        """Log lines, diagnostics and the launcher's word: call it every few hundredths of a second."""
        self.check_stop()
        for inlet in self.bus.inlets:
            while inlet.faults:
                log.error("rejected %s", inlet.faults.pop(0))
        self._flush_log()
        self._report_if_due()

    def _report_if_due(self) -> None:
        if monotonic() - self._report_time > self._report_period:
            self.report()

    def publish(self, outgoing: list[Outgoing]) -> dict[str, list[int]]:
        """Send a step's messages at the present time; returns their sequence numbers by topic."""
        produced: dict[str, list[int]] = {}
        for item in outgoing:
            sequence = self.bus.publish(item.topic, item.message, self.now_ns)
            produced.setdefault(self.spec.outputs.get(item.topic.name, item.topic.name), []).append(sequence)
            self._report_if_due()  # a slow subscriber may have kept us
        return produced

    def finish(self, reason: str) -> None:
        """Tell the launcher that the run has reached its end, and wait to be stopped.

        Raises:
            Stopped: always, in the end.
        """
        self.report()
        self.link.send(Finished(self.name, reason))
        while True:
            self.wait(ready=lambda: False)
            for inlet in self.bus.inlets:
                inlet.pending.clear()

    def time_step(self, seconds: float) -> None:
        """Note how long a step took."""
        self.steps += 1
        self._step_times.append(seconds)

    def report(self) -> None:
        """Publish diagnostics."""
        elapsed = monotonic() - self._report_time
        self._report_time = monotonic()
        cpu = sum(self._usage.cpu_times()[:2])
        times = self._step_times or [0.0]
        message = Diagnostics(
            node=self.name,
            pid=os.getpid(),
            steps=self.steps,
            step_time=sum(times) / len(times),
            step_time_max=max(times),
            cpu=(cpu - self._cpu) / max(elapsed, 1e-3),
            memory=self._usage.memory_info().rss,
            inputs=self.input_stats(),
            outputs=[
                OutputStats(
                    topic=source.partition("@")[0],
                    sent=(sequence & 0xFFFFFFFF) + 1,
                    bytes=self.bus.bytes_sent.get(source.partition("@")[0], 0),
                    refused=self.bus.refused.get(source.partition("@")[0], 0),
                )
                for source, sequence in self.bus.sent.items()
            ],
            facts=dict(self.facts),
            errors=self._log_file.errors,
        )
        self._cpu = cpu
        self._step_times = []
        self.bus.publish(DIAGNOSTICS, message, self.now_ns)

    def input_stats(self) -> list[InputStats]:
        """Counters of every input."""
        now = monotonic()
        return [
            InputStats(
                topic=inlet.edge.topic,
                publisher=inlet.edge.publisher,
                received=inlet.received,
                dropped=inlet.dropped,
                skipped=inlet.skipped,
                rejected=inlet.rejected,
                age=None if inlet.last_sent_ns is None else max(0.0, now - inlet.last_sent_ns * 1e-9),
            )
            for inlet in self.bus.inlets
        ]

    def _flush_log(self) -> None:
        while self._lines:
            self.bus.publish(LOG, self._lines.popleft(), self.now_ns)

    @property
    def sent(self) -> Bound:
        """What has been sent so far, by `topic@node`."""
        return self.bus.sent


class _LogFile(logging.Handler):
    """Writes one JSON line a record, and queues it for the `log` topic."""

    def __init__(self, path: Path, node: str, lines: deque[LogLine]) -> None:
        super().__init__()
        path.parent.mkdir(exist_ok=True)
        self._file = path.open("a", buffering=1)
        self._node = node
        self._lines = lines
        self.errors = 0

    def emit(self, record: logging.LogRecord) -> None:
        level: Level = record.levelname if record.levelname in get_args(Level) else "INFO"  # type: ignore[assignment]
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = LogLine(self._node, level, record.getMessage(), record.name, stamp)
        self.errors += record.levelno >= logging.WARNING
        self._file.write(json.dumps(msgspec.to_builtins(line)) + "\n")
        self._lines.append(line)

    def close(self) -> None:
        self._file.close()
        super().close()


def run_process(body: Callable[[Process], None]) -> int:
    """The `main` of every node's module: parse the command line, run `body`, report failures.

    Returns:
        0 after a good end, 2 for a fault in the configuration, 1 for any other failure.
    """
    parser = argparse.ArgumentParser(description="A node of a footfall graph; `footfall launch` starts it.")
    parser.add_argument("--graph", required=True, help="resolved graph (graph.json of the run directory)")
    parser.add_argument("--node", required=True, help="which node of the graph to be")
    arguments = parser.parse_args()
    try:
        with Process(load_graph(arguments.graph), arguments.node) as process:
            body(process)
    except ConfigError as error:
        print(f"{arguments.node}: {error}", file=sys.stderr)
        return 2
    except Exception:
        traceback.print_exc()
        return 1
    return 0
