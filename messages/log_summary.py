"""The end of an MCAP file: what stands in it, and where."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC


class SchemaFacts(NamedTuple):
    """What makes two schemas one."""

    name: str
    hash: str
    text: bytes


_COUNT = struct.Struct("<HI")


class ChunkFacts(NamedTuple):
    """A chunk in the file. A recording of hours has many: packed, one takes a sixth of its objects."""

    offset: int
    """Where it begins."""
    start_ns: int
    end_ns: int
    record: bytes
    """Its chunk index."""
    packed_counts: bytes

    @classmethod
    def of(cls, index: ChunkIndex, counts: Mapping[int, int]) -> "ChunkFacts":
        """Facts of a chunk with so many messages by channel."""
        packed = b"".join(_COUNT.pack(channel, count) for channel, count in counts.items())
        return cls(
            index.chunk_start_offset,
            index.message_start_time,
            index.message_end_time,
            to_bytes(index),
            packed,
        )

    @property
    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return dict(_COUNT.iter_unpack(self.packed_counts))


@dataclass(slots=True)
class Contents:
    """What has been written so far."""

    schemas: dict[SchemaFacts, Schema] = field(default_factory=dict)
    channels: dict[tuple[str, str, int], Channel] = field(default_factory=dict)
    """By topic, publisher and life."""
    chunks: list[ChunkFacts] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)

    def summary(self, at: int) -> bytes:
        """Everything that follows the last chunk of a file that has `at` bytes until there."""
        end = to_bytes(DataEnd(0))
        start = at + len(end)
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, to_bytes(*self.schemas.values())),
            (Opcode.CHANNEL, to_bytes(*self.channels.values())),
            (Opcode.STATISTICS, to_bytes(self._statistics())),
            (Opcode.CHUNK_INDEX, b"".join(chunk.record for chunk in self.chunks)),
            (Opcode.ATTACHMENT_INDEX, to_bytes(*self.attachments)),
            (Opcode.METADATA_INDEX, to_bytes(*self.metadata)),
        ]
        summary, offsets = b"", []
        for opcode, data in groups:
            if data:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        offset_start = start + len(summary)
        summary += to_bytes(*offsets)
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(footer_head, zlib.crc32(summary))
        return end + summary + to_bytes(Footer(start, offset_start, crc)) + MCAP0_MAGIC

    def _statistics(self) -> Statistics:
        totals: dict[int, int] = defaultdict(int)
        for chunk in self.chunks:
            for channel, count in chunk.counts.items():
                totals[channel] += count
        return Statistics(
            len(self.attachments),
            len(self.channels),
            dict(totals),
            len(self.chunks),
            sum(totals.values()),
            max((chunk.end_ns for chunk in self.chunks), default=0),
            min((chunk.start_ns for chunk in self.chunks), default=0),
            len(self.metadata),
            len(self.schemas),
        )


def to_bytes(*records: McapRecord) -> bytes:
    """Records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()
