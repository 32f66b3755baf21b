"""Launch files as plain values: YAML read strictly, includes merged in, arguments put in."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import yaml

from ..messages.config import ConfigError, configure, near

SHIPPED = Path(__file__).parent
"""Where the launch files and scenes of the package are."""


class Include(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Another launch file, taken in with arguments."""

    file: str
    """Relative to this file, or the name of a shipped one."""
    args: dict[str, Any] = {}


def expand(
    path: Path, given: Mapping[str, Any], declared: dict[str, Any], outer: tuple[Path, ...] = ()
) -> dict[str, Any]:
    """A file's values with its includes merged in and its arguments put in.

    Args:
        path: The file.
        given: Arguments; they win over those of an `include`, which win over defaults.
        declared: Takes up every argument that may be given, with its default.
        outer: The files that include this one.

    Raises:
        ConfigError: not YAML, an unknown argument, an include that is not there or goes round in a circle.
    """
    if path in outer:
        raise ConfigError(f"{path}: includes itself by way of {outer[-1].name}")
    values = _read(path)
    own = configure(dict[str, Any], values.pop("args", None) or {}, f"{path}: args")
    args = {name: given.get(name, default) for name, default in own.items()}
    values = {key: _substitute(value, args, f"{path}: {key}") for key, value in values.items()}
    _resolve_key_files(values, path)
    merged: dict[str, Any] = {}
    for item in configure(list[str | Include], values.pop("include", None) or [], f"{path}: include"):
        include = Include(item) if isinstance(item, str) else item
        inner: dict[str, Any] = {}
        child = expand(_find(path, include.file), {**include.args, **given}, inner, (*outer, path))
        if unknown := next((name for name in include.args if name not in inner), None):
            raise ConfigError(
                f"{path}: include: {include.file} has no argument {unknown!r}; {near(unknown, inner)}"
            )
        declared.update({name: include.args.get(name, default) for name, default in inner.items()})
        merged = _merge(merged, {k: v for k, v in child.items() if k not in ("name", "description")})
    declared.update(own)
    merged = _merge(merged, values)
    if isinstance(nodes := merged.get("nodes"), dict):
        merged["nodes"] = {name: node for name, node in nodes.items() if node is not None}
    return merged


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key written twice."""


def _unique_mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise yaml.MarkedYAMLError(problem="a key must be a word", problem_mark=key.start_mark)
        if key.value in seen:
            raise yaml.MarkedYAMLError(
                problem=f"key {key.value!r} is written twice", problem_mark=key.start_mark
            )
        seen.add(key.value)
    loader.flatten_mapping(node)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def _read(path: Path) -> dict[str, Any]:
    try:
        values = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except yaml.MarkedYAMLError as error:
        place = f"{path}:{error.problem_mark.line + 1}" if error.problem_mark else str(path)
        raise ConfigError(f"{place}: not valid YAML: {error.problem}") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise ConfigError(f"{path}: not a YAML text file") from None
    except (ValueError, RecursionError) as error:  # a date that is none, a list in a list in a list
        raise ConfigError(f"{path}: not valid YAML: {error}") from None
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: a launch file is a mapping with `nodes`, not {type(values).__name__}")
    return values


def _resolve_key_files(values: dict[str, Any], path: Path) -> None:
    """Key files are named relative to the launch file that names them."""
    if isinstance(security := values.get("security"), dict):
        values["security"] = {
            key: str(path.parent / Path(value).expanduser()) if isinstance(value, str) else value
            for key, value in security.items()
        }
    if isinstance(remotes := values.get("remotes"), dict):
        for remote in remotes.values():
            if isinstance(remote, dict) and isinstance(key_file := remote.get("server_key_file"), str):
                remote["server_key_file"] = str(path.parent / Path(key_file).expanduser())


def _find(path: Path, file: str) -> Path:
    for candidate in (path.parent / file, SHIPPED / file, SHIPPED / f"{file}.yaml"):
        if candidate.is_file():
            return candidate.resolve()
    known = [shipped.name for shipped in SHIPPED.glob("*.yaml")]
    raise ConfigError(f"{path}: include: no file {file!r} beside it and no shipped one; {near(file, known)}")


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` wins, mapping by mapping."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return merged


_ARGUMENT = re.compile(r"\$(?:\$|(\w+)|\{(\w+)\})")


def _substitute(value: Any, args: Mapping[str, Any], where: str) -> Any:
    """A string that is only `$arg` becomes its value; others get it written in; `$$` is `$`."""
    if isinstance(value, dict):
        return {key: _substitute(item, args, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list):
        return [_substitute(item, args, where) for item in value]
    if not isinstance(value, str):
        return value

    def lookup(match: re.Match[str]) -> Any:
        name = match[1] or match[2]
        if name is None:
            return "$"
        if name not in args:
            raise ConfigError(f"{where}: {name!r} is not among the file's `args`; {near(name, args)}")
        return args[name]

    if match := _ARGUMENT.fullmatch(value):
        return lookup(match)
    return _ARGUMENT.sub(lambda match: str(lookup(match)), value)
