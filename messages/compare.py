"""Where two messages differ first: for regression and for comparing logs."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from .schema import fields_of


@dataclass(frozen=True)
class Difference:
    """The first place where two messages are not the same."""

    field: str
    """Path of the field, e.g. `agents[2].objectives[0].weight`."""
    index: tuple[int, ...] | None
    """Element of the field, where it is an array."""
    left: Any
    right: Any

    @property
    def text(self) -> str:
        """`positions[3, 0, 1, 0]: 1.5 and 1.25`."""
        place = self.field
        if self.index is not None:
            place += f"[{', '.join(map(str, self.index))}]"
        return f"{place}: {_shown(self.left)} and {_shown(self.right)}"


@dataclass(frozen=True)
class Tolerance:
    """What counts as the same.

    Fields are named by their path without indices, `agents.objectives.weight`, or by the last part of it.
    """

    ignore: Collection[str] = ()
    absolute: Mapping[str, float] = field(default_factory=dict)

    def ignores(self, path: str) -> bool:
        """Whether a field does not count."""
        return any(_names(name, path) for name in self.ignore)

    def of(self, path: str) -> float:
        """Largest difference of two numbers that are the same."""
        return max((value for name, value in self.absolute.items() if _names(name, path)), default=0.0)


def first_difference(left: Any, right: Any, tolerance: Tolerance | None = None) -> Difference | None:
    """The first field in which two messages differ, or None.

    NaN equals NaN; volatile fields never differ.
    """
    return _compare(left, right, "", "", tolerance or Tolerance())


def _names(name: str, path: str) -> bool:
    return path == name or path.endswith(f".{name}")


def _compare(left: Any, right: Any, shown: str, path: str, tolerance: Tolerance) -> Difference | None:
    """Args: `shown` is the path with indices, `path` without."""
    if tolerance.ignores(path):
        return None
    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray):
        return _compare_arrays(left, right, shown, tolerance.of(path))
    if isinstance(left, msgspec.Struct) and type(left) is type(right):
        names = [field.name for field in fields_of(type(left)) if not field.volatile]
        return _compare_items(
            ((name, getattr(left, name), getattr(right, name)) for name in names), shown, path, tolerance
        )
    if isinstance(left, dict) and isinstance(right, dict):
        if left.keys() != right.keys():
            return Difference(f"keys of {shown}" if shown else "keys", None, sorted(left), sorted(right))
        return _compare_items(((key, left[key], right[key]) for key in left), shown, path, tolerance)
    if isinstance(left, (list, tuple)) and isinstance(right, (list, tuple)):
        if len(left) != len(right):
            return Difference(f"length of {shown}", None, len(left), len(right))
        for index, (ours, theirs) in enumerate(zip(left, right, strict=True)):
            if found := _compare(ours, theirs, f"{shown}[{index}]", path, tolerance):
                return found
        return None
    if isinstance(left, (int, float)) and isinstance(right, (int, float)):
        same = left == right or (math.isnan(left) and math.isnan(right))
        return (
            None if same or abs(left - right) <= tolerance.of(path) else Difference(shown, None, left, right)
        )
    same = type(left) is type(right) and left == right
    return None if same else Difference(shown, None, left, right)


def _compare_items(items: Any, shown: str, path: str, tolerance: Tolerance) -> Difference | None:
    for name, ours, theirs in items:
        below = f"{shown}.{name}" if shown else str(name)
        plain = f"{path}.{name}" if path else str(name)
        if found := _compare(ours, theirs, below, plain, tolerance):
            return found
    return None


def _compare_arrays(left: np.ndarray, right: np.ndarray, shown: str, tolerance: float) -> Difference | None:
    if left.dtype != right.dtype:
        return Difference(f"dtype of {shown}", None, left.dtype.str, right.dtype.str)
    if left.shape != right.shape:
        return Difference(f"shape of {shown}", None, left.shape, right.shape)
    same = left == right
    if left.dtype.kind == "f":
        same |= np.isnan(left) & np.isnan(right)
        if tolerance:
            with np.errstate(invalid="ignore"):
                same |= np.abs(left.astype(np.float64) - right) <= tolerance
    if same.all():
        return None
    index = tuple(int(i) for i in np.argwhere(~same)[0])
    return Difference(shown, index, left[index].item(), right[index].item())


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array {value.shape}"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
