"""What a node needs of a bus, and what every bus does the same way: buffers, policies, counting."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from .codec import Buffer, Codec, Header, MessageError
from .graph import Edge
from .schema import compatible
from .topics import Topic

M = TypeVar("M", bound=msgspec.Struct)

LIFE_BITS = 32
"""A publisher that was restarted n times counts its messages from n << LIFE_BITS."""

LEAP_LIVES, LEAP_MESSAGES = 1000, 1 << 24
"""A sequence number this far ahead, in restarts or in messages, is believed when the next one follows it."""

Bound = dict[str, int]
"""Last sequence number by `topic@publisher`: what belongs before a lockstep tick."""


class BusError(RuntimeError):
    """The bus cannot do what was asked: a subscriber too slow in lockstep, a socket that cannot be bound."""


class PortError(BusError, ValueError):
    """A socket that cannot be opened as configured: address taken, path too long, keys missing."""


class Received(msgspec.Struct, Generic[M], frozen=True):
    """A message with where it came from."""

    port: str
    """The topic as the node's code calls it."""
    topic: str
    publisher: str
    sequence: int
    stamp_ns: int
    sent_ns: int
    message: M

    @property
    def source(self) -> str:
        """`topic@publisher`."""
        return f"{self.topic}@{self.publisher}"


@dataclass(slots=True, eq=False)
class Inlet:
    """The receiving end of one edge: checks headers, counts gaps, keeps what the policy keeps."""

    edge: Edge
    codec: Codec
    keep_all: bool
    """Transport keeps everything (reliable edges); `take` then applies `latest` and `queue`."""
    trusting: bool = False
    """Believe a sender who says that its arrays are free of NaN."""
    pending: deque[tuple[Header, Buffer, Sequence[Buffer]]] = field(default_factory=deque)
    received: int = 0
    dropped: int = 0
    skipped: int = 0
    rejected: int = 0
    last_sequence: int = -1
    last_sent_ns: int | None = None
    faults: list[MessageError] = field(default_factory=list)
    """Rejections since they were last collected; at most a few are kept."""
    source: str = field(init=False)
    """`topic@publisher`."""
    limit: int | None = field(init=False)
    """How many messages the policy lets a step see; None for all."""
    bounded: bool = field(init=False)
    """Whether a full inlet stops reading so that the publisher feels the back-pressure.

    Never in lockstep, where the tick bounds what can come and the clock waits for all of it.
    """
    _newest: int = -1
    """Sequence number that really came last."""
    _suspect: int = -1
    """Sequence number that was too far ahead to be believed at once."""
    _noted: bytes = b""
    """Schema of the sender that was last reported as not quite ours."""

    def __post_init__(self) -> None:
        edge = self.edge
        self.source = f"{edge.topic}@{edge.publisher}"
        self.limit = {"latest": 1, "queue": edge.input.depth, "reliable": None}[edge.input.policy]
        self.bounded = edge.input.policy == "reliable" and not edge.in_step

    @property
    def full(self) -> bool:
        """Whether reading must stop."""
        return self.bounded and len(self.pending) >= self.edge.input.depth

    def put(self, parts: Sequence[Buffer]) -> None:
        """Take one message off the wire."""
        head = parts[0]
        try:
            header = Header.unpack(self.edge.topic, head)
            self._count(header)
            if header.schema != self.codec.schema:
                self._check_schema(header.schema)
            if header.frames != len(parts) - 1:
                raise MessageError(
                    self.edge.topic, "frames", f"header says {header.frames}, {len(parts) - 1} came"
                )
        except MessageError as error:
            self.reject(error)
            return
        self.received += 1
        pending = self.pending
        if pending and not self.keep_all and self.limit is not None and len(pending) >= self.limit:
            pending.popleft()
            self.skipped += 1
        pending.append((header, memoryview(head)[Header.SIZE :], parts[1:]))

    def _count(self, header: Header) -> None:
        """Notice gaps; a restarted publisher begins anew.

        Raises:
            MessageError: the message has come before, or its number is too far ahead to be believed yet.
        """
        newest, sequence = self._newest, header.sequence
        if sequence <= newest:
            raise MessageError(
                self.edge.topic, "header.sequence", f"{sequence} came after {newest}; it is left aside"
            )
        if sequence > newest + 1 and newest >= 0:
            lives = (sequence >> LIFE_BITS) - (newest >> LIFE_BITS)
            far = lives > LEAP_LIVES or (not lives and sequence - newest > LEAP_MESSAGES)
            if far and sequence != self._suspect + 1:  # one broken number must not shut out all that follow
                self._suspect = sequence
                text = f"{sequence} came after {newest}; it is left aside unless the next one follows it"
                raise MessageError(self.edge.topic, "header.sequence", text)
            if not lives:
                self.dropped += sequence - newest - 1
        self._newest = sequence
        if sequence > self.last_sequence:
            self.last_sequence = sequence
        self.last_sent_ns = header.sent_ns

    def _check_schema(self, theirs: bytes) -> None:
        """Let messages through that differ in fields with defaults only, and say so once.

        Raises:
            MessageError: the required fields differ.
        """
        ours, edge = self.codec.schema, self.edge
        name = self.codec.type.__name__
        sides = f"{edge.publisher} sends {name} as {theirs.hex()}, {edge.subscriber} knows it as {ours.hex()}"
        if not compatible(ours, theirs):
            raise MessageError(edge.topic, "schema", f"{sides}; run both from one release")
        if theirs != self._noted:
            self._noted = theirs
            text = f"{sides}: fields with defaults differ; reading what fits"
            self._tell(MessageError(edge.topic, "schema", text))

    def reject(self, error: MessageError) -> None:
        """Count a message that is not what the topic promises."""
        self.rejected += 1
        self._tell(error)

    def _tell(self, error: MessageError) -> None:
        if len(self.faults) < 8:
            self.faults.append(error)

    def take(self, bound: Bound | None) -> list[Received[Any]]:
        """Decode what a step shall see; with a bound nothing past it."""
        edge, pending = self.edge, self.pending
        last = bound.get(self.source, -1) if bound is not None and edge.in_step else None
        ready = []
        while pending and (last is None or pending[0][0].sequence <= last):
            ready.append(pending.popleft())
        if self.limit is not None and len(ready) > self.limit:
            self.skipped += len(ready) - self.limit
            ready = ready[-self.limit :]
        taken = []
        for header, body, frames in ready:
            schema = None if header.schema == self.codec.schema else header.schema
            finite = header.checked and self.trusting
            try:
                message = self.codec.decode(body, frames, schema=schema, finite=finite)
            except MessageError as error:
                self.reject(error)
                continue
            taken.append(
                Received(
                    edge.port,
                    edge.topic,
                    edge.publisher,
                    header.sequence,
                    header.stamp_ns,
                    header.sent_ns,
                    message,
                )
            )
        return taken


