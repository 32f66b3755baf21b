"""Runs a graph: starts its nodes, keeps watch, stops them, and says what it came to."""

import os
import signal
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from types import FrameType

import msgspec

from ..messages.bus import Bound, take
from ..messages.config import near
from ..messages.diagnostics import Control, Diagnostics, InputStats, OutputStats
from ..messages.graph import LAUNCHER, Graph
from ..messages.link import Failed, Finished, Go, Line, Publish, Ready, Reply, Request, Steer
from ..messages.remote import connect_remotes
from ..messages.score import Score
from ..messages.steering import Steering
from ..messages.topics import CLOCK, CONTROL, DIAGNOSTICS, GRAPH, LOG, SCORE, STEERING, Topic
from ..messages.zmq_bus import ZmqBus
from .console import Console, status_text
from .link_server import LinkServer
from .outside import Outside
from .run_dir import OwnRunDir
from .shutdown import Shutdown
from .summary import Counts, Failure, Summary, score_facts
from .supervisor import Death, Supervisor, WatchdogError
from .vital_signs import VitalSigns

START_TIMEOUT = 60.0
"""Longest wait until every node is ready [s]."""
BEAT = 0.05
"""Longest time between two looks at everything [s]."""
_NOT_YET = "the graph is still starting; ask again when it runs"
UNASKED = "ended though nobody asked it to"
"""The reason of a death without a word."""


