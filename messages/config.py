"""Configuration from plain data: defaults in code, overrides from YAML, errors with the near match."""

import difflib
import re
from collections.abc import Iterable
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")


class ConfigError(ValueError):
    """A configuration that cannot be used: says where, what is wrong and what would be right."""


def near(name: str, known: Iterable[str]) -> str:
    """The end of an error sentence: the closest known name, or all of them."""
    names = sorted(known)
    match = difflib.get_close_matches(name, names, 1)
    return f"did you mean {match[0]!r}?" if match else f"known: {', '.join(names) or 'none'}"


def configure(config_type: type[T], values: Any, where: str) -> T:
    """Turn plain values into a typed configuration.

    Args:
        config_type: A msgspec struct (with `forbid_unknown_fields`) whose defaults are the shipped behaviour.
        values: Dicts, lists and scalars, as YAML gives them.
        where: File and place, for the error.

    Raises:
        ConfigError: an unknown key (with the near match), a wrong type, a value out of range.
    """
    try:
        return msgspec.convert(values, config_type)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `")
        place = re.sub(r"^\$\.?", "", path.rstrip("`"))
        place = f"{where}: {place}" if place else where
        info = _type_at(config_type, path)
        if match := re.fullmatch(r"Object contains unknown field `(.*)`", reason):
            known = [field.encode_name for field in getattr(info, "fields", ())]
            raise ConfigError(f"{place}: unknown key {match[1]!r}; {near(match[1], known)}") from None
        if match := re.fullmatch(r"Invalid enum value '(.*)'", reason):
            known = [str(value) for value in getattr(info, "values", ())]
            raise ConfigError(f"{place}: no such choice {match[1]!r}; {near(match[1], known)}") from None
        raise ConfigError(f"{place}: {reason}") from None


def _type_at(config_type: Any, path: str) -> Any:
    """What is wanted at a path such as `$.clock.mode` below `config_type`, found by walking the types."""
    info = msgspec.inspect.type_info(config_type)
    for step in re.findall(r"\.([^.\[\]]+)|\[([^\]]*)\]", path.rstrip("`").removeprefix("$")):
        info = _child(info, step[0] or step[1])
    return _open(info)


def _open(info: Any) -> Any:
    """The struct, mapping or list inside an optional or a union."""
    if isinstance(info, msgspec.inspect.UnionType):
        return next((t for t in info.types if not isinstance(t, msgspec.inspect.NoneType)), info)
    return info


def _child(info: Any, step: str) -> Any:
    info = _open(info)
    if isinstance(info, msgspec.inspect.StructType):
        return next((f.type for f in info.fields if f.encode_name == step), info)
    if isinstance(info, msgspec.inspect.DictType):
        return info.value_type
    return getattr(info, "item_type", info)
