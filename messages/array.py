"""Array fields of messages: what an ndarray in a message must look like."""

from dataclasses import dataclass

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

    def mismatch(self, array: np.ndarray, lengths: dict[str, int]) -> str | None:
        """Say what is wrong with `array`, or return None; `lengths` collects the named axes."""
        if array.dtype != np.dtype(self.dtype):
            return f"has dtype {array.dtype.str}, must be {np.dtype(self.dtype).str}"
        if array.ndim != len(self.shape):
            return f"has shape {array.shape}, must be {self.shape_text}"
        for length, wanted in zip(array.shape, self.shape, strict=True):
            expected = wanted if isinstance(wanted, int) else lengths.setdefault(wanted, length)
            if length != expected:
                where = (
                    "" if isinstance(wanted, int) else f" with {wanted} = {expected} as in the other fields"
                )
                return f"has shape {array.shape}, must be {self.shape_text}{where}"
        if not self.allow_nan and array.dtype.kind == "f" and not np.isfinite(array).all():
            return "holds NaN or infinity"
        return None

    @property
    def shape_text(self) -> str:
        """The shape as written in docs and errors: `(N, 24, 13)`."""
        return "(" + ", ".join(str(n) for n in self.shape) + ("," if len(self.shape) == 1 else "") + ")"


@dataclass(frozen=True)
class Volatile:
    """Marks a field that holds wall-clock facts: left out of log hashes and of regression."""


VOLATILE = Volatile()
