"""The messages inside an MCAP chunk."""

import struct
import zlib
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


class RawMessage(NamedTuple):
    """One message as it stands in the file."""

    channel: int
    sequence: int
    stamp_ns: int
    sent_ns: int
    data: bytes


def parse_chunk(content: bytes) -> list[RawMessage]:
    """The messages of a chunk record's content.

    Raises:
        ValueError: damaged (other exceptions are possible on damaged bytes).
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.compression == "zstd":
        data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression:
        raise ValueError(f"compressed with {chunk.compression}")
    else:
        data = chunk.data
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"{len(data)} bytes instead of {chunk.uncompressed_size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("checksum differs")
    messages, at = [], 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if opcode == Opcode.MESSAGE:
            channel, sequence, stamp_ns, sent_ns = _MESSAGE.unpack_from(data, at)
            record = data[at + _MESSAGE.size : at + length]
            messages.append(RawMessage(channel, sequence, stamp_ns, sent_ns, record))
        at += length
    return messages
