"""Turns a node into a process: when its steps are taken in realtime, free and lockstep mode."""

import logging
from time import monotonic, perf_counter, sleep
from typing import Any

import msgspec

from ..messages.bus import Bound, BusError, Received, arrived, take
from ..messages.clock import Clock, Done, Mode
from ..messages.config import ConfigError
from ..messages.diagnostics import Parameters, StepTrace
from ..messages.link import Go
from ..messages.topics import CLOCK, CONTROL, DONE, PARAMETERS, STEPS, Topic
from .node import Node, Stepper, build
from .process import Process, run_process
from .transport import Transport

log = logging.getLogger(__name__)

REJOIN_GRACE = 0.5
"""How long a restarted node waits in lockstep for the first message of a source [s]."""


def spin(node_type: type[Node]) -> int:
    """Run a node as this process until the graph ends; returns the exit code."""
    return run_process(lambda process: _Spinner(process, node_type).run())


class _Spinner:
    """Connects a node's stepper with its process."""

    def __init__(self, process: Process, node_type: type[Node]) -> None:
        self.process = process
        self.graph = process.graph
        _check_wiring(process, node_type)
        self.node = build(node_type, process.spec.config, process.name, self.graph.seed)
        self.stepper = Stepper(self.node, process.name)

    def run(self) -> None:
        """Start, work until stopped, close."""
        process = self.process
        try:
            self._publish_parameters()
            process.publish(list(self.node.start()))
            go = process.ready()
            self._take_start_messages(go)
            if self.node.clock_rate_hz is not None:
                ClockOwner(self, self.node.clock_rate_hz).run()
            elif self.in_lockstep:
                self._follow_in_step(go)
            else:
                self._follow()
        finally:
            self.node.close()

    @property
    def in_lockstep(self) -> bool:
        """Whether the clock waits for this node."""
        return self.graph.clock.mode == "lockstep" and self.process.spec.lockstep

    def _take_start_messages(self, go: Go) -> None:
        """What everybody sent before the start (maps, populations) is here before the first tick."""
        if go.restarted:
            return
        start = monotonic()
        while not self.process.wait(lambda: arrived(self.process.bus, go.sent)):
            if monotonic() - start > 10:
                raise BusError("start messages of other nodes have not arrived within 10 s")
        self.work(take(self.process.bus, go.sent), 0, run=False)

    def _follow(self) -> None:
        """Realtime and free: a step whenever something came that triggers one."""
        while True:
            if self.process.wait():
                messages = take(self.process.bus)
                ticks = [m.stamp_ns for m in messages if m.port == CLOCK.name]
                self.work(messages, max(ticks) if ticks else self.stepper.inbox.now_ns)

    def _follow_in_step(self, go: Go) -> None:
        """Lockstep: one round a tick, on exactly what was sent before it."""
        bus = self.process.bus
        clock = next(inlet for inlet in bus.inlets if inlet.edge.port == CLOCK.name)
        grace = 0.0 if go.restarted else REJOIN_GRACE  # what went by before the restart is gone
        while True:
            if not self.process.wait(lambda: bool(clock.pending)):
                continue
            for tick in clock.take(None):
                bound: Bound = tick.message.sent
                begin = monotonic()
                while not self.process.wait(lambda bound=bound: arrived(bus, bound), min(grace, 0.05)):
                    if go.restarted and monotonic() - begin >= grace:
                        self._skip_unheard(bound)
                grace = REJOIN_GRACE
                self.work([tick, *take(bus, bound)], tick.stamp_ns)
                self.process.bus.publish(
                    DONE, Done(tick.message.step, self.process.name, self.process.sent), tick.stamp_ns
                )

    def _skip_unheard(self, bound: Bound) -> None:
        """What went by while this node was away, or not yet known to its publisher, will not come again."""
        for inlet in self.process.bus.inlets:
            if inlet.edge.in_step and not inlet.received:
                inlet.last_sequence = max(inlet.last_sequence, bound.get(inlet.source, -1))

    def work(self, messages: list[Received[Any]], now_ns: int, run: bool = True) -> None:
        """Deliver messages; take a step if one is due, and send what it gives."""
        process = self.process
        process.now_ns = now_ns
        for message in messages:
            if message.port == CONTROL.name:
                self._control(message.message.node, message.message.name, message.message.value)
        try:
            self.stepper.deliver(messages, now_ns)
        except ConfigError as error:
            log.error("%s; the old value stays", error)
        if self.stepper.reconfigured:
            self.stepper.reconfigured = False
            self._publish_parameters()
        if run and self.stepper.due:
            self.step()

    def step(self) -> None:
        """Take one step now, send its messages and the trace of it."""
        process = self.process
        begin = perf_counter()
        consumed = self.stepper.inbox.consumed()
        outgoing = self.stepper.step()
        process.time_step(perf_counter() - begin)
        produced = process.publish(outgoing)
        process.facts = self.node.facts
        if process.bus.subscribers(STEPS.name):
            trace = StepTrace(process.name, self.stepper.steps - 1, consumed, produced)
            process.bus.publish(STEPS, trace, process.now_ns)

    def _publish_parameters(self) -> None:
        values = msgspec.json.encode(self.node.config).decode()
        self.process.bus.publish(PARAMETERS, Parameters(self.process.name, values), self.process.now_ns)

    def _control(self, node: str, name: str, value: Any) -> None:
        if node in ("*", self.process.name) and name == "log_level":
            try:
                logging.getLogger().setLevel(str(value))
            except ValueError as error:
                log.warning("log_level stays as it is: %s", error)


