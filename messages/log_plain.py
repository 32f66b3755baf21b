"""Reads records whose type is not known here."""

from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np

from .array import DTYPES
from .codec import MessageError


def plain_decoder(topic: str) -> Callable[[bytes], Any]:
    """Decodes records of any type into dicts, lists and arrays."""

    def decode(record: bytes) -> Any:
        try:
            return _arrays(msgpack.unpackb(record))
        except (ValueError, msgpack.UnpackException) as error:
            raise MessageError(topic, "", f"is not msgpack: {error}") from None

    return decode


def _arrays(value: Any) -> Any:
    """Turn `[dtype, shape, bytes]` into arrays."""
    if isinstance(value, dict):
        return {key: _arrays(item) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    if len(value) == 3 and isinstance(value[0], str) and value[0] in DTYPES and isinstance(value[2], bytes):
        return np.frombuffer(value[2], DTYPES[value[0]]).reshape(value[1])
    return [_arrays(item) for item in value]
