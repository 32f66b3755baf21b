"""Ground heights on a grid."""

from dataclasses import dataclass

import numpy as np

from .file import Point


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground heights on a regular grid of points, bilinear between them.

    Attributes:
        heights: (H, W) float32, metres; row index grows with y, column index with x.
        resolution: Distance of neighbouring points, metres.
        origin: World x, y of the point heights[0, 0], metres.
    """

    heights: np.ndarray
    resolution: float
    origin: Point

    def height_at(self, xy: np.ndarray) -> np.ndarray:
        """Ground height (...,) in metres at world points (..., 2); outside the grid as at its edge."""
        rows, cols = self.heights.shape
        cell = (np.asarray(xy, dtype=np.float64) - self.origin) / self.resolution
        x, y = np.clip(cell[..., 0], 0, cols - 1), np.clip(cell[..., 1], 0, rows - 1)
        j = np.minimum(x.astype(int), max(cols - 2, 0))
        i = np.minimum(y.astype(int), max(rows - 2, 0))
        u, v = x - j, y - i
        right, above = np.minimum(j + 1, cols - 1), np.minimum(i + 1, rows - 1)
        h = self.heights
        low = h[i, j] * (1 - u) + h[i, right] * u
        high = h[above, j] * (1 - u) + h[above, right] * u
        return low * (1 - v) + high * v