class ClockOwner:
    """Makes time pass: paces the ticks and, in lockstep, waits for everybody's work on each."""

    def __init__(self, spinner: _Spinner, rate_hz: int) -> None:
        self.spinner = spinner
        self.process = spinner.process
        self.rate_hz = rate_hz
        spec = spinner.graph.clock
        self.mode: Mode = spec.mode
        self.timeout = spec.timeout
        rate = spec.rate if spec.rate is not None else (1.0 if spec.mode == "realtime" else None)
        self.transport = Transport(rate, paused=False)
        self.followers = {
            edge.publisher
            for edge in (inlet.edge for inlet in self.process.bus.inlets)
            if edge.port == DONE.name
        }
        self._sent: Bound = {}
        """What the followers have sent up to their last finished tick."""
        self._behind = 0.0

    def run(self) -> None:
        """Tick until the duration is over or the node says it has finished."""
        spinner, process = self.spinner, self.process
        duration = spinner.graph.duration
        step = 0
        while not spinner.stepper.ready:
            if process.wait():
                spinner.work(take(process.bus), 0, run=False)
        due = monotonic()
        while True:
            now_ns = step * 1_000_000_000 // self.rate_hz
            if duration is not None and now_ns > round(duration * 1e9):
                process.finish(f"{duration:g} s simulated")
            process.bus.poll(0)
            process.keep_house()
            in_step = self._sent if self.mode == "lockstep" else None
            spinner.work(self._listen(take(process.bus, in_step)), now_ns, run=False)
            spinner.step()
            if reason := spinner.node.finished:
                process.finish(reason)
            self._tick(step)
            if self.mode == "lockstep":
                self._wait_for_followers(step)
            due = self._pace(due, step)
            step += 1

    def _tick(self, step: int) -> None:
        sent = {**self._sent, **self.process.sent} if self.mode == "lockstep" else {}
        clock = Clock(step, 1_000_000_000 // self.rate_hz, self.mode, self.transport.paused, sent)
        self.process.bus.publish(CLOCK, clock, self.process.now_ns)

    def _wait_for_followers(self, step: int) -> None:
        """Wait until every follower is done with a tick and its messages are here.

        Raises:
            BusError: somebody is not; names who.
        """
        process = self.process
        waiting = set(self.followers)
        inlets = [inlet for inlet in process.bus.inlets if inlet.edge.port == DONE.name]
        deadline = monotonic() + self.timeout
        while waiting:
            if process.wait(lambda: any(inlet.pending for inlet in inlets)):
                for done in (done for inlet in inlets for done in inlet.take(None)):
                    if done.message.step >= step:
                        waiting.discard(done.publisher)
                        self._sent |= done.message.sent
            elif monotonic() > deadline:
                names = ", ".join(sorted(waiting))
                raise BusError(f"tick {step}: {names} not done after {self.timeout:g} s of wall time")
        while not process.wait(lambda: arrived(process.bus, self._sent)):
            if monotonic() > deadline:
                late = {
                    i.source for i in process.bus.inlets if i.last_sequence < self._sent.get(i.source, -1)
                }
                raise BusError(
                    f"tick {step}: messages of {', '.join(sorted(late))} have not arrived after {self.timeout:g} s"
                )

    def _pace(self, due: float, step: int) -> float:
        """Wait for the wall time of the next tick, and return it, given when this one was due [s]."""
        if self.transport.paused:
            due += self._stay_paused(step)
        if self.transport.rate is None:
            return monotonic()
        due += 1 / (self.rate_hz * self.transport.rate)
        if (late := monotonic() - due) > 0:
            self._behind += late
            self.process.facts["behind"] = self.spinner.node.facts["behind"] = self._behind
            return due + late
        while (left := due - monotonic()) > 0:
            if left > 0.002:
                self.process.wait(lambda: False, min(0.02, left - 0.001))
            else:
                sleep(left)
        return due

    def _stay_paused(self, step: int) -> float:
        """Stand still until told to go on; returns for how long [s]."""
        begin = monotonic()
        self._tick(step)
        while self.transport.paused and not self.transport.steps:
            if self.process.wait():
                in_step = self._sent if self.mode == "lockstep" else None
                self.spinner.work(
                    self._listen(take(self.process.bus, in_step)), self.process.now_ns, run=False
                )
        self.transport.steps = max(0, self.transport.steps - 1)
        return monotonic() - begin

    def _listen(self, messages: list[Received[Any]]) -> list[Received[Any]]:
        """Obey what is said to the clock."""
        for control in (m.message for m in messages if m.port == CONTROL.name):
            if control.node not in ("*", self.process.name):
                continue
            self.transport.obey(control.name, control.value)
        return messages


def _check_wiring(process: Process, node_type: type[Node]) -> None:
    """The launch file must feed every input of the node's code and know every output.

    Raises:
        ConfigError: it does not.
    """
    spec = process.spec
    implicit = {CLOCK.name, CONTROL.name, DONE.name}
    faults = []
    for kind, declared, wired in (
        ("input", _names(node_type.inputs), set(spec.inputs)),
        ("output", _names(node_type.outputs), set(spec.outputs)),
    ):
        extra = (
            implicit
            if kind == "input"
            else {DONE.name, PARAMETERS.name, STEPS.name, "diagnostics", "log", "clock"}
        )
        faults += [f"lacks {kind} {name}" for name in sorted(declared - wired)]
        faults += [
            f"has {kind} {name}, which {node_type.__name__} does not know"
            for name in sorted(wired - declared - extra)
        ]
    if faults:
        raise ConfigError(f"{process.name}: the launch file {'; '.join(faults)}")


def _names(topics: tuple[Topic, ...]) -> set[str]:
    return {topic.name for topic in topics}
