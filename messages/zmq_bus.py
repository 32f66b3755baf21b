"""The bus between processes: one XPUB socket a topic on a Unix socket in the run directory, no broker.

Every publisher has an open socket a topic, which drops what a slow subscriber does not take, and one more
for each reliable subscriber, on which it waits. While a node works, a thread keeps emptying its sockets, so
that `latest` really is the latest however long the work takes.
"""

import logging
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, monotonic_ns
from typing import Any

import msgspec
import numpy as np
import zmq

from .bus import LIFE_BITS, Bound, BusError, Inlet
from .codec import Buffer, Codec, Header
from .graph import Edge, Graph, edges
from .topics import TOPICS, Topic

log = logging.getLogger(__name__)

DRAIN_PERIOD = 0.003
"""How often the sockets are emptied while the node works [s]."""
OPEN_HWM = 1000
"""Messages an open socket keeps for a subscriber that lags."""
MAX_MESSAGE = 1 << 28
"""Largest frame accepted [bytes]."""
_UNIX_PATH_MAX = 107


def endpoint(run_dir: str | Path, topic: str, publisher: str, subscriber: str | None = None) -> str:
    """Address of a publisher's open socket, or of the one kept for a reliable subscriber.

    Raises:
        BusError: the path is longer than a Unix socket's may be.
    """
    path = f"{run_dir}/{topic}@{publisher}" + (f">{subscriber}" if subscriber else "")
    if len(os.fsencode(path)) > _UNIX_PATH_MAX:
        raise BusError(
            f"{path}: longer than {_UNIX_PATH_MAX} bytes; choose a shorter run directory or node name"
        )
    return f"ipc://{path}"


@dataclass(slots=True, eq=False)
class _Outlet:
    """One publishing socket."""

    socket: zmq.Socket
    topic: Topic
    edge: Edge | None
    """The reliable edge it serves; None for the open socket."""
    expected: int
    """Declared subscribers: the start barrier waits for them."""
    last: list[Any] | None = None
    """Latched topics: the last message, for newcomers."""
    subscribers: int = 0
    stalled: bool = False


