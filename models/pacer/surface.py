"""What stands on the ground, as a walker sees it from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..gait.footholds import HeightAt
from ..scene import Obstacle
from ..scene.layers import rasterize

_CELL = 0.1  # m
_ROOM = 0.2  # m around all obstacles


def seen_heights(height_at: HeightAt, obstacles: Sequence[Obstacle]) -> HeightAt:
    """Heights (m,), m, at points (m, 2) with obstacles on them: to be seen, not to be stood on.

    Args:
        height_at: of the ground; level ground when it is `flat_ground`.
        obstacles: upright prisms.
    """
    if not obstacles:
        return height_at
    corners = np.concatenate([np.asarray(o.polygon, dtype=float) for o in obstacles])
    low = corners.min(0) - _ROOM
    cells = np.ceil((corners.max(0) + _ROOM - low) / _CELL).astype(int)
    tops = np.full((cells[1], cells[0]), -np.inf)
    for obstacle in obstacles:
        outline = np.asarray(obstacle.polygon, dtype=float)
        top = float(np.mean(height_at(outline))) + obstacle.height
        inside = rasterize([outline], tops.shape, _CELL, (float(low[0]), float(low[1])))
        tops[inside] = np.maximum(tops[inside], top)

    def seen(points: np.ndarray) -> np.ndarray:
        x, y = np.floor((points - low) / _CELL).astype(int).T
        here = (x >= 0) & (y >= 0) & (x < cells[0]) & (y < cells[1])
        over = np.full(len(points), -np.inf)
        over[here] = tops[y[here], x[here]]
        return np.maximum(height_at(points), over)

    return seen
