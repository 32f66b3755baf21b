"""The bus between processes: one XPUB socket a topic on a Unix socket in the run directory, no broker.

Every publisher has an open socket a topic, which drops what a slow subscriber does not take, and one more
for each reliable subscriber, on which it waits. While a node works, a thread keeps emptying its sockets, so
that `latest` really is the latest however long the work takes.
"""

import logging
import os
import select
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from time import monotonic, monotonic_ns
from typing import Any, NoReturn

import msgspec
import zmq

from .bus import LIFE_BITS, Bound, BusError, Inlet, PortError
from .codec import Codec
from .config import near
from .graph import Edge, Graph, edges
from .secure import ClientKeys, Gate, present_keys, require_keys
from .sockets import (
    MARK,
    OPEN_BYTES,
    OPEN_HWM,
    RELIABLE_HWM,
    bind,
    endpoint,
    part_of,
    publishing,
    readable,
    receive_parts,
    send_parts,
    subscribe_newcomer,
    subscribing,
)
from .topics import TOPICS, Topic

__all__ = ["ZmqBus", "endpoint"]

log = logging.getLogger(__name__)

DRAIN_PERIOD = 0.003
"""How often the sockets are emptied while the node works [s]."""
SERVICE_PERIOD = 0.02
"""How often publishing sockets are asked for newcomers whose signal sending has swallowed [s]."""
SPIN_FIRST, SPIN_MOST = 5e-5, 1e-3
"""Where the last messages came at once, the next is looked out for so long before the node goes to sleep [s]."""
SPIN_PER_BYTE = 2e-9
"""And so much longer for each byte this node sent last: those who answer have to read and copy it [s]."""
_LATEST_HWM = 32
_BURST = 1000
_forks = 0


def _count_fork() -> None:
    global _forks
    _forks += 1


os.register_at_fork(after_in_child=_count_fork)


@dataclass(slots=True, eq=False)
class _Outlet:
    """One publishing socket."""

    socket: zmq.Socket
    edge: Edge | None
    """The reliable edge it serves; None for an open socket."""
    latched: bool
    expected: set[str]
    """Declared subscribers, `node/port`: the start barrier waits for them."""
    present: Counter[str] = field(default_factory=Counter)
    """Those who are there and said who they are."""
    subscribers: int = 0
    stalled: bool = False
    last: Sequence[Any] | None = None
    """Latched topics: the last message, for newcomers."""

    @property
    def missing(self) -> set[str]:
        """Declared subscribers who are not there."""
        return {name for name in self.expected if not self.present[name]}


@dataclass(slots=True, eq=False)
class _Output:
    """One topic this node publishes."""

    topic: Topic
    codec: Codec
    first: int
    """Sequence number of the first message of this life."""
    sequence: int
    """Sequence number of the last message."""
    outlets: list[_Outlet] = field(default_factory=list)
    largest: int = 0
    """Size of the largest message so far [bytes]."""
    bytes: int = 0
    """Sent so far."""


