"""Finds what stands where in a log, by its summary or, where that is missing, by walking the file."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC

from .bus import LIFE_BITS
from .log_chunk import RawMessage, parse_chunk
from .log_format import MESSAGE_ENCODING, PROFILE, SCHEMA_ENCODING, LogChannel, LogError

_HEAD = struct.Struct("<BQ")
_FOOTER_SIZE = _HEAD.size + 20 + len(MCAP0_MAGIC)


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk is and what it holds."""

    offset: int
    """Of the chunk record's content in the file."""
    length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass(slots=True)
class LogIndex:
    """What stands where in a log."""

    path: Path
    size: int
    """Bytes in the file."""
    channels: dict[int, LogChannel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    """In file order."""
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    """Messages by channel."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = True
    """Whether the file was finished; if not, this is what could be saved."""
    damaged: int = 0
    """Records that could not be read."""
    _schemas: dict[int, Schema] = field(default_factory=dict)

    def describe(self, record: Any) -> None:
        """Take note of a schema or channel."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif record.id not in self.channels:
            self.channels[record.id] = self._channel(record)

    def _channel(self, record: Channel) -> LogChannel:
        schema = self._schemas.get(record.schema_id)
        encodings = (record.message_encoding, schema.encoding if schema else "none")
        if schema is None or encodings != (MESSAGE_ENCODING, SCHEMA_ENCODING):
            raise LogError(
                f"{self.path}: topic {record.topic} is {encodings[0]} described by {encodings[1]}, "
                f"must be {MESSAGE_ENCODING} described by {SCHEMA_ENCODING}"
            )
        facts = record.metadata
        try:
            bytes.fromhex(facts["schema"])
            return LogChannel(
                record.id,
                record.topic,
                facts["publisher"],
                int(facts["life"]),
                facts["schema"],
                schema.name,
                msgspec.json.decode(schema.data),
                facts["latched"] == "true",
                facts["deterministic"] == "true",
            )
        except (KeyError, ValueError) as error:
            raise LogError(
                f"{self.path}: channel {record.topic}: its description is damaged: {error}"
            ) from None


def read_index(path: str | Path, walk: bool = False) -> LogIndex:
    """Index a log; an unfinished one is walked to its last complete chunk.

    Args:
        path: The log.
        walk: Walk it even if it is finished, leaving out damaged chunks.

    Raises:
        LogError: missing, empty, not an MCAP file, or not a log of ours.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            index = LogIndex(path, file.seek(0, 2))
            _check_head(index, file)
            return (None if walk else _read_summary(index, file)) or _walk(index, file)
    except FileNotFoundError:
        raise LogError(f"{path}: no such log") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None


def _check_head(index: LogIndex, file: IO[bytes]) -> None:
    """The file must begin as an MCAP file with our profile."""
    if index.size == 0:
        raise LogError(f"{index.path}: is empty")
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise LogError(f"{index.path}: is not an MCAP file")
    content = _content(file, index.size, Opcode.HEADER)
    if content is None:
        raise LogError(f"{index.path}: ends before its first record is complete")
    try:
        header = Header.read(_stream(content))
    except Exception:
        raise LogError(f"{index.path}: its first record is damaged") from None
    if header.profile != PROFILE:
        raise LogError(
            f"{index.path}: is an MCAP file of profile {header.profile!r} written by {header.library!r}, "
            f"not a footfall log (profile {PROFILE!r})"
        )


def _read_summary(index: LogIndex, file: IO[bytes]) -> LogIndex | None:
    """Fill in the index from the summary section; None if there is no whole one."""
    if index.size < _FOOTER_SIZE:
        return None
    file.seek(index.size - _FOOTER_SIZE)
    tail = file.read(_FOOTER_SIZE)
    if not tail.endswith(MCAP0_MAGIC) or _HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
        return None
    footer = Footer.read(_stream(tail[_HEAD.size :]))
    if not 0 < footer.summary_start <= index.size - _FOOTER_SIZE:
        return None
    file.seek(footer.summary_start)
    summary = file.read(index.size - _FOOTER_SIZE - footer.summary_start)
    if zlib.crc32(tail[: _HEAD.size + 16], zlib.crc32(summary)) != footer.summary_crc:
        return None
    for opcode, _, content in _records(BytesIO(summary), len(summary)):
        stream = _stream(content)
        if opcode == Opcode.SCHEMA:
            index.describe(Schema.read(stream))
        elif opcode == Opcode.CHANNEL:
            index.describe(Channel.read(stream))
        elif opcode == Opcode.STATISTICS:
            index.counts.update(Statistics.read(stream).channel_message_counts)
        elif opcode == Opcode.CHUNK_INDEX:
            chunk = ChunkIndex.read(stream)
            index.chunks.append(
                ChunkPlace(
                    chunk.chunk_start_offset + _HEAD.size,
                    chunk.chunk_length - _HEAD.size,
                    chunk.message_start_time,
                    chunk.message_end_time,
                    frozenset(chunk.message_index_offsets),
                )
            )
        elif opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            kind = AttachmentIndex if opcode == Opcode.ATTACHMENT_INDEX else MetadataIndex
            _read_extra(index, file, kind.read(stream).offset)
    return index


def _read_extra(index: LogIndex, file: IO[bytes], offset: int) -> None:
    """Read the attachment or metadata record at a place."""
    file.seek(offset)
    try:
        opcode, _, content = next(_records(file, index.size))
        _note_extra(index, opcode, content)
    except Exception:  # whatever damaged bytes make of the parser
        index.damaged += 1


def _note_extra(index: LogIndex, opcode: int, content: bytes) -> None:
    if opcode == Opcode.ATTACHMENT:
        if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
            raise ValueError("checksum differs")
        attachment = Attachment.read(_stream(content))
        index.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(_stream(content))
        index.metadata[metadata.name] = metadata.metadata


def _walk(index: LogIndex, file: IO[bytes]) -> LogIndex:
    """Fill in the index record by record, as far as records are complete."""
    index.complete = False
    file.seek(len(MCAP0_MAGIC))
    for opcode, offset, content in _records(file, index.size):
        if opcode == Opcode.DATA_END:
            break
        try:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                index.describe(kind.read(_stream(content)))
            elif opcode == Opcode.CHUNK:
                _note_chunk(index, offset, content)
            else:
                _note_extra(index, opcode, content)
        except LogError:
            raise
        except Exception:  # whatever damaged bytes make of the parser
            index.damaged += 1
    return index


def _note_chunk(index: LogIndex, offset: int, content: bytes) -> None:
    messages = parse_chunk(content)
    for message in messages:
        if message.channel not in index.channels:
            raise ValueError(f"channel {message.channel} is not described")
    stamps = [message.stamp_ns for message in messages]
    channels = frozenset(message.channel for message in messages)
    index.chunks.append(
        ChunkPlace(offset, len(content), min(stamps, default=0), max(stamps, default=0), channels)
    )
    for message in messages:
        index.counts[message.channel] += 1


def read_chunk(index: LogIndex, file: IO[bytes], place: ChunkPlace) -> list[RawMessage]:
    """The messages of a chunk in file order, their sequence numbers with the publisher's life.

    Raises:
        LogError: the chunk is damaged.
    """
    file.seek(place.offset)
    try:
        messages = parse_chunk(file.read(place.length))
        lives = {id: channel.life << LIFE_BITS for id, channel in index.channels.items()}
        return [m._replace(sequence=life | m.sequence) if (life := lives[m.channel]) else m for m in messages]
    except Exception as error:
        raise LogError(
            f"{index.path}: the chunk at byte {place.offset} is damaged ({error}); "
            "`footfall log recover` saves the others"
        ) from None


def _records(file: IO[bytes], end: int) -> Iterator[tuple[int, int, bytes]]:
    """Opcode, place and content of each complete record from here on."""
    while True:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        opcode, length = _HEAD.unpack(head)
        offset = file.tell()
        if offset + length > end:
            return
        yield opcode, offset, file.read(length)


def _content(file: IO[bytes], end: int, wanted: Opcode) -> bytes | None:
    first = next(_records(file, end), None)
    return first[2] if first and first[0] == wanted else None


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
