"""What a message type promises: its fields, its hash, its JSON Schema."""

import hashlib
import json
import types
import typing
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec
import numpy as np

from .array import Array, Volatile


@dataclass(frozen=True)
class Field:
    """One field of a message struct, as the codec sees it."""

    name: str
    annotation: Any
    array: Array | None
    volatile: bool
    structs: tuple[type[msgspec.Struct], ...]
    """Struct types that may stand in this field, directly or inside a container."""
    has_floats: bool
    """Whether the field itself may hold floats outside arrays."""


def _parts(annotation: Any) -> list[Any]:
    """All the types an annotation is made of, `Annotated` and containers opened."""
    if typing.get_origin(annotation) is typing.Annotated:
        return _parts(typing.get_args(annotation)[0])
    arguments = typing.get_args(annotation)
    if not arguments or typing.get_origin(annotation) is typing.Literal:
        return [annotation]
    return [part for argument in arguments if argument is not Ellipsis for part in _parts(argument)]


@cache
def fields_of(message_type: type[msgspec.Struct]) -> tuple[Field, ...]:
    """The fields of a message struct, in order.

    Raises:
        TypeError: an ndarray field has no `Array` specification.
    """
    hints = typing.get_type_hints(message_type, include_extras=True)
    fields = []
    for name in message_type.__struct_fields__:
        extras = getattr(hints[name], "__metadata__", ())
        parts = _parts(hints[name])
        array = next((extra for extra in extras if isinstance(extra, Array)), None)
        if np.ndarray in parts and array is None:
            raise TypeError(
                f"{message_type.__name__}.{name} is an ndarray without an Array(...) specification"
            )
        structs = tuple(p for p in parts if isinstance(p, type) and issubclass(p, msgspec.Struct))
        volatile = any(isinstance(extra, Volatile) for extra in extras)
        fields.append(Field(name, hints[name], array, volatile, structs, float in parts))
    return tuple(fields)


def _type_text(annotation: Any) -> str:
    """A canonical spelling of a type, the same on every Python."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _type_text(typing.get_args(annotation)[0])
    if origin is None:
        return getattr(annotation, "__name__", str(annotation))
    name = "union" if origin in (typing.Union, types.UnionType) else getattr(origin, "__name__", str(origin))
    arguments = [a if isinstance(a, str) else _type_text(a) for a in typing.get_args(annotation)]
    return f"{name}[{','.join(arguments)}]"


def _canonical(message_type: type[msgspec.Struct]) -> list[Any]:
    """Names, types, defaults and array specifications, recursively, as plain lists."""
    info = {field.name: field for field in msgspec.structs.fields(message_type)}
    rows = []
    for field in fields_of(message_type):
        default = info[field.name].default
        factory = info[field.name].default_factory
        array = field.array and [
            np.dtype(field.array.dtype).str,
            list(field.array.shape),
            field.array.allow_nan,
        ]
        default_text = (
            "required"
            if default is msgspec.NODEFAULT and factory is msgspec.NODEFAULT
            else repr(default)
            if factory is msgspec.NODEFAULT
            else repr(factory())
        )
        rows.append(
            [
                field.name,
                _type_text(field.annotation),
                default_text,
                array,
                [_canonical(s) for s in field.structs],
            ]
        )
    return [message_type.__name__, message_type.__struct_config__.tag, rows]


@cache
def schema_hash(message_type: type[msgspec.Struct]) -> bytes:
    """The first 8 bytes of SHA-256 over the canonical fields: two types with one hash are one type."""
    return hashlib.sha256(json.dumps(_canonical(message_type), separators=(",", ":")).encode()).digest()[:8]


@cache
def json_schema(message_type: type[msgspec.Struct]) -> dict[str, Any]:
    """The message as JSON Schema (draft 2020-12); arrays as `[dtype, shape, data]` with `x-array` notes."""
    schema = msgspec.json.schema(message_type, schema_hook=lambda _: {"$ref": "#/$defs/ndarray"})
    definitions = schema.setdefault("$defs", {})
    definitions["ndarray"] = {
        "description": "dtype as numpy spells it, shape, elements in C order (little endian bytes)",
        "type": "array",
        "prefixItems": [
            {"enum": sorted(_dtype_names())},
            {"type": "array", "items": {"type": "integer"}},
            {},
        ],
        "minItems": 3,
        "maxItems": 3,
    }

    def annotate(struct: type[msgspec.Struct]) -> None:
        properties = definitions[struct.__name__]["properties"]
        for field in fields_of(struct):
            if field.array is not None:
                note: dict[str, Any] = {"dtype": field.array.dtype, "shape": list(field.array.shape)}
                note |= {key: value for key in ("unit", "frame") if (value := getattr(field.array, key))}
                properties[field.name]["x-array"] = note
            for child in field.structs:
                annotate(child)

    annotate(message_type)
    return schema


def _dtype_names() -> list[str]:
    from .array import DTYPES

    return list(DTYPES)