class ZmqBus:
    """A node's sockets; see `Bus` for the contract.

    Args:
        graph: The resolved graph; its `run_dir` holds the sockets.
        node: Which node this is.
        topics: Topics by name, built-in and custom.
        restarts: How often this node was restarted; its sequence numbers show it.

    Raises:
        PortError: a socket cannot be opened as the graph says.
    """

    def __init__(
        self, graph: Graph, node: str, topics: Mapping[str, Topic] = TOPICS, restarts: int = 0
    ) -> None:
        self.inlets: list[Inlet] = []
        self.refused: dict[str, int] = {}
        """Messages given up because a reliable subscriber did not take them or was away, by topic."""
        self._graph = graph
        self._node = node
        self._forks = _forks
        self._context = zmq.Context()
        self._lock = threading.Lock()
        self._signals = select.epoll()
        self._on_signal: dict[int, Callable[[int], object]] = {}
        self._backlog: dict[zmq.Socket, Inlet] = {}
        """Sockets that were not read to the end; no signal will come for what is in them."""
        self._next_service = 0.0
        self._spin = 0.0
        self._spin_most = SPIN_MOST
        self._readers: dict[zmq.Socket, Inlet] = {}
        self._publishers: dict[zmq.Socket, _Outlet] = {}
        self._outputs: dict[str, _Output] = {}
        self._gate: Gate | None = None
        self._closing = threading.Event()
        self._drainer = threading.Thread(target=self._drain_while_working, name="bus-drain", daemon=True)
        wires = edges(graph)
        try:
            for port, name in graph.node(node).outputs.items():
                mine = [edge for edge in wires if (edge.topic, edge.publisher) == (name, node)]
                self._outputs[port] = self._open(topics[name], mine, restarts << LIFE_BITS)
            for port, address in graph.node(node).expose.items():
                self._expose(port, address)
            for edge in wires:
                if edge.subscriber == node:
                    self.connect(edge, topics[edge.topic])
        except BaseException:
            self._signals.close()
            self._context.destroy(linger=0)
            raise
        self._drainer.start()

    def _open(self, topic: Topic, wires: Sequence[Edge], first: int) -> _Output:
        output = _Output(topic, Codec(topic.name, topic.type), first, first - 1)
        unreliable = {_identity(edge) for edge in wires if not edge.reliable}
        socket = publishing(self._context, OPEN_HWM, wait=False, linger=1.0, latched=topic.latched)
        self._add_outlet(output, _Outlet(socket, None, topic.latched, unreliable))
        bind(socket, endpoint(self._graph.run_dir, topic.name, self._node), topic.name)
        reliable = sorted((edge for edge in wires if edge.reliable), key=lambda edge: edge.subscriber)
        for subscriber, group in groupby(reliable, key=lambda edge: edge.subscriber):
            ports = list(group)
            hwm = max(RELIABLE_HWM, *(edge.input.depth for edge in ports))
            linger = max(1.0, *(edge.input.timeout for edge in ports))
            socket = publishing(self._context, hwm, wait=True, linger=linger, latched=topic.latched)
            self._add_outlet(
                output, _Outlet(socket, ports[0], topic.latched, {_identity(edge) for edge in ports})
            )
            bind(socket, endpoint(self._graph.run_dir, topic.name, self._node, subscriber), topic.name)
        return output

    def _expose(self, port: str, address: str) -> None:
        output = self._output(port)
        security = require_keys(f"{self._node}: {port}", address, self._graph.security)
        if self._gate is None:
            self._gate = Gate(self._context, security)
            self._watch(self._gate.socket, lambda _, gate=self._gate: gate.serve())
        socket = publishing(self._context, OPEN_HWM, wait=False, linger=1.0, latched=output.topic.latched)
        self._gate.protect(socket)
        self._add_outlet(output, _Outlet(socket, None, output.topic.latched, set()))
        bind(socket, address, output.topic.name)

    def _add_outlet(self, output: _Output, outlet: _Outlet) -> None:
        output.outlets.append(outlet)
        self._publishers[outlet.socket] = outlet
        self._watch(outlet.socket, lambda _: self._serve(outlet))

    def _watch(self, socket: zmq.Socket, on_signal: Callable[[int], object]) -> None:
        """Call `on_signal` when something has happened to a socket.

        One epoll call serves any number of sockets, where `zmq_poll` asks each of them twice. ZeroMQ's
        descriptor signals once, so who is called has to read the socket to the end.
        """
        number = int(socket.getsockopt(zmq.FD))  # type: ignore[arg-type]
        self._on_signal[number] = on_signal
        self._signals.register(number, select.EPOLLIN | select.EPOLLET)

    def connect(
        self, edge: Edge, topic: Topic, address: str | None = None, keys: ClientKeys | None = None
    ) -> Inlet:
        """Subscribe one edge.

        Args:
            edge: Topic, publisher and policy.
            topic: What comes.
            address: Where the publisher exposes it, instead of the place in the run directory.
            keys: Needed where it is exposed.

        Raises:
            PortError: the address or a key cannot be used.
        """
        depth = edge.input.depth
        if edge.reliable:
            hwm = max(RELIABLE_HWM, depth)
        else:
            hwm = max(_LATEST_HWM, depth if edge.input.policy == "queue" else 0)
        socket = subscribing(self._context, hwm, _identity(edge))
        own = edge.subscriber if edge.reliable else None
        try:
            if keys is not None:
                present_keys(socket, keys)
            socket.connect(address or endpoint(self._graph.run_dir, edge.topic, edge.publisher, own))
        except zmq.ZMQError as error:
            socket.close()
            raise PortError(f"cannot listen to {edge.topic} at {address}: {error}") from None
        except PortError:
            socket.close()
            raise
        inlet = Inlet(edge, Codec(edge.topic, topic.type), edge.reliable, trusting=address is None)
        with self._lock:
            self.inlets.append(inlet)
            self._readers[socket] = inlet
            self._backlog[socket] = inlet
            self._watch(socket, partial(self._read, socket, inlet))
        return inlet

    def wait_connected(self, timeout: float) -> list[str]:
        """The start barrier: wait until every declared subscriber is there; returns what is missing."""
        deadline = monotonic() + timeout
        while True:
            missing = [
                f"{output.topic.name}: {', '.join(sorted(outlet.missing))} has not subscribed"
                for output in self._outputs.values()
                for outlet in output.outlets
                if outlet.missing
            ]
            if not missing or monotonic() > deadline:
                return missing
            self.poll(0.01, lambda: False)

    def publish(self, topic: Topic, message: msgspec.Struct, stamp_ns: int) -> int:
        """See `Bus.publish`."""
        if self._forks != _forks:
            self._refuse_fork()
        output = self._outputs.get(topic.name) or self._output(topic.name)
        codec, latched = output.codec, output.topic.latched
        sequence = output.sequence + 1
        head, arrays = codec.pack(message, sequence, stamp_ns, monotonic_ns())
        output.sequence = sequence
        size = len(head)
        parts: list[Any] = [bytes(head) if latched else head]
        for array in arrays:
            size += array.nbytes
            parts.append(part_of(array, kept=latched))
        with self._lock:
            if size > output.largest:
                self._bound_memory(output, size)
            for outlet in output.outlets:
                if outlet.subscribers:
                    self._send(codec.topic, outlet, parts)
                elif outlet.edge is not None and not latched and outlet.present:
                    self.refused[codec.topic] = self.refused.get(codec.topic, 0) + 1
                if latched:
                    outlet.last = parts
        output.bytes += size
        self._spin_most = SPIN_MOST + SPIN_PER_BYTE * size
        return sequence

    def _output(self, port: str) -> _Output:
        try:
            return self._outputs[port]
        except KeyError:
            raise BusError(
                f"{self._node} has no output {port!r} in this graph; {near(port, self._outputs)}"
            ) from None

    def _bound_memory(self, output: _Output, size: int) -> None:
        """Keep fewer of large messages for those who lag."""
        output.largest = size
        hwm = max(2, OPEN_BYTES // size)
        for outlet in output.outlets:
            if hwm < outlet.socket.getsockopt(zmq.SNDHWM):  # type: ignore[operator]
                outlet.socket.setsockopt(zmq.SNDHWM, hwm)

    def _send(self, topic: str, outlet: _Outlet, parts: Sequence[Any]) -> None:
        """Send on one socket; for a reliable subscriber wait, receiving meanwhile. Needs the lock."""
        deadline = None
        while True:
            try:
                send_parts(outlet.socket, parts)
                outlet.stalled = False
                return
            except zmq.Again:
                if outlet.edge is None:
                    return
            edge = outlet.edge
            deadline = deadline or monotonic() + edge.input.timeout
            if outlet.stalled or monotonic() > deadline:
                self.refused[topic] = self.refused.get(topic, 0) + 1
                text = f"{edge.subscriber} has not taken {topic} for {edge.input.timeout:g} s"
                if edge.in_step:
                    raise BusError(f"{text}; lockstep cannot go on without it")
                if not outlet.stalled:
                    log.error("%s; its messages are given up until it reads again", text)
                outlet.stalled = True
                return
            self._receive(SERVICE_PERIOD)
            if not outlet.subscribers:
                return

    def poll(self, timeout: float, ready: Callable[[], bool] | None = None) -> bool:
        """See `Bus.poll`."""
        if self._forks != _forks:
            self._refuse_fork()
        ready = ready or self._any_pending
        with self._lock:
            deadline = monotonic() + timeout
            self._receive(0 if ready() else min(timeout, SERVICE_PERIOD))
            while not ready():
                left = deadline - monotonic()
                if left <= 0:
                    return False
                self._receive(min(left, SERVICE_PERIOD))
            return True

    def _any_pending(self) -> bool:
        for inlet in self.inlets:  # noqa: SIM110 - three times as fast as any()
            if inlet.pending:
                return True
        return False

    def _receive(self, timeout: float) -> None:
        """Take in what has come, or else wait for the first to come [s]; the caller holds the lock."""
        if self._backlog and self._read_backlog():
            timeout = 0
        limit = 1 if timeout else _BURST  # what one waited for is worked on before looking for more
        signals = self._signals.poll(0, 64)
        if timeout and not signals:
            signals = self._wait(timeout)
        for number, _ in signals:
            self._on_signal[number](limit)
        now = monotonic()
        if now > self._next_service:
            self._next_service = now + SERVICE_PERIOD
            for outlet in self._publishers.values():
                self._serve(outlet)

    def _wait(self, timeout: float) -> list[tuple[int, int]]:
        """Signals, as soon as there are some.

        Falling asleep and being woken takes longer than most answers, so a node that has been answered at
        once stays awake for a while, letting others have the core whenever they want it. Where messages are
        far apart it does not: the while doubles with each short wait and is nothing after a long one.
        """
        poll, begin = self._signals.poll, monotonic()
        now, awake = begin, begin + min(self._spin, timeout)
        signals: list[tuple[int, int]] = []
        while not signals and now < awake:
            os.sched_yield()
            signals = poll(0, 64)
            now = monotonic()
        if not signals:
            signals = poll(max(0.0, begin + timeout - now), 64)
            now = monotonic()
        short = bool(signals) and now - begin < self._spin_most
        self._spin = min(self._spin_most, SPIN_FIRST + 2.0 * self._spin) if short else 0.0
        return signals

    def _read_backlog(self) -> bool:
        """Read on where reading stopped; says whether there was anything."""
        backlog, self._backlog = self._backlog, {}
        found = False
        for socket, inlet in backlog.items():
            if inlet.bounded and inlet.full:
                self._backlog[socket] = inlet
            elif readable(socket):
                found = True
                self._read(socket, inlet, _BURST)
        return found

    def _read(self, socket: zmq.Socket, inlet: Inlet, limit: int) -> None:
        """Read at most so many messages."""
        while not (inlet.bounded and inlet.full):  # the rest stays unread: its publisher has to wait
            try:
                inlet.put(receive_parts(socket))
            except zmq.Again:
                return
            limit -= 1
            if not limit:
                break
            if not readable(socket):
                return
        self._backlog[socket] = inlet

    def _serve(self, outlet: _Outlet) -> None:
        """Notice who comes and goes; a newcomer to a latched topic gets the last message."""
        while readable(outlet.socket):
            event = outlet.socket.recv(zmq.DONTWAIT)
            change = {b"\x01": 1, b"\x00": -1}.get(event[:1], 0)
            if event[1:2] == MARK:
                outlet.present[event[2:].decode(errors="replace")] += change
            elif change and len(event) == 1:
                outlet.subscribers += change
                if change > 0 and outlet.latched:
                    subscribe_newcomer(outlet.socket, outlet.last)

    def _drain_while_working(self) -> None:
        while not self._closing.wait(DRAIN_PERIOD):
            if self._lock.acquire(blocking=False):
                try:
                    self._receive(0)
                except Exception:
                    log.exception("receiving failed")
                finally:
                    self._lock.release()

    def _refuse_fork(self) -> NoReturn:
        raise BusError(f"the bus of {self._node} belongs to the process that opened it, not to a fork")

    @property
    def sent(self) -> Bound:
        """See `Bus.sent`."""
        return {
            f"{output.topic.name}@{self._node}": output.sequence
            for output in self._outputs.values()
            if output.sequence >= output.first
        }

    @property
    def bytes_sent(self) -> dict[str, int]:
        """By topic."""
        return {output.topic.name: output.bytes for output in self._outputs.values() if output.bytes}

    def subscribers(self, name: str) -> int:
        """How many subscribe a topic of this node now."""
        return sum(
            outlet.subscribers
            for output in self._outputs.values()
            if output.topic.name == name
            for outlet in output.outlets
        )

    def close(self) -> None:
        """See `Bus.close`."""
        if self._forks != _forks or self._closing.is_set():
            return
        self._closing.set()
        self._drainer.join()
        for socket in [*self._readers, *self._publishers, *([self._gate.socket] if self._gate else [])]:
            socket.close()
        self._signals.close()
        self._context.term()


def _identity(edge: Edge) -> str:
    return f"{edge.subscriber}/{edge.port}"
