"""The place: what can be walked on, what stands in the way, how high the ground is."""

from typing import Annotated

import msgspec
import numpy as np

from .array import Array


class Obstacle(msgspec.Struct, frozen=True):
    """A solid prism standing on the ground."""

    name: str
    polygon: Annotated[np.ndarray, Array("f8", ("K", 2), "m", "world")]
    """Outline seen from above, counter-clockwise, not closed."""
    height: float = 2.0


class HeightField(msgspec.Struct, frozen=True):
    """Ground heights on a regular grid, bilinear between the points."""

    heights: Annotated[np.ndarray, Array("f4", ("H", "W"), "m", "world")]
    """Row index grows with y, column index with x."""
    resolution: float
    """Distance of neighbouring points [m]."""
    origin: tuple[float, float]
    """World x, y of point [0, 0] [m]."""


class SemanticMap(msgspec.Struct, frozen=True):
    """Named raster layers of the place with its obstacles and ground; latched."""

    name: str
    layers: list[str]
    """Name of each raster layer, e.g. `walkable`, `obstacle`, `road`, `crosswalk`."""
    raster: Annotated[np.ndarray, Array("u1", ("L", "H", "W"))]
    """1 where the layer covers the cell; row index grows with y, column index with x."""
    resolution: float
    """Edge of a cell [m]."""
    origin: tuple[float, float]
    """World x, y of the outer corner of cell [0, 0] [m]."""
    obstacles: list[Obstacle] = []
    terrain: HeightField | None = None
    """None where the ground is flat at z = 0."""
