"""Writes MCAP logs chunk by chunk; whatever happens, the file holds every chunk that was written."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from .bus import LIFE_BITS
from .codec import Codec
from .graph import Graph
from .log_file import AppendFile
from .log_format import (
    FORMAT,
    GRAPH_FILE,
    MESSAGE_ENCODING,
    PROFILE,
    RUN,
    SCHEMA_ENCODING,
    VERSIONS,
    LogError,
)
from .log_reader import Logged
from .log_summary import ChunkFacts, Contents, SchemaFacts, to_bytes
from .schema import json_schema, schema_hash
from .topics import Topic

CHUNK_BYTES = 1 << 19
"""A chunk is closed when its messages have this size before compression."""
FLUSH_PERIOD = 1.0
"""And at the latest after this wall time [s]: what a killed recorder can lose."""
_LEVEL = 1
_MESSAGE = struct.Struct("<BQHIQQ")
_SEQUENCE_MASK = (1 << LIFE_BITS) - 1


class DiskFullError(LogError):
    """The log could not grow: what was written before is intact and closed as far as there was room."""

    def __init__(self, text: str, given_up: Mapping[str, int]) -> None:
        super().__init__(text)
        self.given_up = given_up
        """Messages accepted earlier that are not in the file, by `topic@publisher`."""


@dataclass(slots=True)
class _OpenChunk:
    """Messages on their way into one chunk."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    start_ns: int = 1 << 64
    end_ns: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))


