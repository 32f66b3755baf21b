"""The end of an MCAP file: what stands in it, and where."""

import struct
import zlib
from collections import defaultdict
from collections.abc import Sequence
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


@dataclass(slots=True)
class Contents:
    """What has been written so far."""

    schemas: dict[SchemaFacts, Schema] = field(default_factory=dict)
    channels: dict[tuple[str, str, int], Channel] = field(default_factory=dict)
    """By topic, publisher and life."""
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: list[dict[int, int]] = field(default_factory=list)
    """Messages by channel, for each chunk."""
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)

    def summary(self, at: int) -> bytes:
        """Everything that follows the last chunk of a file that has `at` bytes until there."""
        end = to_bytes(DataEnd(0))
        start = at + len(end)
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, list(self.schemas.values())),
            (Opcode.CHANNEL, list(self.channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            data = to_bytes(*records)
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
        for counts in self.counts:
            for channel, count in counts.items():
                totals[channel] += count
        return Statistics(
            len(self.attachments),
            len(self.channels),
            dict(totals),
            len(self.chunks),
            sum(totals.values()),
            max((chunk.message_end_time for chunk in self.chunks), default=0),
            min((chunk.message_start_time for chunk in self.chunks), default=0),
            len(self.metadata),
            len(self.schemas),
        )


def to_bytes(*records: McapRecord) -> bytes:
    """Records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()
