"""Messages to bytes and back: standard msgpack, arrays beside the body, everything checked."""

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from .array import DTYPES
from .schema import Field, fields_of, schema_hash

M = TypeVar("M", bound=msgspec.Struct)
Buffer = bytes | bytearray | memoryview

INLINE_BYTES = 4096
"""Arrays up to this size travel inside the msgpack body; larger ones in a frame of their own."""

_HEADER = struct.Struct("<2sBBQqq8s")
_MAGIC = b"FF"
WIRE_VERSION = 1


class MessageError(ValueError):
    """A message that is not what its topic promises: names the topic, the field and the reason."""

    def __init__(self, topic: str, field: str, reason: str) -> None:
        super().__init__(f"{topic}: {field}: {reason}" if field else f"{topic}: {reason}")
        self.topic = topic
        self.field = field
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Header:
    """The fixed 36 bytes in front of every message."""

    sequence: int
    """Counts the messages of one publisher on one topic, from 0; the upper 32 bits count its restarts."""
    stamp_ns: int
    """Simulation time the message speaks of."""
    sent_ns: int
    """Monotonic time of sending, for ages and delays on one machine."""
    schema: bytes
    """Schema hash of the message type (8 bytes)."""
    frames: int
    """Number of array frames that follow the body."""

    SIZE = _HEADER.size

    def pack(self) -> bytes:
        """The header's bytes: magic, version, frames, sequence, stamps, schema; little endian."""
        return _HEADER.pack(
            _MAGIC, WIRE_VERSION, self.frames, self.sequence, self.stamp_ns, self.sent_ns, self.schema
        )

    @classmethod
    def unpack(cls, topic: str, data: Buffer) -> "Header":
        """Read a header.

        Raises:
            MessageError: too short, not ours, or of another wire version.
        """
        if len(data) < _HEADER.size:
            raise MessageError(topic, "header", f"{len(data)} bytes, must be at least {_HEADER.size}")
        magic, version, frames, sequence, stamp_ns, sent_ns, schema = _HEADER.unpack_from(data)
        if magic != _MAGIC:
            raise MessageError(topic, "header", f"starts with {bytes(magic)!r}, must start with {_MAGIC!r}")
        if version != WIRE_VERSION:
            raise MessageError(topic, "header", f"wire version {version}, this side speaks {WIRE_VERSION}")
        return cls(sequence, stamp_ns, sent_ns, schema, frames)


