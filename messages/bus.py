"""What a node needs of a bus, and what every bus does the same way: buffers, policies, counting."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from .codec import Buffer, Codec, Header, MessageError
from .graph import Edge
from .topics import Topic

M = TypeVar("M", bound=msgspec.Struct)

LIFE_BITS = 32
"""A publisher that was restarted n times counts its messages from n << LIFE_BITS."""

Bound = dict[str, int]
"""Last sequence number by `topic@publisher`: what belongs before a lockstep tick."""


class BusError(RuntimeError):
    """The bus cannot do what was asked: a subscriber too slow in lockstep, a socket that cannot be bound."""


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
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
    pending: deque[tuple[Header, Buffer, Sequence[Buffer]]] = field(default_factory=deque)
    received: int = 0
    dropped: int = 0
    skipped: int = 0
    rejected: int = 0
    last_sequence: int = -1
    last_sent_ns: int | None = None
    faults: list[MessageError] = field(default_factory=list)
    """Rejections since they were last collected; at most a few are kept."""

    @property
    def source(self) -> str:
        """`topic@publisher`."""
        return f"{self.edge.topic}@{self.edge.publisher}"

    @property
    def limit(self) -> int | None:
        """How many messages the policy lets a step see; None for all."""
        return {"latest": 1, "queue": self.edge.input.depth, "reliable": None}[self.edge.input.policy]

    @property
    def full(self) -> bool:
        """Whether reading must stop so that the publisher feels the back-pressure."""
        return self.edge.input.policy == "reliable" and len(self.pending) >= self.edge.input.depth

    def put(self, parts: Sequence[Buffer]) -> None:
        """Take one message off the wire."""
        try:
            header = Header.unpack(self.edge.topic, parts[0])
            if header.schema != self.codec.schema:
                raise MessageError(
                    self.edge.topic,
                    "schema",
                    f"{self.edge.publisher} sends {header.schema.hex()}, "
                    f"{self.edge.subscriber} knows {self.codec.type.__name__} as {self.codec.schema.hex()}; "
                    "run both sides from one release",
                )
            if header.frames != len(parts) - 1:
                raise MessageError(
                    self.edge.topic, "frames", f"header says {header.frames}, {len(parts) - 1} came"
                )
        except MessageError as error:
            self.reject(error)
            return
        same_life = header.sequence >> LIFE_BITS == self.last_sequence >> LIFE_BITS
        if self.last_sequence >= 0 and same_life:
            self.dropped += max(0, header.sequence - self.last_sequence - 1)
        self.last_sequence = header.sequence
        self.last_sent_ns = header.sent_ns
        self.received += 1
        if not self.keep_all and (limit := self.limit) is not None and len(self.pending) >= limit:
            self.pending.popleft()
            self.skipped += 1
        self.pending.append((header, memoryview(parts[0])[Header.SIZE :], parts[1:]))

    def reject(self, error: MessageError) -> None:
        """Count a message that is not what the topic promises."""
        self.rejected += 1
        if len(self.faults) < 8:
            self.faults.append(error)

    def take(self, bound: Bound | None) -> list[Received[Any]]:
        """Decode what a step shall see; with a bound nothing past it."""
        last = bound.get(self.source, -1) if bound is not None and self.edge.in_step else None
        ready = []
        while self.pending and (last is None or self.pending[0][0].sequence <= last):
            ready.append(self.pending.popleft())
        if (limit := self.limit) is not None and len(ready) > limit:
            self.skipped += len(ready) - limit
            ready = ready[-limit:]
        taken = []
        for header, body, frames in ready:
            try:
                message = self.codec.decode(body, frames)
            except MessageError as error:
                self.reject(error)
                continue
            edge = self.edge
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
    """The rim of a node: `ZmqBus` between processes, `MemoryBus` within one."""

    inlets: list[Inlet]

    def publish(self, topic: Topic[M], message: M, stamp_ns: int) -> int:
        """Send a message; returns its sequence number.

        Arrays that own their memory are taken over and made read-only; views are copied.

        Raises:
            MessageError: the message is not what its topic promises.
            BusError: a reliable subscriber did not take it in time (lockstep only).
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
    taken.sort(key=lambda m: (m.stamp_ns, m.topic, m.publisher, m.sequence))
    return taken


def arrived(bus: Bus, bound: Bound) -> bool:
    """Whether everything up to `bound` has come in."""
    return all(inlet.last_sequence >= bound.get(inlet.source, -1) for inlet in bus.inlets)