class Runner:
    """One run of a graph.

    Args:
        graph: Completed and checked.
        topics: Topics by name, built-in and custom.
        console: Where to show what goes on.
        run_dir: Instead of a new one among the user's runs.
        log: The recording, for the summary.

    Raises:
        ConfigError: the run directory cannot be used.
    """

    def __init__(
        self,
        graph: Graph,
        topics: Mapping[str, Topic],
        console: Console,
        run_dir: Path | None = None,
        log: Path | None = None,
    ) -> None:
        self._own = OwnRunDir(graph, run_dir)
        self.graph = self._own.graph
        self.failure: Failure | None = None
        self.interrupted: int | None = None
        """The signal that asked for the end."""
        self.interrupts = 0
        self._topics = topics
        self._console = console
        self._log = log
        self._nodes = [node for node in self.graph.nodes if node.name != LAUNCHER]
        self._ready: dict[str, Bound] = {}
        self._going = False
        """Whether everybody was told to go."""
        self._ended = ""
        """Why the run ends; empty while it does not."""
        self.forgiving = True
        """Whether deaths after the end are of no interest: of nodes that spoke with others that have gone."""
        self._last_words: dict[str, Failed] = {}
        self._counts = Counts()
        self._signs = VitalSigns(self.graph, lambda name: self.supervisor.pid(name))
        self._outside = Outside(self.graph, topics)
        self._score: Score | None = None
        self._sim_ns = 0
        self._joined_ns: int | None = None
        """With a clock elsewhere: the time there when everybody here was ready."""
        self._begun = self._started = self._finished = monotonic()

    def run(self) -> Summary:
        """Run until a node says it is over, a required one fails, or somebody interrupts."""
        handlers = {
            n: signal.signal(n, self._on_signal) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }
        try:
            with ExitStack() as stack:
                stack.callback(self._own.close)
                self.supervisor = Supervisor(self._own.run, self._nodes)
                stack.callback(self.supervisor.close)
                self.supervisor.start_all()
                self.link = LinkServer(self.graph.run_dir)
                stack.callback(self.link.close)
                self.bus = ZmqBus(self.graph, LAUNCHER, self._topics)
                stack.callback(self.bus.close)
                connect_remotes(self.bus, self.graph, LAUNCHER, self._topics)
                self.bus.publish(GRAPH, self.graph, 0)
                try:
                    self._run()
                    self._console.clear()
                    Shutdown(self).run()
                except WatchdogError as error:
                    self.fail(Failure(LAUNCHER, str(error)))
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return self._summary()

    def _run(self) -> None:
        deadline = monotonic() + START_TIMEOUT
        while not self._ended:
            self.look(BEAT if self._going else BEAT / 5)
            if not self._going and not self._ended:
                self._start_when_ready(deadline)
            if self._going:
                self._end_hanging()
                if self._console.wants_status:
                    self._show_status()
        self._finished = monotonic()

    def _end_hanging(self) -> None:
        for name, number in self._signs.hanging(self.supervisor.alive):
            self._console.say(f"[{name}] hangs: {number.name}", important=True)
            self.supervisor.signal({name}, number)

    def look(self, wait: float) -> None:
        """Take in messages for up to `wait` [s], lines and deaths; act on them."""
        self.bus.poll(wait, lambda: False)
        self._take_messages()
        for identity, line in self.link.receive():
            self._take_line(identity, line)
        for death in self.supervisor.poll():
            for identity, line in self.link.receive():  # its last words come first
                self._take_line(identity, line)
            self._take_death(death)
        if self.interrupts and not self._ended:
            assert self.interrupted is not None
            self._ended = f"stopped by {signal.Signals(self.interrupted).name}"

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.interrupts += 1
        self.interrupted = self.interrupted or number

    def _start_when_ready(self, deadline: float) -> None:
        waiting = self.supervisor.expected - set(self._ready)
        if not waiting:
            sent: Bound = dict(self.bus.sent)
            for bound in self._ready.values():
                sent |= bound
            for name in self._ready:
                self.link.send(name.encode(), Go(sent))
            self._going = True
            self._started = monotonic()
        elif monotonic() > deadline:
            self.fail(Failure(", ".join(sorted(waiting)), f"not ready {START_TIMEOUT:g} s after the start"))
            self._ended = "a node did not start"

    def _take_messages(self) -> None:
        for received in take(self.bus):
            self._sim_ns = max(self._sim_ns, received.stamp_ns)
            if self._going and received.port == CLOCK.name and received.publisher in self.graph.remotes:
                self._follow_remote_clock(received.stamp_ns)
            if received.port == DIAGNOSTICS.name:
                self._signs.heard(received.message.node)
                self._counts.take(received.message)
            elif received.port == SCORE.name:
                self._score = received.message
            elif received.port == LOG.name and received.message.level in ("WARNING", "ERROR", "CRITICAL"):
                line = received.message
                text = line.text.strip().splitlines()[-1] if line.text.strip() else ""
                important = line.level != "WARNING"
                self._console.say(f"[{line.node}] {line.level.lower()}: {text}", important)

    def _follow_remote_clock(self, now_ns: int) -> None:
        """The owner of a clock elsewhere knows nothing of the duration wanted here."""
        self._joined_ns = now_ns if self._joined_ns is None else self._joined_ns
        duration = self.graph.duration
        if duration is not None and now_ns - self._joined_ns >= round(duration * 1e9):
            self._ended = self._ended or f"{duration:g} s simulated"

    def _take_line(self, identity: bytes, line: Line) -> None:
        if isinstance(line, (Ready, Finished, Failed)) and line.node not in self.supervisor.names:
            return
        if isinstance(line, Ready):
            self._ready[line.node] = line.sent
            if self._going:
                self.link.send(identity, Go(restarted=True))
        elif isinstance(line, Finished):
            self._ended = self._ended or line.reason
        elif isinstance(line, Failed):
            self._last_words[line.node] = line
            node = self.graph.node(line.node)
            if not self._ended and node.restart.policy == "never":
                self.fail(Failure(line.node, line.reason, usage=line.usage))
                self._ended = f"{line.node} failed" if node.required else ""
        elif isinstance(line, Request):
            self.link.send(identity, self._obey(line))
        elif isinstance(line, Steer):
            self.link.send(identity, self._steer(line))
        elif isinstance(line, Publish):
            self.link.send(identity, self._publish(line))

    def _obey(self, request: Request) -> Reply:
        names = self.supervisor.names
        if request.verb == "stop":
            self._ended = self._ended or "stopped on request"
        elif request.node != "*" and request.node not in names:
            return Reply(f"no node {request.node!r}; {near(request.node, names)}")
        elif not self._going:
            return Reply(_NOT_YET)
        else:
            self.bus.publish(CONTROL, Control(request.node, request.name, request.value), self._sim_ns)
        return Reply()

    def _steer(self, line: Steer) -> Reply:
        if not any(STEERING.name == wire.topic for node in self.graph.nodes for wire in node.inputs.values()):
            return Reply(f"nobody in {self.graph.name} listens to {STEERING.name}")
        if not self._going:  # the nodes may not have subscribed yet, and lockstep counts what it sends
            return Reply(_NOT_YET)
        self.bus.publish(STEERING, Steering(line.command), self._sim_ns)
        return Reply()

    def _publish(self, line: Publish) -> Reply:
        try:
            listeners, message = self._outside.take(line, self._sim_ns)
        except ValueError as error:  # of the topic or of the message
            return Reply(str(error))
        for name in self.supervisor.alive & set(listeners):
            self.link.send(name.encode(), message)
        return Reply()

    def _take_death(self, death: Death) -> None:
        name = death.node
        node = self.graph.node(name)
        hung = self._signs.died(name, self._own.run.output_of(name))
        if self.failure is not None and self.failure.node == name and not self.failure.ended:
            self.failure = msgspec.structs.replace(self.failure, ended=death.text)
        if self._ended and (self.forgiving or death.code == 0):
            return
        if not self._ended and (wait := self.supervisor.restart(death)) is not None:
            self._ready.pop(name, None)
            how = f"{hung} ({death.text})" if hung else death.text
            self._console.say(f"[{name}] {how}; starting it again in {wait:g} s", important=True)
            return
        if death.code != 0 or node.required:
            words = self._last_words.get(name)
            reason = hung or (words.reason if words else self._last_output(name)) or UNASKED
            self.fail(Failure(name, reason, death.text, usage=death.code == 2))
        if not self._ended and (node.required or not self._going):
            self._ended = f"{name} failed"
        elif not self._ended:
            self._console.say(f"[{name}] {death.text}; the others go on without it", important=True)

    def fail(self, failure: Failure) -> None:
        """Note the first failure; later ones are often its consequences."""
        if self.failure is None:
            self.failure = failure

    def _last_output(self, name: str) -> str:
        try:
            lines = self._own.run.output_of(name).read_text(errors="replace").split("\n")
        except OSError:
            return ""
        said = [line.strip() for line in reversed(lines) if line.strip()]
        crashes = [line for line in said if line.startswith("Fatal Python error")]
        return next(iter(crashes + said), "")

    @property
    def sim_seconds(self) -> float:
        """Simulated time so far [s]."""
        return self._sim_ns * 1e-9

    @property
    def _factor(self) -> float:
        return self.sim_seconds / max(monotonic() - self._started, 1e-3)

    def _show_status(self) -> None:
        agents = self._score.present if self._score else None
        self._console.status(
            status_text(self.sim_seconds, self._factor, agents, self._counts.dropped, self.graph.duration)
        )

    def _count_own(self) -> None:
        """The launcher publishes and listens too."""
        inputs = [
            InputStats(i.edge.topic, i.edge.publisher, i.received, i.dropped, i.skipped, i.rejected, None)
            for i in self.bus.inlets
        ]
        outputs = [
            OutputStats(
                source.partition("@")[0], sequence + 1, self.bus.bytes_sent[source.partition("@")[0]], 0
            )
            for source, sequence in self.bus.sent.items()
        ]
        self._counts.take(Diagnostics(LAUNCHER, os.getpid(), 0, 0.0, 0.0, 0.0, 0, inputs, outputs))

    def _summary(self) -> Summary:
        self._count_own()
        wall = self._finished - self._started if self._going else 0.0
        return Summary(
            graph=self.graph.name,
            sim_seconds=self.sim_seconds,
            start_seconds=self._started - self._begun,
            wall_seconds=wall,
            real_time_factor=self.sim_seconds / wall if wall else 0.0,
            dropped=self._counts.dropped,
            topics=self._counts.topics(),
            restarts={name: n for name, n in self.supervisor.restarts.items() if n},
            first_failure=self.failure,
            ended=self._ended or "failed",
            signal=self.interrupted,
            log=str(self._log) if self._log else None,
            run_dir=self.graph.run_dir,
            **score_facts(self._score),
        )
