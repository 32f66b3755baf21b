"""Array fields of messages: what an ndarray in a message must look like."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

DTYPES = {np.dtype(code).str: np.dtype(code) for code in ("f4", "f8", "i2", "i4", "i8", "u1", "u2", "?")}
"""Element types that may cross a process border, by their numpy string; never `object`."""


@dataclass(frozen=True)
class Array:
    """The specification of an ndarray field: `Annotated[np.ndarray, Array("f4", ("N", 3), "m")]`.

    A letter in `shape` names a length: the same letter is the same length all over one struct.
    """

    dtype: str
    """numpy element type, e.g. `"f4"`; little endian on the wire."""
    shape: tuple[int | str, ...]
    """Length of each axis: a number, or a name shared by the fields of a struct."""
    unit: str = ""
    """SI unit of the elements; empty where they have none or differ by column."""
    frame: str = ""
    """Coordinate frame of the elements, e.g. `"world"`."""
    allow_nan: bool = False
    """Whether NaN and infinity may stand in the array."""

    @cached_property
    def numpy_dtype(self) -> np.dtype:
        """The element type as numpy knows it."""
        return np.dtype(self.dtype)

    def mismatch(self, array: np.ndarray, lengths: dict[str, int]) -> str | None:
        """Say what is wrong with `array`, or return None; `lengths` collects the named axes."""
        if array.dtype != self.numpy_dtype:
            return f"has dtype {array.dtype.str}, must be {self.numpy_dtype.str}"
        shape = array.shape
        if len(shape) != len(self.shape):
            return f"has shape {shape}, must be {self.shape_text}"
        where = ""
        for length, wanted in zip(shape, self.shape, strict=True):
            if wanted.__class__ is int:
                expected = wanted
            elif (expected := lengths.setdefault(wanted, length)) != length:  # type: ignore[arg-type]
                where = f" with {wanted} = {expected} as in the other fields"
            if expected != length:
                return f"has shape {shape}, must be {self.shape_text}{where}"
        if not self.allow_nan and self.numpy_dtype.kind == "f" and not finite(array):
            return "holds NaN or infinity"
        return None

    @property
    def shape_text(self) -> str:
        """The shape as written in docs and errors: `(N, 24, 13)`."""
        return "(" + ", ".join(str(n) for n in self.shape) + ("," if len(self.shape) == 1 else "") + ")"


def finite(array: np.ndarray) -> bool:
    """Whether no element of a float array is NaN or infinite."""
    # The sum of squares takes a ninth of the time, and at worst overflows.
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


@dataclass(frozen=True)
class Volatile:
    """Marks a field that holds wall-clock facts: left out of log hashes and of regression."""


VOLATILE = Volatile()


WRITABLE = object()
"""Stands for what holds the memory of an array that somebody can write to."""


def owner_of(array: np.ndarray) -> object:
    """What holds the memory of an array nobody can write to through NumPy: None for itself; else `WRITABLE`."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return WRITABLE
        owner = owner.base
    return owner