class Bus(Protocol):
    """The rim of a node: `ZmqBus` between processes, `MemoryBus` within one. It belongs to one thread."""

    inlets: list[Inlet]

    def publish(self, topic: Topic[M], message: M, stamp_ns: int) -> int:
        """Send a message; returns its sequence number.

        Arrays that can still be written to are copied, so that the caller may go on working in them.
        Read-only arrays (`array.flags.writeable = False`) are not, and are looked through for NaN once: freeze
        large ones to save both.

        Raises:
            MessageError: the message is not what its topic promises.
            BusError: the node has no such output; a reliable subscriber did not take the message in time
                (lockstep only).
        """
        ...

    def poll(self, timeout: float, ready: Callable[[], bool] | None = None) -> bool:
        """Receive until `ready` (default: something is pending) or `timeout` [s] is over; says which."""
        ...

    @property
    def sent(self) -> Bound:
        """Last sequence number sent on each `topic@node`."""
        ...

    def close(self) -> None:
        """Let go of sockets; what has been sent is still delivered."""
        ...


def take(bus: Bus, bound: Bound | None = None) -> list[Received[Any]]:
    """Everything pending, decoded, in the order (stamp, topic, publisher, sequence).

    Args:
        bus: Where from.
        bound: Lockstep: take nothing that other participants sent past these sequence numbers.
    """
    taken = [message for inlet in bus.inlets if inlet.pending for message in inlet.take(bound)]
    if len(taken) > 1:
        taken.sort(key=lambda m: (m.stamp_ns, m.topic, m.publisher, m.sequence))
    return taken


def arrived(bus: Bus, bound: Bound) -> bool:
    """Whether everything up to `bound` has come in."""
    return all(inlet.last_sequence >= bound.get(inlet.source, -1) for inlet in bus.inlets)
