"""Plays a log in the place of the nodes that were recorded, and owns the clock while it does.

In: control, diagnostics (to see what was delivered), done in lockstep. Out: clock, and the recorded topics
the launch file names as its outputs. Messages keep their stamps; the order is the order of sending.
Obeys the control verbs `pause`, `resume`, `step`, `rate` (0: as fast as it goes) and `seek` [s].
"""

import json
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import Any

from ..messages.bus import Bound, BusError, take
from ..messages.clock import Clock, Mode
from ..messages.codec import MessageError
from ..messages.config import ConfigError, configure
from ..messages.graph import LAUNCHER, edges
from ..messages.log import LogError, LogReader
from ..messages.log_reader import Logged
from ..messages.log_timeline import Tick, ticks
from ..messages.schema import compatible, schema_hash
from ..messages.topics import CLOCK, CONTROL, DIAGNOSTICS, DONE, LOG, PARAMETERS, STEPS, Topic
from .node import NodeConfig
from .process import Process, run_process
from .transport import Transport

log = logging.getLogger(__name__)

OWN = {topic.name for topic in (CLOCK, DIAGNOSTICS, DONE, LOG, PARAMETERS, STEPS)}
"""Topics every node publishes about itself: the player's own, never played."""
CATCH_UP = 0.1
"""How much delay is made up for by playing faster [s]; what is beyond stays."""
DELIVERY_TIMEOUT = 5.0
"""Longest wait for the last messages' delivery [s]."""


class Config(NodeConfig, frozen=True):
    """What to play, and how it begins."""

    path: str
    """The log."""
    start: float | None = None
    """Simulation time to start from [s]; latched messages before it are sent first."""
    duration: float | None = None
    """Simulated time to play [s]; None to the end of the log."""
    loop: bool = False
    """Begin again at the end, for ever; time jumps back."""
    paused: bool = False
    """Stop after the first tick, until `resume` or `step`."""
    report: str | None = None
    """Where to write what was sent and delivered, as JSON."""


