"""`footfall topic pub`: hand a message, written as YAML or JSON, to the nodes that listen to a topic."""

import argparse
import os
import sys
import typing
from time import monotonic, sleep
from typing import Any

import msgpack
import msgspec
import numpy as np
import yaml

from ..messages.array import Array
from ..messages.codec import Codec
from ..messages.config import ConfigError, near
from ..messages.custom_topics import resolve_topics
from ..messages.link import Link, Publish, Reply
from ..messages.schema import Field, fields_of
from ..messages.topics import Topic
from .observe import graph_of, known_topic

TIMEOUT = 3.0
"""Longest wait for the launcher's answer [s]."""


def pub(args: argparse.Namespace) -> int:
    """Publish once, or at a rate until stopped.

    Raises:
        ConfigError: the message does not fit the topic, nobody listens, or the launcher does not answer.
        MessageError: the message does not fit the topic.
    """
    graph = graph_of(args)
    topics = resolve_topics(graph)
    heard = {wire.topic for node in graph.nodes for wire in node.inputs.values()}
    topic = known_topic(args.topic, topics, heard)
    body = record_of(topic, _values(args.values))
    if args.rate is not None and not args.rate > 0:
        raise ConfigError(f"--rate {args.rate:g}: must be above 0")
    wanted = args.count if args.count is not None else (1 if args.rate is None else None)
    link = Link(graph.run_dir, f"client-{os.getpid()}")
    sent, begin = 0, monotonic()
    try:
        while wanted is None or sent < wanted:
            link.send(Publish(topic.name, body))
            reply = link.receive(TIMEOUT)
            if not isinstance(reply, Reply):
                raise ConfigError(f"the launcher of {graph.name} does not answer")
            if reply.error:
                raise ConfigError(reply.error)
            sent += 1
            if args.rate is not None:
                sleep(max(0.0, begin + sent / args.rate - monotonic()))
    finally:
        link.close()
    return 0


def _values(text: str) -> Any:
    try:
        return yaml.safe_load(sys.stdin if text == "-" else text)
    except yaml.YAMLError as error:
        problem = getattr(error, "problem", None) or "it cannot be read"
        raise ConfigError(f"the message is neither YAML nor JSON: {problem}; put it in quotes") from None


def record_of(topic: Topic, values: Any) -> bytes:
    """A message from plain values: arrays are nested lists, structs are mappings of their fields.

    Returns:
        One self-contained msgpack record.

    Raises:
        ConfigError: an unknown field (with the near match), or an array that is none.
        MessageError: a value of the wrong type, a missing field.
    """
    plain = _struct(topic.type, {} if values is None else values, topic.name)
    codec = Codec(topic.name, topic.type)
    return codec.encode_inline(codec.decode(msgpack.packb(plain) or b""))


def _struct(kind: type[msgspec.Struct], values: Any, where: str) -> dict[str, Any]:
    """The fields of a struct as they go over the wire."""
    config = kind.__struct_config__
    names = [*kind.__struct_fields__, *([config.tag_field] if config.tag_field else [])]
    if not isinstance(values, dict):
        raise ConfigError(f"{where}: must be a mapping with {', '.join(names) or 'nothing in it'}")
    if unknown := next((str(name) for name in values if name not in names), None):
        raise ConfigError(f"{where}: no field {unknown!r}; {near(unknown, names)}")
    wire = dict(values)
    for field in fields_of(kind):
        if (value := values.get(field.name)) is not None:
            wire[field.name] = _field(field, value, f"{where}: {field.name}")
    return wire


def _field(field: Field, value: Any, where: str) -> Any:
    if field.array is not None:
        return _array(field.array, value, where)
    if not field.structs:
        return value
    if isinstance(value, list):
        return [_field(field, item, f"{where}[{index}]") for index, item in enumerate(value)]
    if typing.get_origin(field.annotation) is dict:
        return {key: _struct(field.structs[0], item, f"{where}.{key}") for key, item in dict(value).items()}
    return _struct(_kind(field.structs, value, where), value, where)


def _kind(kinds: tuple[type[msgspec.Struct], ...], value: Any, where: str) -> type[msgspec.Struct]:
    """Which of several structs a mapping is, by its field `type`."""
    if len(kinds) == 1:
        return kinds[0]
    names = {str(kind.__struct_config__.tag): kind for kind in kinds}
    name = value.get("type") if isinstance(value, dict) else None
    if name not in names:
        said = f"no type {name!r}" if name else "must say its `type`"
        raise ConfigError(f"{where}: {said}; {near(str(name or ''), names)}")
    return names[name]


def _array(spec: Array, value: Any, where: str) -> list[Any]:
    try:
        given = np.asarray(value)
        whole = given.dtype.kind in "iu"
        casting = "unsafe" if whole else "same_kind"
        array = given.astype(spec.numpy_dtype, casting=casting) if given.size else _empty(spec)
        if whole and spec.numpy_dtype.kind in "iu" and (array != given).any():
            raise ValueError("out of range")
    except (ValueError, TypeError):
        raise ConfigError(f"{where}: must be an array {spec.shape_text} of {spec.numpy_dtype.name}") from None
    return [array.dtype.str, array.shape, array.tobytes()]


def _empty(spec: Array) -> np.ndarray:
    """No elements, in the shape that is asked for: letters are 0."""
    return np.zeros([0 if isinstance(length, str) else length for length in spec.shape], spec.numpy_dtype)
