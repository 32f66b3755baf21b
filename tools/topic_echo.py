"""`footfall topic echo`: messages in readable form; arrays are summed up unless asked for in full."""

import argparse
import json
from collections.abc import Iterator
from itertools import islice
from typing import Any

import msgspec
import numpy as np

from ..messages.bus import Received
from ..messages.codec import plain
from ..messages.config import ConfigError, near
from .observe import open_source, stream

_FEW = 8
"""Arrays of so many elements are shown in full."""


def echo(args: argparse.Namespace) -> int:
    """Print the messages the options ask for; 1 if it should have been so many and were not."""
    wanted = 1 if args.once else args.count
    shown = 0
    for received in islice(_messages(args), wanted):
        shown += 1
        value = _part(plain(received.message), args.field)
        if args.json:
            head = {
                "topic": received.topic,
                "publisher": received.publisher,
                "sequence": received.sequence,
                "stamp_ns": received.stamp_ns,
            }
            body = {args.field or "message": _jsonable(value, full=True)}
            print(json.dumps(head | body), flush=True)
        else:
            stamp = f"{received.stamp_ns * 1e-9:.3f} s"
            print(f"# {received.topic}@{received.publisher} {received.sequence} at {stamp}")
            print("\n".join(lines_of(value, full=args.full)), flush=True)
    return 0 if wanted is None or shown == wanted else 1


def _messages(args: argparse.Namespace) -> Iterator[Received[Any]]:
    if args.log:
        from ..messages.log import LogReader

        for logged in LogReader(args.log).messages([args.topic]):
            yield logged.received(args.topic)
        return
    bus = open_source(args, args.topic)
    try:
        yield from stream(bus, args.timeout)
    finally:
        bus.close()


def _part(value: Any, path: str | None) -> Any:
    """The part of a message at `a.b.0`.

    Raises:
        ConfigError: there is no such part; names the closest.
    """
    for step in path.split(".") if path else ():
        try:
            value = value[step] if isinstance(value, dict) else value[int(step)]
        except (KeyError, TypeError):
            known = ", ".join(value) if isinstance(value, dict) else type(value).__name__
            hint = near(step, value) if isinstance(value, dict) else f"it is a {known}"
            raise ConfigError(f"--field {path}: no {step!r} here; {hint}") from None
        except ValueError:
            raise ConfigError(f"--field {path}: {step!r} must be an index of a list") from None
        except IndexError:
            raise ConfigError(f"--field {path}: {step} is beyond the {len(value)} that are there") from None
    return value


def _jsonable(value: Any, full: bool) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist() if full else summary(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {key: _jsonable(item, full) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_jsonable(item, full) for item in value]
    return msgspec.to_builtins(value)


def summary(array: np.ndarray) -> str:
    """An array in one line: shape, type, range; few elements in full."""
    head = f"{array.dtype.name}{list(array.shape)}"
    if array.size <= _FEW:
        return f"{head} {np.array2string(array, precision=4, separator=', ').replace(chr(10), '')}"
    return f"{head} from {array.min():.5g} to {array.max():.5g}, mean {array.mean():.5g}"


def lines_of(value: Any, full: bool, indent: str = "") -> list[str]:
    """A value as indented lines, like YAML."""
    if isinstance(value, dict):
        lines = []
        for key, item in value.items():
            inner = lines_of(item, full, indent + "  ")
            opens = isinstance(item, dict) and item
            if opens or len(inner) > 1 or inner[0].startswith(f"{indent}  - "):
                lines += [f"{indent}{key}:", *inner]
            else:
                lines.append(f"{indent}{key}: {inner[0].strip()}")
        return lines or [f"{indent}{{}}"]
    if isinstance(value, (list, tuple)):
        if all(not isinstance(item, (dict, list, tuple, np.ndarray)) for item in value):
            return [f"{indent}[{', '.join(_scalar(item) for item in value)}]"]
        lines = []
        for item in value:
            inner = lines_of(item, full, indent + "  ")
            lines += [f"{indent}- {inner[0].strip()}", *inner[1:]]
        return lines
    if isinstance(value, np.ndarray):
        if not full:
            return [f"{indent}{summary(value)}"]
        rows = np.array2string(value, threshold=value.size + 1, precision=4, separator=", ").splitlines()
        return [indent + row for row in rows]
    return [f"{indent}{_scalar(value)}"]


def _scalar(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else json.dumps(value, default=str)
