"""Reads logs: typed messages in the order asked for, also from a log whose recorder was killed."""

import heapq
import logging
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, Generic, Literal, TypeVar

import msgspec

from .bus import Received
from .codec import Codec
from .config import near
from .graph import Graph
from .log_chunk import RawMessage
from .log_format import GRAPH_FILE, REPEATED, RUN, VERSIONS, LogChannel, LogError
from .log_index import ChunkPlace, LogIndex, read_chunk, read_index
from .log_plain import plain_decoder
from .schema import compatible, schema_hash
from .topics import TOPICS, Topic

M = TypeVar("M")
log = logging.getLogger(__name__)

Order = Literal["stamp", "sent", "file"]
"""`stamp`: by simulation time, topic, publisher, sequence number. `sent`: as sent, which is the order in
which things happened. `file`: as they stand in the file."""


@dataclass(slots=True, eq=False)
class Logged(Generic[M]):
    """A message of a log."""

    channel: LogChannel
    sequence: int
    stamp_ns: int
    sent_ns: int
    record: bytes
    """The self-contained msgpack record."""
    _decode: Any

    @property
    def topic(self) -> str:
        """Topic name."""
        return self.channel.topic

    @property
    def publisher(self) -> str:
        """Name of the node that sent it."""
        return self.channel.publisher

    @property
    def source(self) -> str:
        """`topic@publisher`."""
        return self.channel.source

    @property
    def message(self) -> M:
        """The message: our struct where the log's type is the one known here, else plain dicts and arrays.

        Raises:
            MessageError: the record is not what its schema promises.
        """
        return self._decode(self.record)

    def received(self, port: str) -> Received[Any]:
        """As a bus would have delivered it."""
        message: Any = self.message
        return Received(port, self.topic, self.publisher, self.sequence, self.stamp_ns, self.sent_ns, message)


