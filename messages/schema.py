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

from .array import DTYPES, Array, Volatile


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
    optional: bool
    """Whether it may be None."""


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
        fields.append(Field(name, hints[name], array, volatile, structs, float in parts, type(None) in parts))
    return tuple(fields)


def _type_text(annotation: Any) -> str:
    """A canonical spelling of a type, the same on every Python."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        base, *extras = typing.get_args(annotation)
        bounds = [repr(extra) for extra in extras if isinstance(extra, msgspec.Meta)]
        return _type_text(base) + "".join(bounds)
    if origin is None:
        return getattr(annotation, "__name__", str(annotation))
    if origin is typing.Literal:
        return f"Literal[{','.join(repr(value) for value in typing.get_args(annotation))}]"
    name = "union" if origin in (typing.Union, types.UnionType) else getattr(origin, "__name__", str(origin))
    return f"{name}[{','.join(_type_text(argument) for argument in typing.get_args(annotation))}]"


def _default_text(info: msgspec.structs.FieldInfo) -> str:
    """A field's default in canonical spelling; `required` if it has none."""
    if info.default is not msgspec.NODEFAULT:
        return repr(info.default)
    return "required" if info.default_factory is msgspec.NODEFAULT else repr(info.default_factory())


def _canonical(
    message_type: type[msgspec.Struct], required_only: bool, above: tuple[type, ...] = ()
) -> list[Any]:
    """Names, types, defaults and array specifications, recursively, as plain lists."""
    info = {field.name: field for field in msgspec.structs.fields(message_type)}
    rows = []
    for field in fields_of(message_type):
        default = _default_text(info[field.name])
        if required_only and default != "required":
            continue
        array = field.array
        spec = array and [
            array.numpy_dtype.str,
            list(array.shape),
            array.unit,
            array.frame,
            array.allow_nan,
        ]
        inner = [
            struct.__name__
            if struct in above
            else _canonical(struct, required_only, (*above, message_type, struct))
            for struct in field.structs
        ]
        rows.append([field.name, _type_text(field.annotation), default, spec, inner])
    return [message_type.__name__, message_type.__struct_config__.tag, rows]


def _digest(canonical: list[Any]) -> bytes:
    return hashlib.sha256(json.dumps(canonical, separators=(",", ":")).encode()).digest()[:4]


@cache
def schema_hash(message_type: type[msgspec.Struct]) -> bytes:
    """8 bytes that change with every change of a message type.

    The first four are of SHA-256 over the required fields alone, the last four over all fields: names,
    types, defaults, array dtype, shape, unit and frame, recursively. Equal hashes are one type; see
    `compatible` for what shares the first half only.
    """
    required = _canonical(message_type, required_only=True)
    return _digest(["required", required]) + _digest(["all", _canonical(message_type, required_only=False)])


def compatible(ours: bytes, theirs: bytes) -> bool:
    """Whether two schema hashes differ in fields with defaults at most, so that one can read the other."""
    return ours[:4] == theirs[:4]


@cache
def json_schema(message_type: type[msgspec.Struct]) -> dict[str, Any]:
    """The message as JSON Schema (draft 2020-12); arrays as `[dtype, shape, data]` with `x-array` notes."""
    schema = msgspec.json.schema(message_type, schema_hook=lambda _: {"$ref": "#/$defs/ndarray"})
    definitions = schema.setdefault("$defs", {})
    definitions["ndarray"] = {
        "description": "dtype as numpy spells it, shape, elements in C order (little endian bytes)",
        "type": "array",
        "prefixItems": [
            {"enum": sorted(DTYPES)},
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