class Codec(Generic[M]):
    """Encodes and decodes one message type of one topic.

    A body is a msgpack map of field names; an array field is `[dtype, shape, where]`, where `where` is
    the index of its frame, or the elements themselves when they are few or the message is self-contained.
    """

    def __init__(self, topic: str, message_type: type[M]) -> None:
        self.topic = topic
        self.type = message_type
        self.schema = schema_hash(message_type)
        self._frames: list[np.ndarray] = []
        self._received: Sequence[Buffer] = ()
        self._used: set[int] = set()
        self._inline_limit = INLINE_BYTES
        self._encoder = msgspec.msgpack.Encoder(enc_hook=self._encode_array)
        self._decoder = msgspec.msgpack.Decoder(message_type, dec_hook=self._decode_array)

    def encode(self, message: M) -> tuple[bytes, list[np.ndarray]]:
        """Body and array frames; the frames are the message's own arrays, not copies.

        Raises:
            MessageError: a field does not match its specification.
        """
        validate(self.topic, message)
        self._frames = []
        try:
            body = self._encoder.encode(message)
        except (TypeError, OverflowError) as error:
            raise MessageError(self.topic, "", str(error)) from None
        return body, self._frames

    def encode_inline(self, message: M) -> bytes:
        """One self-contained msgpack record with every array inside, as logs store it."""
        self._inline_limit = 1 << 62
        try:
            return self._encoder.encode(message)
        finally:
            self._inline_limit = INLINE_BYTES

    def decode(self, body: Buffer, frames: Sequence[Buffer] = ()) -> M:
        """The message; its arrays are read-only views of `frames` or `body`.

        Raises:
            MessageError: anything that is not exactly a valid message of this type.
        """
        self._received = frames
        self._used = set()
        try:
            message = self._decoder.decode(body)
        except MessageError:
            raise
        except (msgspec.DecodeError, ValueError, TypeError, OverflowError, RecursionError) as error:
            reason, _, path = str(error).partition(" - at `")
            raise MessageError(self.topic, _field_of(path), reason) from None
        finally:
            self._received = ()
        if len(self._used) != len(frames):
            raise MessageError(
                self.topic, "frames", f"{len(frames)} frames came, the body uses {len(self._used)}"
            )
        validate(self.topic, message)
        return message

    def _encode_array(self, value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            if isinstance(value, np.generic):
                return value.item()
            raise TypeError(f"{type(value).__name__} cannot stand in a message")
        array = np.ascontiguousarray(value)
        if array.nbytes <= self._inline_limit:
            return (array.dtype.str, array.shape, array.tobytes())
        self._frames.append(array)
        return (array.dtype.str, array.shape, len(self._frames) - 1)

    def _decode_array(self, wanted: type, value: Any) -> Any:
        if wanted is not np.ndarray:
            raise TypeError(f"{wanted.__name__} cannot stand in a message")
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise ValueError("an array must be [dtype, shape, where]")
        dtype_name, shape, where = value
        dtype = DTYPES.get(dtype_name) if isinstance(dtype_name, str) else None
        if dtype is None:
            raise ValueError(f"dtype {dtype_name!r} is not one of {', '.join(sorted(DTYPES))}")
        if not isinstance(shape, (list, tuple)) or not all(
            type(n) is int and 0 <= n < 1 << 31 for n in shape
        ):
            raise ValueError(f"shape {shape!r} is not a list of lengths")
        if len(shape) > 8:
            raise ValueError(f"{len(shape)} axes, at most 8 are allowed")
        if isinstance(where, bytes):
            data: Buffer = where
        elif type(where) is int and 0 <= where < len(self._received) and where not in self._used:
            self._used.add(where)
            data = self._received[where]
        else:
            raise ValueError(f"frame {where!r} is not among the {len(self._received)} frames that came")
        size = math.prod(shape) * dtype.itemsize
        length = memoryview(data).nbytes
        if size != length:
            raise ValueError(f"shape {tuple(shape)} of {dtype.str} needs {size} bytes, {length} came")
        array = np.frombuffer(data, dtype).reshape(shape)
        array.flags.writeable = False
        return array


def _field_of(path: str) -> str:
    return re.sub(r"^\$\.?", "", path.rstrip("`"))


@cache
def _checked_fields(message_type: type[msgspec.Struct]) -> tuple[Field, ...]:
    return tuple(f for f in fields_of(message_type) if f.array or f.structs or f.has_floats)


def validate(topic: str, message: msgspec.Struct, path: str = "") -> None:
    """Check arrays against their specifications and floats for NaN, in `message` and below.

    Raises:
        MessageError: with the first field that is wrong.
    """
    lengths: dict[str, int] = {}
    for field in _checked_fields(type(message)):
        value = getattr(message, field.name)
        where = f"{path}{field.name}"
        if field.array is not None and isinstance(value, np.ndarray):
            if fault := field.array.mismatch(value, lengths):
                raise MessageError(topic, where, fault)
        elif field.array is not None and value is not None:
            raise MessageError(topic, where, f"is a {type(value).__name__}, must be an ndarray")
        elif field.structs or field.has_floats:
            _validate_value(topic, value, where)


def _validate_value(topic: str, value: Any, path: str) -> None:
    if isinstance(value, msgspec.Struct):
        validate(topic, value, path + ".")
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise MessageError(topic, path, f"is {value}, must be finite")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            _validate_value(topic, item, f"{path}[{index}]")
    elif isinstance(value, dict):
        for key, item in value.items():
            _validate_value(topic, item, f"{path}.{key}")


def plain(message: Any, *, volatile: bool = True) -> Any:
    """The message as dicts, lists and arrays; without volatile fields if `volatile` is false."""
    if isinstance(message, msgspec.Struct):
        tag = message.__struct_config__.tag
        head = {} if tag is None else {message.__struct_config__.tag_field: tag}
        return head | {
            field.name: plain(getattr(message, field.name), volatile=volatile)
            for field in fields_of(type(message))
            if volatile or not field.volatile
        }
    if isinstance(message, (list, tuple)):
        return [plain(item, volatile=volatile) for item in message]
    if isinstance(message, dict):
        return {key: plain(item, volatile=volatile) for key, item in message.items()}
    return message