class Player:
    """Plays one log; see the module.

    Raises:
        ConfigError: the log cannot be read, or does not hold what the launch file says it does.
    """

    def __init__(self, process: Process, config: Config) -> None:
        self.process = process
        self.config = config
        spec = process.graph.clock
        rate = spec.rate if spec.rate is not None else (1.0 if spec.mode == "realtime" else None)
        self.mode: Mode = spec.mode
        self.transport = Transport(rate, config.paused)
        try:
            self.reader = LogReader(config.path, process.topics)
        except LogError as error:
            raise ConfigError(str(error)) from None
        self.topics = self._playable()
        self._start_ns = None if config.start is None else round(config.start * 1e9)
        self.failed = 0
        """Recorded messages that could not be read."""
        self.played_ns = 0
        self.playing_time = 0.0
        self._timeout = spec.timeout
        self._sent: Bound = {}
        self._followers = {i.edge.publisher for i in process.bus.inlets if i.edge.port == DONE.name}
        self._received: dict[str, dict[str, int]] = {}
        """By subscriber and topic, from the diagnostics."""

    def _playable(self) -> dict[str, Topic]:
        """Topics of the log this node publishes, of the types known here."""
        wanted = set(self.process.spec.outputs) - OWN
        known = {}
        for channel in self.reader.channels:
            if channel.topic not in wanted:
                continue
            topic = self.process.topics.get(channel.topic)
            if topic is not None and compatible(schema_hash(topic.type), bytes.fromhex(channel.schema)):
                known[channel.topic] = topic
            else:
                log.warning("%s: %s has a type unknown here; it is skipped", self.reader.path, channel.source)
        return known

    def run(self) -> None:
        """Play until the end of the log, or for ever."""
        first, timeline = self._begin(self._start_ns)
        if first is None:
            span = " to ".join(f"{ns * 1e-9:g}" for ns in self.reader.span_ns)
            raise ConfigError(f"{self.reader.path}: nothing to play there; it goes from {span} s")
        self.process.ready()
        while first is not None:
            position = self._play(first, timeline)
            if position is None and not self.config.loop:
                break
            first, timeline = self._begin(self._start_ns if position is None else position)
            if first is None:
                log.error("seek: %g s is past the end; beginning again", (position or 0) * 1e-9)
                first, timeline = self._begin(self._start_ns)
        self._report(self._wait_for_delivery())
        self.process.finish("end of the log")

    def _begin(self, position: int | None) -> tuple[Tick | None, Iterator[Tick]]:
        """Go to a time [ns] (None: the beginning) and send the latched messages that hold there."""
        duration = self.config.duration
        end = None if duration is None else (self._start_ns or 0) + round(duration * 1e9)
        timeline = ticks(self.reader, self.topics, position, end)
        first = next(timeline, None)
        if first is not None:
            self._publish_prologue(first, position)
        return first, timeline

    def _publish_prologue(self, first: Tick, position: int | None) -> None:
        """Send latched messages: those from before, and those that came just before the first tick."""
        self.process.now_ns = first.stamp_ns
        if position is not None:
            latched = [c.topic for c in self.reader.channels if c.latched and c.topic in self.topics]
            for item in self.reader.last_before(position, latched):
                self._publish(item)
        for item in first.messages:
            if item.channel.latched:
                self._publish(item)

    def _play(self, first: Tick, timeline: Iterator[Tick]) -> int | None:
        """Play one stretch; returns where to go on [ns], or None at its end."""
        first.messages[:], first.places[:] = _without_latched(first)
        tick: Tick | None = first
        begin, previous_ns, due = monotonic(), first.stamp_ns, monotonic()
        while tick is not None:
            self.transport.changed = False
            rate = self.transport.rate
            length = 0.0 if rate is None else max(0, tick.stamp_ns - previous_ns) * 1e-9 / rate
            for item, place in zip(tick.messages, tick.places, strict=True):
                self._wait_until(due + place * length)
                self._publish(item)
            self._wait_until(due + length)
            if not tick.repeats:
                self._tick(tick)
            self.played_ns += max(0, tick.stamp_ns - previous_ns)
            previous_ns = tick.stamp_ns
            on_time = rate is not None and not self.transport.changed
            due = max(due + length, monotonic() - CATCH_UP) if on_time else monotonic()
            if self.transport.paused and self.transport.seek_ns is None:
                begin += self._stay_paused(tick)
                due = monotonic()
            if self.transport.seek_ns is not None:
                position, self.transport.seek_ns = max(0, self.transport.seek_ns), None
                self.playing_time += monotonic() - begin
                return position
            tick = next(timeline, None)
        self.playing_time += monotonic() - begin
        return None

    def _publish(self, item: Logged[Any]) -> None:
        try:
            self.process.bus.publish(self.topics[item.topic], item.message, item.stamp_ns)
        except MessageError as error:
            self.failed += 1
            log.error("%s: %s", self.reader.path, error)

    def _wait_until(self, due: float) -> None:
        """Sleep, listening; a change of rate or a seek ends it."""
        while (left := due - monotonic()) > 0 and not self.transport.changed:
            self.process.wait(lambda: False, min(0.02, left))
            self._listen()

    def _listen(self) -> None:
        """Take in control and diagnostics; in lockstep `done` as well."""
        for received in take(self.process.bus):
            message = received.message
            if received.port == CONTROL.name and message.node in ("*", self.process.name):
                self.transport.obey(message.name, message.value)
            elif received.port == DIAGNOSTICS.name:
                self._received[message.node] = {
                    wire.topic: wire.received
                    for wire in message.inputs
                    if wire.publisher == self.process.name
                }
            elif received.port == DONE.name:
                self._sent |= message.sent
                self._done[received.publisher] = message.step

    def _tick(self, tick: Tick, paused: bool = False) -> None:
        """Say that time has come, and in lockstep wait for everybody's work on it.

        Raises:
            BusError: somebody has not done it in time; names who.
        """
        process = self.process
        process.now_ns = tick.stamp_ns
        sent = {**self._sent, **process.sent} if self.mode == "lockstep" else {}
        self._done: dict[str, int] = {}
        process.bus.publish(CLOCK, Clock(tick.step, tick.step_ns, self.mode, paused, sent), tick.stamp_ns)
        process.wait(timeout=0)
        self._listen()
        deadline = monotonic() + self._timeout
        while late := {name for name in self._followers if self._done.get(name) != tick.step}:
            process.wait()
            self._listen()
            if monotonic() > deadline:
                raise BusError(
                    f"tick {tick.step}: {', '.join(sorted(late))} not done after {self._timeout:g} s"
                )

    def _stay_paused(self, tick: Tick) -> float:
        """Let time stand still; returns for how long it did [s]."""
        begin = monotonic()
        transport = self.transport
        if not transport.steps:
            self._tick(tick, paused=True)
        while transport.paused and not transport.steps and transport.seek_ns is None:
            self.process.wait()
            self._listen()
        transport.steps = max(0, transport.steps - 1)
        return monotonic() - begin

    def _wait_for_delivery(self) -> dict[str, dict[str, int]]:
        """Wait until the subscribers report that they have everything; returns their counts."""
        process = self.process
        wires = [
            wire
            for wire in edges(process.graph)
            if wire.publisher == process.name and wire.topic in self._counts() and wire.subscriber != LAUNCHER
        ]
        deadline = monotonic() + DELIVERY_TIMEOUT
        while True:
            counts = {
                subscriber: {
                    e.topic: self._received.get(subscriber, {}).get(e.topic, 0)
                    for e in wires
                    if e.subscriber == subscriber
                }
                for subscriber in sorted({e.subscriber for e in wires})
            }
            sent = self._counts()
            complete = all(n == sent[topic] for row in counts.values() for topic, n in row.items())
            if complete or monotonic() > deadline:
                return counts
            process.wait()
            self._listen()

    def _counts(self) -> dict[str, int]:
        """Messages sent by topic."""
        outputs = self.process.spec.outputs
        counts = {source.partition("@")[0]: (n & 0xFFFFFFFF) + 1 for source, n in self.process.sent.items()}
        return {
            outputs[port]: counts.get(outputs[port], 0)
            for port in [*self.topics, CLOCK.name]
            if port in outputs
        }

    def _report(self, delivered: dict[str, dict[str, int]]) -> None:
        seconds = self.played_ns * 1e-9
        factor = seconds / max(self.playing_time, 1e-6)
        log.info("played %.1f s in %.1f s (%.1fx real time)", seconds, self.playing_time, factor)
        if self.config.report:
            report = {
                "sim_seconds": seconds,
                "wall_seconds": self.playing_time,
                "real_time_factor": factor,
                "unreadable": self.failed,
                "sent": self._counts(),
                "delivered": delivered,
            }
            Path(self.config.report).write_text(json.dumps(report))


def _without_latched(tick: Tick) -> tuple[list[Logged[Any]], list[float]]:
    """What of the first tick has not been sent as prologue."""
    rest = [
        (item, place)
        for item, place in zip(tick.messages, tick.places, strict=True)
        if not item.channel.latched
    ]
    return [item for item, _ in rest], [place for _, place in rest]


def play(process: Process) -> None:
    """Play until told to stop.

    Raises:
        ConfigError: the configuration or the log does not fit.
    """
    config = configure(Config, process.spec.config, f"{process.name}: config")
    Player(process, config).run()


def main() -> int:
    """Run as a process of a graph."""
    return run_process(play)


if __name__ == "__main__":
    sys.exit(main())
