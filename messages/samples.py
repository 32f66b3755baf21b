"""One message of every topic, always the same: for golden bytes, fuzzing and whoever writes a client."""

import types
import typing
from collections.abc import Mapping
from typing import Any, Literal, get_args, get_origin

import msgspec
import numpy as np

from .array import Array
from .schema import fields_of
from .topics import TOPICS, Topic

_LENGTHS = {"N": 3, "S": 2, "T": 5, "L": 4, "H": 6, "W": 7, "K": 4, "C": 2, "R": 5}


def samples(topics: Mapping[str, Topic] = TOPICS, scale: int = 1) -> dict[str, msgspec.Struct]:
    """A message of each topic by name, every field filled.

    Args:
        topics: Of which topics.
        scale: Times the lengths of arrays; from about 20 on some travel in frames of their own.
    """
    return {name: sample(topic.type, scale) for name, topic in topics.items()}


def sample(message_type: type[msgspec.Struct], scale: int = 1) -> Any:
    """A message of one type."""
    lengths = {name: length * scale for name, length in _LENGTHS.items()}
    values = {
        field.name: _array(field.array, lengths)
        if field.array is not None
        else _value(field.annotation, field.name, scale)
        for field in fields_of(message_type)
    }
    return message_type(**values)


def _array(spec: Array, lengths: dict[str, int]) -> np.ndarray:
    shape = tuple(n if isinstance(n, int) else lengths.get(n, 3) for n in spec.shape)
    count = int(np.prod(shape))
    return (
        (np.arange(count) % 100 * (0.25 if spec.numpy_dtype.kind == "f" else 1))
        .astype(spec.dtype)
        .reshape(shape)
    )


def _value(annotation: Any, name: str, scale: int) -> Any:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is typing.Annotated:
        return _value(arguments[0], name, scale)
    if origin is Literal:
        return arguments[-1]
    if origin in (typing.Union, types.UnionType):
        return _value(next(one for one in arguments if one is not type(None)), name, scale)
    if origin is list:
        return _list(arguments[0], name, scale)
    if origin is tuple:
        return tuple(_value(one, f"{name}{index}", scale) for index, one in enumerate(arguments))
    if origin is dict:
        return {f"{name}_key": _value(arguments[1], name, scale)}
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return sample(annotation, scale)
    return {bool: True, int: 7 + len(name), float: 0.5 + len(name), str: f"{name} ä"}.get(annotation, 1)


def _list(item: Any, name: str, scale: int) -> list[Any]:
    """Of a union one of each."""
    kinds = get_args(item) if get_origin(item) in (typing.Union, types.UnionType) else (item,)
    return [_value(kind, name, scale) for kind in kinds] * 2


if __name__ == "__main__":  # regenerates tests/messages/golden_messages.txt
    from .codec import Codec

    for topic, message in samples().items():
        codec = Codec(topic, TOPICS[topic].type)
        print(topic, codec.schema.hex(), codec.encode(message)[0].hex())
