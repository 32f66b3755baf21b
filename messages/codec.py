"""Messages to bytes and back: standard msgpack, arrays beside the body, everything checked."""

import math
import re
import reprlib
import struct
from collections.abc import Sequence
from functools import cache
from types import NoneType
from typing import Any, ClassVar, Generic, TypeVar
from weakref import WeakValueDictionary

import msgspec
import numpy as np

from .array import DTYPES, owner_of
from .schema import Field, fields_of, schema_hash

M = TypeVar("M", bound=msgspec.Struct)
Buffer = bytes | bytearray | memoryview

INLINE_BYTES = 1 << 16
"""Arrays up to this size travel inside the msgpack body; larger ones in a frame of their own.

Below it, copying is cheaper than one more frame, and the arrays of small frames lie unaligned."""

MAX_FRAMES = 255
"""Array frames of one message; the header has one byte to count them."""

MAX_AXES = 8

_HEADER = struct.Struct("<2sBBQqq8s")
_MAGIC = b"FF"
WIRE_VERSION = 1
_CHECKED = 0x80
"""Bit of the version byte: the sender has looked for NaN."""
_OURS = WIRE_VERSION | _CHECKED


class MessageError(ValueError):
    """A message that is not what its topic promises: names the topic, the field and the reason."""

    def __init__(self, topic: str, field: str, reason: str) -> None:
        field, reason = _short(field), _short(reason)
        super().__init__(f"{topic}: {field}: {reason}" if field else f"{topic}: {reason}")
        self.topic = topic
        self.field = field
        self.reason = reason


def _short(text: str) -> str:
    """A hostile message must not become a page of log."""
    return text if len(text) <= 400 else f"{text[:200]}...{text[-100:]}"


class Header(msgspec.Struct, frozen=True):
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
    checked: bool = False
    """Whether the sender has looked through the arrays for NaN and infinity."""

    SIZE: ClassVar[int] = _HEADER.size

    def pack(self) -> bytes:
        """The header's bytes: magic, version, frames, sequence, stamps, schema; little endian."""
        version = _OURS if self.checked else WIRE_VERSION
        return _HEADER.pack(
            _MAGIC, version, self.frames, self.sequence, self.stamp_ns, self.sent_ns, self.schema
        )

    @staticmethod
    def count_frames(data: bytes) -> int:
        """How many frames a header announces; none if it is too short to be one."""
        return data[3] if len(data) > 3 else 0

    @classmethod
    def unpack(cls, topic: str, data: Buffer) -> "Header":
        """Read a header.

        Raises:
            MessageError: too short, not ours, of another wire version, or stamped before time began.
        """
        if len(data) < _HEADER.size:
            raise MessageError(topic, "header", f"{len(data)} bytes, must be at least {_HEADER.size}")
        magic, version, frames, sequence, stamp_ns, sent_ns, schema = _HEADER.unpack_from(data)
        if magic != _MAGIC:
            raise MessageError(topic, "header", f"starts with {bytes(magic)!r}, must start with {_MAGIC!r}")
        checked = version >= _CHECKED
        if version != (_OURS if checked else WIRE_VERSION):
            version &= ~_CHECKED
            raise MessageError(topic, "header", f"wire version {version}, this side speaks {WIRE_VERSION}")
        if stamp_ns < 0:
            raise MessageError(topic, "header.stamp_ns", f"is {stamp_ns}, must not be negative")
        return cls(sequence, stamp_ns, sent_ns, schema, frames, checked)