class LogWriter:
    """One MCAP file.

    Every chunk goes out in one write together with the records that describe it; a write that fails is
    taken back, so that the file never ends in half a chunk while this process lives.

    Args:
        path: The file; its folder is made if it does not exist.
        graph: The graph that runs; attached as `graph.json`.
        metadata: Further metadata records, name to values.
        overwrite: Whether an existing file may be replaced.
        chunk_bytes: Size at which a chunk is closed [bytes].
        flush_period: Wall time after which `tick` closes a chunk [s].
        quota: Size the file may reach [bytes], its summary not counted; None for no limit.

    Raises:
        LogError: the file exists, or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        graph: Graph | None = None,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        *,
        overwrite: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
        flush_period: float = FLUSH_PERIOD,
        quota: int | None = None,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        """Messages that stand in the file or wait in the open chunk."""
        self.closed = False
        self._chunk_bytes = chunk_bytes
        self._flush_period = flush_period
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)
        self._chunk = _OpenChunk()
        self._flushed_at = monotonic()
        self._descriptions: list[McapRecord] = []
        self._contents = Contents()
        self._codecs: dict[str, Codec] = {}
        self._file = AppendFile(self.path, overwrite, quota)
        try:
            self._begin(graph, dict(metadata or {}))
        except OSError as error:
            self._file.close()
            raise LogError(f"{self.path}: cannot be written: {error.strerror}") from None

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    def _begin(self, graph: Graph | None, metadata: dict[str, Mapping[str, str]]) -> None:
        self._file.append(MCAP0_MAGIC + to_bytes(Header(PROFILE, f"footfall format {FORMAT}")))
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        run = {"format": FORMAT, "recorded": now} | dict(metadata.pop(RUN, {}))
        if graph is not None:
            run |= {"graph": graph.name, "seed": str(graph.seed)}
            metadata.setdefault(VERSIONS, graph.versions)
            self.attach(GRAPH_FILE, "application/json", msgspec.json.encode(graph))
        for name, values in {RUN: run, **metadata}.items():
            data = to_bytes(Metadata(name, dict(values)))
            self._contents.metadata.append(MetadataIndex(self.size, len(data), name))
            self._file.append(data)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a whole file into the log."""
        record = to_bytes(Attachment(0, 0, name, media_type, data))
        self._contents.attachments.append(
            AttachmentIndex(self.size, len(record), 0, 0, len(data), name, media_type)
        )
        self._file.append(record)

    def write(
        self, topic: Topic, publisher: str, sequence: int, stamp_ns: int, sent_ns: int, record: bytes
    ) -> None:
        """Add one message.

        Args:
            topic: What it is.
            publisher: Who sent it.
            sequence: Its number, the publisher's restarts in the upper 32 bits.
            stamp_ns: Simulation time it speaks of.
            sent_ns: Monotonic time of sending.
            record: The self-contained msgpack record (`Codec.encode_inline`).

        Raises:
            LogError: a time is negative, which MCAP cannot hold.
            DiskFullError: the log cannot grow any more; it is closed, this message is not in it.
        """
        if stamp_ns < 0 or sent_ns < 0:
            raise LogError(f"{self.path}: {topic.name}@{publisher}: time {min(stamp_ns, sent_ns)} ns < 0")
        if self._chunk.size >= self._chunk_bytes:
            self.flush()
        key = (topic.name, publisher, sequence >> LIFE_BITS)
        channel = self._contents.channels.get(key) or self._describe(
            key,
            SchemaFacts(topic.type.__name__, schema_hash(topic.type).hex(), _schema_text(topic.type)),
            topic.latched,
            topic.deterministic,
        )
        self._add(channel, sequence, stamp_ns, sent_ns, record)

    def copy(self, item: Logged[Any]) -> None:
        """Add a message of another log as it is, whatever its type.

        Raises:
            DiskFullError: see `write`.
        """
        if self._chunk.size >= self._chunk_bytes:
            self.flush()
        of = item.channel
        key = (of.topic, of.publisher, of.life)
        facts = SchemaFacts(of.type_name, of.schema, _canonical_json(of.json_schema))
        channel = self._contents.channels.get(key) or self._describe(key, facts, of.latched, of.deterministic)
        self._add(channel, item.sequence, item.stamp_ns, item.sent_ns, item.record)

    def _add(self, channel: Channel, sequence: int, stamp_ns: int, sent_ns: int, record: bytes) -> None:
        if self.closed:
            raise LogError(f"{self.path}: is closed")
        chunk = self._chunk
        chunk.index[channel.id].append((stamp_ns, chunk.size))
        length = 22 + len(record)
        chunk.parts += (
            _MESSAGE.pack(Opcode.MESSAGE, length, channel.id, sequence & _SEQUENCE_MASK, stamp_ns, sent_ns),
            record,
        )
        chunk.size += 9 + length
        chunk.start_ns = min(chunk.start_ns, stamp_ns)
        chunk.end_ns = max(chunk.end_ns, stamp_ns)
        self.messages += 1

    def write_message(
        self, topic: Topic, publisher: str, sequence: int, stamp_ns: int, sent_ns: int, message: Any
    ) -> None:
        """Like `write`, from a message instead of its bytes."""
        codec = self._codecs.setdefault(topic.name, Codec(topic.name, topic.type))
        self.write(topic, publisher, sequence, stamp_ns, sent_ns, codec.encode_inline(message))

    def _describe(
        self, key: tuple[str, str, int], facts: SchemaFacts, latched: bool, deterministic: bool
    ) -> Channel:
        """Add a channel, and its schema if that is new."""
        schema = self._contents.schemas.get(facts)
        if schema is None:
            schema = Schema(len(self._contents.schemas) + 1, facts.text, SCHEMA_ENCODING, facts.name)
            self._contents.schemas[facts] = schema
            self._descriptions.append(schema)
        topic, publisher, life = key
        metadata = {
            "topic": topic,
            "publisher": publisher,
            "life": str(life),
            "schema": facts.hash,
            "latched": str(latched).lower(),
            "deterministic": str(deterministic).lower(),
        }
        channel = Channel(len(self._contents.channels) + 1, topic, MESSAGE_ENCODING, metadata, schema.id)
        self._contents.channels[key] = channel
        self._descriptions.append(channel)
        return channel

    def tick(self, now: float | None = None) -> None:
        """Close the chunk if it is older than the flush period; to be called often, also when idle."""
        now = monotonic() if now is None else now
        if now - self._flushed_at >= self._flush_period:
            self.flush()

    def flush(self) -> None:
        """Write the open chunk into the file.

        Raises:
            DiskFullError: there is no room; the log is closed.
        """
        self._flushed_at = monotonic()
        chunk, self._chunk = self._chunk, _OpenChunk()
        if not chunk.parts:
            return
        plain = b"".join(chunk.parts)
        data = self._compressor.compress(plain)
        described = to_bytes(*self._descriptions)
        record = to_bytes(Chunk("zstd", data, chunk.end_ns, chunk.start_ns, zlib.crc32(plain), len(plain)))
        offsets, indexes, at = {}, [], self.size + len(described) + len(record)
        for channel, entries in chunk.index.items():
            offsets[channel] = at
            indexes.append(to_bytes(MessageIndex(channel, entries)))
            at += len(indexes[-1])
        start = self.size + len(described)
        counts = {channel: len(entries) for channel, entries in chunk.index.items()}
        try:
            self._file.append(b"".join((described, record, *indexes)))
        except OSError as error:
            self._close_full(error, counts)
        self._descriptions = []
        index = ChunkIndex(
            len(record),
            start,
            "zstd",
            len(data),
            chunk.end_ns,
            sum(map(len, indexes)),
            offsets,
            chunk.start_ns,
            len(plain),
        )
        self._contents.chunks.append(ChunkFacts.of(index, counts))

    def _close_full(self, error: OSError, given_up: dict[int, int]) -> None:
        """Close a log that cannot grow, giving up chunks at its end until the summary fits."""
        lost = defaultdict(int, given_up)
        self._file.quota = None
        while not self._try_finish() and self._contents.chunks:
            chunk = self._contents.chunks.pop()
            for channel, count in chunk.counts.items():
                lost[channel] += count
            self._file.cut(chunk.offset)
        self.messages -= sum(lost.values())
        self.closed = True
        self._file.close()
        sources = {c.id: f"{c.topic}@{c.metadata['publisher']}" for c in self._contents.channels.values()}
        by_source: dict[str, int] = defaultdict(int)
        for channel, count in lost.items():
            by_source[sources[channel]] += count
        raise DiskFullError(
            f"{self.path}: {error.strerror}; recording has stopped, the {self.messages} messages before are "
            "in the file",
            by_source,
        )

    def _try_finish(self) -> bool:
        try:
            self._file.append(self._contents.summary(self.size))
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Write what is left and the summary.

        Raises:
            DiskFullError: there is no room; the file is intact as far as it goes.
        """
        if self.closed:
            return
        self.flush()
        try:
            self._file.append(self._contents.summary(self.size))
        except OSError as error:
            self._close_full(error, {})
        self.closed = True
        self._file.close()

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@cache
def _schema_text(message_type: type[msgspec.Struct]) -> bytes:
    return _canonical_json(json_schema(message_type))


def _canonical_json(value: Any) -> bytes:
    return msgspec.json.encode(value, order="deterministic")