class LogReader:
    """One log file.

    An unfinished file is read as far as its chunks are complete, and a warning says so.

    Args:
        path: The log.
        topics: Topics whose types are known, built-in and custom.
        salvage: Read whatever can be read, leaving out damaged chunks.

    Raises:
        LogError: missing, empty, not an MCAP file, or not a log of ours.
    """

    def __init__(self, path: str | Path, topics: Mapping[str, Topic] = TOPICS, salvage: bool = False) -> None:
        self.index: LogIndex = read_index(path, walk=salvage)
        self.path = self.index.path
        self._known = topics
        self._decoders: dict[int, Any] = {}
        self._warned = False
        if not self.index.complete and not salvage:
            log.warning("%s was not finished by its recorder; its complete chunks are used", self.path)

    @property
    def channels(self) -> list[LogChannel]:
        """All channels, by topic and publisher."""
        return sorted(self.index.channels.values(), key=lambda c: (c.topic, c.publisher, c.life))

    @property
    def topics(self) -> list[str]:
        """Names of the topics in the log."""
        return sorted({channel.topic for channel in self.index.channels.values()})

    @property
    def graph(self) -> Graph | None:
        """The graph the log was recorded from.

        Raises:
            LogError: the attached graph is not one this release understands.
        """
        data = self.index.attachments.get(GRAPH_FILE)
        if data is None:
            return None
        try:
            return msgspec.json.decode(data, type=Graph)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise LogError(f"{self.path}: its {GRAPH_FILE} is not a graph: {error}") from None

    @property
    def run(self) -> dict[str, str]:
        """Facts about the run: format, graph, seed, recorded."""
        return self.index.metadata.get(RUN, {})

    @property
    def versions(self) -> dict[str, str]:
        """Releases of the packages that took part."""
        return self.index.metadata.get(VERSIONS, {})

    @property
    def repeated(self) -> dict[str, int]:
        """Latched messages carried over from the log before in a split: sequence by `topic@publisher`."""
        return {source: int(n) for source, n in self.index.metadata.get(REPEATED, {}).items()}

    @property
    def message_count(self) -> int:
        """Messages in the log."""
        return sum(self.index.counts.values())

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp."""
        chunks = self.index.chunks
        return (
            min((c.start_ns for c in chunks), default=0),
            max((c.end_ns for c in chunks), default=0),
        )

    def check_topics(self, names: Iterable[str]) -> None:
        """Raise a `LogError` with the near match for a topic the log does not have."""
        for name in names:
            if name not in self.topics:
                raise LogError(f"{self.path}: has no topic {name!r}; {near(name, self.topics)}")

    def messages(
        self,
        topics: Collection[str] | None = None,
        *,
        exclude: Collection[str] = (),
        publisher: str | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        order: Order = "stamp",
    ) -> Iterator[Logged[Any]]:
        """The messages of the log.

        Args:
            topics: Only these; None for all.
            exclude: Not these.
            publisher: Only from this node.
            start_ns: Only stamps from here.
            end_ns: Only stamps before this.
            order: See `Order`.

        Raises:
            LogError: an unknown topic, or a damaged chunk.
        """
        self.check_topics([*(topics or ()), *exclude])
        wanted = {
            channel.id
            for channel in self.index.channels.values()
            if (topics is None or channel.topic in topics)
            and channel.topic not in exclude
            and publisher in (None, channel.publisher)
        }
        low = -1 if start_ns is None else start_ns
        high = 1 << 64 if end_ns is None else end_ns
        places = [
            place
            for place in self.index.chunks
            if place.start_ns < high and place.end_ns >= low and wanted & place.channels
        ]
        with self.path.open("rb") as file:
            for raw in self._ordered(file, places, order):
                if raw.channel in wanted and low <= raw.stamp_ns < high:
                    yield self._logged(raw)

    def read(self, topic: Topic[Any], **selection: Any) -> Iterator[Logged[Any]]:
        """Like `messages`, of one topic, all of its type.

        Raises:
            LogError: the topic is missing, or was recorded with another schema.
        """
        self.check_topics([topic.name])
        codec = Codec(topic.name, topic.type)
        for channel in self.channels:
            if channel.topic == topic.name and not compatible(codec.schema, bytes.fromhex(channel.schema)):
                raise LogError(
                    f"{self.path}: {channel.source} was recorded as {channel.type_name} {channel.schema}, "
                    f"this release knows {topic.type.__name__} {codec.schema.hex()}"
                )
        return self.messages([topic.name], **selection)

    def last_before(self, stamp_ns: int, topics: Collection[str] | None = None) -> list[Logged[Any]]:
        """The last message of every latched channel (or of `topics`) with a stamp before `stamp_ns`."""
        open_channels = {
            channel.id
            for channel in self.index.channels.values()
            if (channel.latched if topics is None else channel.topic in topics)
        }
        found: list[RawMessage] = []
        with self.path.open("rb") as file:
            for place in reversed(self.index.chunks):
                if place.start_ns >= stamp_ns or not open_channels & place.channels:
                    continue
                last = {
                    raw.channel: raw
                    for raw in read_chunk(self.index, file, place)
                    if raw.channel in open_channels and raw.stamp_ns < stamp_ns
                }
                found += last.values()
                open_channels -= set(last)
        newest = {self.index.channels[raw.channel].source: raw for raw in sorted(found, key=_by_sequence)}
        return [self._logged(raw) for raw in sorted(newest.values(), key=lambda raw: raw.sent_ns)]

    def _ordered(self, file: IO[bytes], places: list[ChunkPlace], order: Order) -> Iterator[RawMessage]:
        if order == "file":
            for place in places:
                yield from read_chunk(self.index, file, place)
        elif order == "sent":
            yield from self._sent_order(file, places)
        else:
            yield from self._stamp_order(file, places)

    def _stamp_order(self, file: IO[bytes], places: list[ChunkPlace]) -> Iterator[RawMessage]:
        """Merge chunks, holding no more of them than overlap in time."""
        channels = self.index.channels
        heap: list[tuple[int, str, str, int, int, RawMessage]] = []
        counter = 0
        for place in sorted(places, key=lambda p: p.start_ns):
            while heap and heap[0][0] < place.start_ns:
                yield heapq.heappop(heap)[-1]
            for raw in read_chunk(self.index, file, place):
                channel = channels[raw.channel]
                key = (raw.stamp_ns, channel.topic, channel.publisher, raw.sequence, counter, raw)
                heapq.heappush(heap, key)
                counter += 1
        while heap:
            yield heapq.heappop(heap)[-1]

    def _sent_order(self, file: IO[bytes], places: list[ChunkPlace]) -> Iterator[RawMessage]:
        """A recorder takes messages nearly in the order of sending: two neighbouring chunks are merged."""
        held: list[RawMessage] = []
        for place in places:
            held.sort(key=_by_sending)
            fresh = sorted(read_chunk(self.index, file, place), key=_by_sending)
            bound = fresh[0].sent_ns if fresh else 0
            cut = next((i for i, raw in enumerate(held) if raw.sent_ns >= bound), len(held))
            yield from held[:cut]
            held = held[cut:] + fresh
        yield from sorted(held, key=_by_sending)

    def _logged(self, raw: RawMessage) -> Logged[Any]:
        channel = self.index.channels[raw.channel]
        decode = self._decoders.get(channel.id)
        if decode is None:
            decode = self._decoders[channel.id] = self._decoder(channel)
        return Logged(channel, raw.sequence, raw.stamp_ns, raw.sent_ns, raw.data, decode)

    def _decoder(self, channel: LogChannel) -> Any:
        topic = self._known.get(channel.topic)
        if topic is not None:
            codec = Codec(topic.name, topic.type)
            recorded = bytes.fromhex(channel.schema)
            if codec.schema == recorded:
                return codec.decode
            if compatible(codec.schema, recorded):  # fields with defaults have come or gone since
                return partial(codec.decode, schema=recorded)
        if not self._warned:
            self._warned = True
            self._warn()
        return plain_decoder(channel.topic)

    def _warn(self) -> None:
        """Say once what will be read as plain data, and why."""
        faults = []
        for channel in self.channels:
            topic = self._known.get(channel.topic)
            if topic is None:
                faults.append(f"topic {channel.topic} is not known here")
            elif not compatible(ours := schema_hash(topic.type), bytes.fromhex(channel.schema)):
                faults.append(
                    f"{channel.source} was recorded as {channel.type_name} {channel.schema}, "
                    f"this release knows {topic.type.__name__} {ours.hex()}"
                )
        more = f" (and {len(faults) - 3} channels more)" if len(faults) > 3 else ""
        log.warning("%s: read as plain data: %s%s", self.path, "; ".join(faults[:3]), more)


def _by_sequence(raw: RawMessage) -> int:
    return raw.sequence


def _by_sending(raw: RawMessage) -> tuple[int, int, int]:
    return raw.sent_ns, raw.channel, raw.sequence