class Codec(Generic[M]):
    """Encodes and decodes one message type of one topic.

    A body is a msgpack map of field names; an array field is `[dtype, shape, where]`, where `where` is
    the index of its frame, or the elements themselves when they are few or the message is self-contained.
    A codec belongs to one thread.
    """

    def __init__(self, topic: str, message_type: type[M]) -> None:
        self.topic = topic
        self.type = message_type
        self.schema = schema_hash(message_type)
        self._frames: list[np.ndarray] = []
        self._received: Sequence[Buffer] = ()
        self._used: set[int] = set()
        self._inline_limit = INLINE_BYTES
        self._buffer = bytearray()
        self._arrays = _arrays_alone(message_type)
        self._encoder = msgspec.msgpack.Encoder(enc_hook=self._encode_array)
        self._decoder = msgspec.msgpack.Decoder(message_type, dec_hook=self._decode_array)

    def encode(self, message: M) -> tuple[bytes, list[np.ndarray]]:
        """Body and array frames; the frames are the message's own arrays, not copies.

        Raises:
            MessageError: a field does not match its specification.
        """
        body, frames = self.pack(message, 0, 0, 0)
        return bytes(body[Header.SIZE :]), frames

    def pack(
        self, message: M, sequence: int, stamp_ns: int, sent_ns: int
    ) -> tuple[bytearray, list[np.ndarray]]:
        """Header and body, in a buffer that the next call writes over, and the array frames.

        Raises:
            MessageError: a field does not match its specification.
        """
        self._check(message)
        buffer, frames = self._buffer, self._frames
        try:
            self._encoder.encode_into(message, buffer, Header.SIZE)
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise MessageError(self.topic, "", str(error)) from None
        finally:
            self._frames = []  # arrays live no longer than their message
        count = len(frames)
        if count > MAX_FRAMES:
            raise MessageError(self.topic, "frames", f"{count} large arrays, at most {MAX_FRAMES} fit")
        _HEADER.pack_into(buffer, 0, _MAGIC, _OURS, count, sequence, stamp_ns, sent_ns, self.schema)
        return buffer, frames

    def encode_inline(self, message: M) -> bytes:
        """One self-contained msgpack record with every array inside, as logs store it.

        Raises:
            MessageError: a field does not match its specification.
        """
        self._check(message)
        self._inline_limit = 1 << 62
        try:
            return self._encoder.encode(message)
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise MessageError(self.topic, "", str(error)) from None
        finally:
            self._inline_limit = INLINE_BYTES

    def decode(
        self,
        body: Buffer,
        frames: Sequence[Buffer] = (),
        *,
        schema: bytes | None = None,
        finite: bool = False,
    ) -> M:
        """The message; its arrays are read-only, and views of `frames` where those are aligned.

        Args:
            body: The msgpack map.
            frames: Array frames in the order of their indices.
            schema: Schema hash the sender gave, where it is not ours but `compatible` with it: fields we
                do not know are then left aside, and fields the sender does not know get their defaults.
            finite: The sender has looked for NaN, and can be believed: arrays need not be read again.

        Raises:
            MessageError: anything that is not exactly a valid message of this type.
        """
        self._received = frames
        self._used = set()
        try:
            message = self._decoder.decode(body)
            if len(self._used) != len(frames) and schema is None:
                raise MessageError(
                    self.topic, "frames", f"{len(frames)} frames came, the body uses {len(self._used)}"
                )
            if self._arrays is None or not _sound(message, self._arrays, not finite):
                validate(self.topic, message)
            elif finite and frames:
                _believe(message, self._arrays)
        except MessageError as error:
            raise self._named(error, schema) from None
        except (msgspec.DecodeError, ValueError, TypeError, OverflowError, RecursionError) as error:
            reason, _, path = str(error).partition(" - at `")
            raise self._named(MessageError(self.topic, _field_of(path), reason), schema) from None
        finally:
            self._received = ()
        return message

    def _named(self, error: MessageError, schema: bytes | None) -> MessageError:
        if schema is None:
            return error
        text = f"{error.reason} (sent as schema {schema.hex()}, read as {self.schema.hex()})"
        return MessageError(self.topic, error.field, text)

    def _check(self, message: M) -> None:
        if type(message) is not self.type:
            raise MessageError(
                self.topic, "", f"is a {type(message).__name__}, must be a {self.type.__name__}"
            )
        if self._arrays is None or not _sound(message, self._arrays, True):
            validate(self.topic, message)

    def _encode_array(self, value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            if isinstance(value, np.generic):
                return value.item()
            raise TypeError(f"{type(value).__name__} cannot stand in a message")
        if value.nbytes <= self._inline_limit:
            return (value.dtype.str, value.shape, value.data if value.flags.c_contiguous else value.tobytes())
        self._frames.append(value if value.flags.c_contiguous else value.copy(order="C"))
        return (value.dtype.str, value.shape, len(self._frames) - 1)

    def _decode_array(self, wanted: type, value: Any) -> Any:
        if wanted is not np.ndarray:
            raise TypeError(f"{wanted.__name__} cannot stand in a message")
        if not isinstance(value, (list, tuple)) or len(value) != 3:
            raise ValueError("an array must be [dtype, shape, where]")
        dtype_name, shape, where = value
        dtype = DTYPES.get(dtype_name) if isinstance(dtype_name, str) else None
        if dtype is None:
            raise ValueError(f"dtype {_told(dtype_name)} is not one of {', '.join(sorted(DTYPES))}")
        if not _is_shape(shape):
            raise ValueError(f"shape {_told(shape)} is not a list of at most {MAX_AXES} lengths")
        if isinstance(where, bytes):
            data: Buffer = where
        elif type(where) is int and 0 <= where < len(self._received) and where not in self._used:
            self._used.add(where)
            data = self._received[where]
        else:
            raise ValueError(f"frame {_told(where)} is not among the {len(self._received)} frames that came")
        size = math.prod(shape) * dtype.itemsize
        if size != len(data):
            raise ValueError(f"shape {tuple(shape)} of {dtype.str} needs {size} bytes, {len(data)} came")
        array = np.ndarray(shape, dtype, data)
        if data is where:
            return array  # read-only and aligned, as bytes are
        if not array.flags.aligned:  # frames under about 9 kB lie anywhere in the receive buffer
            array = array.copy()
        array.flags.writeable = False
        return array


_cut = reprlib.Repr()
_cut.maxlist = _cut.maxtuple = MAX_AXES
_cut.maxlevel = 2
_cut.maxstring = 80


def _told(value: Any) -> str:
    """For an error: what may be huge is cut before it is written out."""
    return repr(value[:80]) if isinstance(value, bytes) else _cut.repr(value)


def _is_shape(shape: Any) -> bool:
    """Whether these are lengths: Python multiplies numbers by texts and lists, into gigabytes."""
    if not isinstance(shape, (list, tuple)) or len(shape) > MAX_AXES:
        return False
    for length in shape:  # noqa: SIM110 - a generator takes twice as long
        if length.__class__ is not int or length < 0:
            return False
    return True


def _field_of(path: str) -> str:
    return re.sub(r"^\$\.?", "", path.rstrip("`"))


@cache
def _checked_fields(message_type: type[msgspec.Struct]) -> tuple[Field, ...]:
    return tuple(f for f in fields_of(message_type) if f.array or f.structs or f.has_floats)


@cache
def _arrays_alone(message_type: type[msgspec.Struct]) -> tuple[tuple[str, Any, tuple, bool], ...] | None:
    """Name, dtype, axes and whether NaN is barred, of all that is to check; None if there is more to it."""
    fields = _checked_fields(message_type)
    specs = [(field.name, field.array) for field in fields if field.array is not None]
    if len(specs) < len(fields):
        return None
    return tuple(
        (name, spec.numpy_dtype, spec.shape, not spec.allow_nan and spec.numpy_dtype.kind == "f")
        for name, spec in specs
    )


def _sound(message: msgspec.Struct, arrays: tuple[tuple[str, Any, tuple, bool], ...], finite: bool) -> bool:
    """Whether arrays are surely right; a quick look, and `validate` decides where there is doubt."""
    lengths: dict[str, int] = {}
    for name, dtype, axes, real in arrays:
        array = getattr(message, name)
        if array.__class__ is not np.ndarray or array.dtype is not dtype:
            return False
        shape = array.shape
        if len(shape) != len(axes):
            return False
        for length, wanted in zip(shape, axes):  # noqa: B905 - of one length, as was just seen
            if wanted.__class__ is not int:
                wanted = lengths.setdefault(wanted, length)
            if length != wanted:
                return False
        if finite and real and not _is_finite(array):
            return False
    return True


_finite: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()
"""Large arrays that nobody can write to and that have been looked through, by identity."""


def _is_finite(array: np.ndarray) -> bool:
    """Whether an array is surely free of NaN and infinity; a large frozen one is looked through once."""
    large = array.nbytes >= INLINE_BYTES
    if large and _finite.get(id(array)) is array and not array.flags.writeable:
        return True
    if not math.isfinite(np.vdot(array, array)):
        return False
    if large and isinstance(owner_of(array), (bytes, NoneType)):
        _finite[id(array)] = array
    return True


def _believe(message: msgspec.Struct, arrays: tuple[tuple[str, Any, tuple, bool], ...]) -> None:
    """Remember that whoever sent a message has looked through its arrays, which nobody else can write to."""
    for name, _, _, real in arrays:
        array = getattr(message, name)
        if real and array.nbytes >= INLINE_BYTES:
            _finite[id(array)] = array


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
        elif field.array is not None and (value is not None or not field.optional):
            raise MessageError(topic, where, f"is a {type(value).__name__}, must be an ndarray")
        elif field.structs or field.has_floats:
            _validate_value(topic, value, where)


def _validate_value(topic: str, value: Any, path: str) -> None:
    if isinstance(value, msgspec.Struct):
        validate(topic, value, path + ".")
    elif isinstance(value, (float, np.floating)):
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