class ZmqBus:
    """A node's sockets; see `Bus` for the contract.

    Args:
        graph: The resolved graph; its `run_dir` holds the sockets.
        node: Which node this is.
        topics: Topics by name, built-in and custom.
        restarts: How often this node was restarted; its sequence numbers show it.

    Raises:
        BusError: a socket cannot be bound.
    """

    def __init__(
        self, graph: Graph, node: str, topics: Mapping[str, Topic] = TOPICS, restarts: int = 0
    ) -> None:
        self.inlets: list[Inlet] = []
        self.bytes_sent: dict[str, int] = {}
        self.refused: dict[str, int] = {}
        self._run_dir = graph.run_dir
        self._node = node
        self._first_sequence = restarts << LIFE_BITS
        self._context = zmq.Context()
        self._lock = threading.Lock()
        self._poller = zmq.Poller()
        self._readers: dict[zmq.Socket, Inlet] = {}
        self._publishers: dict[zmq.Socket, _Outlet] = {}
        self._outlets: dict[str, list[_Outlet]] = {}
        self._codecs: dict[str, Codec] = {}
        self._names: dict[str, str] = {}
        self._sequence: dict[str, int] = {}
        self._closing = threading.Event()
        wires = edges(graph)
        for port, name in graph.node(node).outputs.items():
            self._names[port] = name
            self._open_outlets(topics[name], [e for e in wires if (e.topic, e.publisher) == (name, node)])
        for edge in wires:
            if edge.subscriber == node:
                self.connect(edge, topics[edge.topic])
        self._drainer = threading.Thread(target=self._drain_while_working, name="bus-drain", daemon=True)
        self._drainer.start()

    def connect(self, edge: Edge, topic: Topic, address: str | None = None) -> Inlet:
        """Subscribe one edge; `address` overrides the place in the run directory."""
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.RCVHWM, max(edge.input.depth, 64) if edge.reliable else OPEN_HWM)
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RECONNECT_IVL, 10)
        socket.setsockopt(zmq.RECONNECT_IVL_MAX, 200)
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        own = edge.subscriber if edge.reliable else None
        socket.connect(address or endpoint(self._run_dir, edge.topic, edge.publisher, own))
        inlet = Inlet(edge, Codec(edge.topic, topic.type), edge.reliable)
        with self._lock:
            self.inlets.append(inlet)
            self._readers[socket] = inlet
            self._poller.register(socket, zmq.POLLIN)
        return inlet

    def _open_outlets(self, topic: Topic, wires: Sequence[Edge]) -> None:
        self._codecs[topic.name] = Codec(topic.name, topic.type)
        reliable = [edge for edge in wires if edge.reliable]
        for edge in [None, *reliable]:
            socket = self._context.socket(zmq.XPUB)
            socket.setsockopt(zmq.XPUB_VERBOSER, 1)
            socket.setsockopt(zmq.LINGER, 1000)
            socket.setsockopt(zmq.SNDHWM, max(edge.input.depth, 64) if edge else OPEN_HWM)
            if edge:
                socket.setsockopt(zmq.XPUB_NODROP, 1)
            if topic.latched:
                socket.setsockopt(zmq.XPUB_MANUAL_LAST_VALUE, 1)
            address = endpoint(self._run_dir, topic.name, self._node, edge and edge.subscriber)
            try:
                socket.bind(address)
            except zmq.ZMQError as error:
                raise BusError(f"cannot publish {topic.name} at {address}: {error}") from None
            outlet = _Outlet(socket, topic, edge, expected=1 if edge else len(wires) - len(reliable))
            self._publishers[socket] = outlet
            self._outlets.setdefault(topic.name, []).append(outlet)
            self._poller.register(socket, zmq.POLLIN)

    def wait_connected(self, timeout: float) -> list[str]:
        """The start barrier: wait until every declared subscriber is there; returns what is missing."""
        deadline = monotonic() + timeout
        while True:
            missing = [
                f"{outlet.topic.name}: {outlet.subscribers} of {outlet.expected} subscribers"
                for outlet in self._publishers.values()
                if outlet.subscribers < outlet.expected
            ]
            if not missing or monotonic() > deadline:
                return missing
            self.poll(0.01)

    def publish(self, topic: Topic, message: msgspec.Struct, stamp_ns: int) -> int:
        """See `Bus.publish`."""
        name = self._names.get(topic.name, topic.name)
        codec = self._codecs[name]
        body, arrays = codec.encode(message)
        sequence = self._sequence.get(name, self._first_sequence - 1) + 1
        self._sequence[name] = sequence
        header = Header(sequence, stamp_ns, monotonic_ns(), codec.schema, len(arrays))
        parts: list[Any] = [header.pack() + body]
        self.bytes_sent[name] = self.bytes_sent.get(name, 0) + len(parts[0]) + sum(a.nbytes for a in arrays)
        outlets = self._outlets[name]
        if arrays and (topic.latched or any(outlet.subscribers for outlet in outlets)):
            parts += [_frame(array) for array in arrays]
        with self._lock:
            for outlet in outlets:
                if topic.latched:
                    outlet.last = parts
                if outlet.subscribers:
                    self._send(outlet, parts)
        return sequence

    def _send(self, outlet: _Outlet, parts: list[Any]) -> None:
        """Send on one socket, waiting for a reliable subscriber; holds the lock but while it waits."""
        deadline = None
        while True:
            try:
                outlet.socket.send_multipart(parts, zmq.DONTWAIT, copy=False)
                outlet.stalled = False
                return
            except zmq.Again:
                if outlet.edge is None:
                    return
            edge = outlet.edge
            deadline = deadline or monotonic() + edge.input.timeout
            if outlet.stalled or monotonic() > deadline:
                self.refused[edge.topic] = self.refused.get(edge.topic, 0) + 1
                text = f"{edge.subscriber} has not taken {edge.topic} for {edge.input.timeout:g} s"
                if edge.in_step:
                    raise BusError(f"{text}; lockstep cannot go on without it")
                if not outlet.stalled:
                    log.error("%s; its messages are given up until it reads again", text)
                outlet.stalled = True
                return
            self._receive(0)
            self._lock.release()
            try:
                outlet.socket.poll(5, zmq.POLLOUT)
            finally:
                self._lock.acquire()
            if not outlet.subscribers:
                return

    def poll(self, timeout: float, ready: Callable[[], bool] | None = None) -> bool:
        """See `Bus.poll`."""
        ready = ready or self._any_pending
        deadline = monotonic() + timeout
        with self._lock:
            self._receive(0)
            while not ready():
                left = deadline - monotonic()
                if left <= 0:
                    return False
                self._receive(max(1, int(left * 1000)))
            return True

    def _any_pending(self) -> bool:
        return any(inlet.pending for inlet in self.inlets)

    def _receive(self, timeout_ms: int) -> None:
        """Take in whatever has come; the caller holds the lock."""
        for socket, _ in self._poller.poll(timeout_ms):
            inlet = self._readers.get(socket)  # type: ignore[arg-type]
            if inlet is None:
                self._serve(self._publishers[socket])  # type: ignore[index]
                continue
            while not inlet.full:
                try:
                    parts: list[Buffer] = [socket.recv(zmq.DONTWAIT)]  # type: ignore[union-attr]
                except zmq.Again:
                    break
                while socket.getsockopt(zmq.RCVMORE):  # type: ignore[union-attr]
                    parts.append(socket.recv(copy=False).buffer)  # type: ignore[union-attr]
                inlet.put(parts)

    def _serve(self, outlet: _Outlet) -> None:
        """Count those who come and go; a newcomer to a latched topic gets the last message."""
        while True:
            try:
                event = outlet.socket.recv(zmq.DONTWAIT)
            except zmq.Again:
                return
            joined = event[:1] == b"\x01"
            outlet.subscribers = max(0, outlet.subscribers + (1 if joined else -1))
            if joined and outlet.topic.latched:
                outlet.socket.setsockopt(zmq.SUBSCRIBE, b"")
                if outlet.last is not None:
                    outlet.socket.send_multipart(outlet.last, copy=False)

    def _drain_while_working(self) -> None:
        while not self._closing.wait(DRAIN_PERIOD):
            if self._lock.acquire(blocking=False):
                try:
                    self._receive(0)
                finally:
                    self._lock.release()

    @property
    def sent(self) -> Bound:
        """See `Bus.sent`."""
        return {f"{name}@{self._node}": sequence for name, sequence in self._sequence.items()}

    def subscribers(self, name: str) -> int:
        """How many subscribe a topic of this node now."""
        return sum(outlet.subscribers for outlet in self._outlets[name])

    def close(self) -> None:
        """See `Bus.close`."""
        self._closing.set()
        self._drainer.join()
        for socket in [*self._readers, *self._publishers]:
            socket.close()
        self._context.term()


def _frame(array: np.ndarray) -> zmq.Frame:
    """An array as a frame, without a copy where nobody can change it any more."""
    if array.flags.owndata:
        array.flags.writeable = False
    elif array.flags.writeable:
        array = array.copy()
    return zmq.Frame(memoryview(array).cast("B") if array.nbytes else b"", copy=False)  # type: ignore[arg-type]
