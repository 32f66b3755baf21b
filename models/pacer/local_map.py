"""Heights and movement around people, seen from above: what PACER's walker sees of the world (sec 3.2).

People are painted as moving boxes, so that to a walker they are obstacles with a velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..gait.footholds import HeightAt
from .mathops import to_heading

Array = NDArray[np.float64]

PERSON = (0.5, 1.0, 1.7)
"""m: depth, width and height of the box a person is painted as (PACER, app. B)."""
_FARTHEST = 3.0  # m: heights are clipped to this


@dataclass(frozen=True)
class MapSettings:
    """A square grid in the heading frame."""

    cells: int = 64
    """Along each side."""
    side: float = 4.0
    """m."""
    ahead: float = 0.0
    """m by which the grid's middle lies before the person."""

    def points(self) -> Array:
        """Cell middles (cells, cells, 2), m, in the heading frame; rows go forward, columns to the left."""
        line = (np.arange(self.cells) + 0.5) / self.cells * self.side - 0.5 * self.side
        return np.stack(np.meshgrid(line + self.ahead, line, indexing="ij"), -1)


COMPACT_MAP = MapSettings(cells=10, side=2.0, ahead=0.6)
"""A coarse view of the next step or two, for small networks."""


def draw_local_maps(
    positions: Array,
    ways: Array,
    velocities: Array,
    height_at: HeightAt,
    settings: MapSettings | None = None,
    groups: NDArray[np.intp] | None = None,
) -> NDArray[np.float32]:
    """Maps (N, cells, cells, 3): height below the person's feet, and velocity against the person's, x and y.

    The first channel is the ground under the person (mean of nine places) minus the cell, m, as PACER has it;
    ground that does not move has minus the person's own velocity. In the heading frame, m/s.

    Args:
        positions: (N, 2) m, world.
        ways: (N, 2) unit vectors: where people head.
        velocities: (N, 2) m/s, world.
        height_at: ground height (m,), m, at points (m, 2).
        settings: the grid; PACER's when left out.
        groups: (N,) people see those of their own group only; everybody sees everybody when left out.
    """
    settings = settings or MapSettings()
    count = len(positions)
    grid = settings.points().reshape(-1, 2)
    across = np.stack([-ways[:, 1], ways[:, 0]], -1)
    cells = positions[:, None] + grid[:, :1] * ways[:, None] + grid[:, 1:] * across[:, None]  # (N, M, 2)
    ground = height_at(cells.reshape(-1, 2)).reshape(count, -1)
    around = 0.1 * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), -1).reshape(-1, 2)
    feet = height_at((positions[:, None] + around).reshape(-1, 2)).reshape(count, -1).mean(1)
    out = np.empty((count, len(grid), 3), dtype=np.float32)
    out[..., 1:] = -to_heading(ways, velocities)[:, None]
    seer, other = _neighbours(positions + settings.ahead * ways, positions, settings, groups)
    if len(seer):
        axes = np.stack([ways, across], 1)
        pair, cell = _painted(grid, positions[seer] - positions[other], axes[seer], ways[other])
        seer, other = seer[pair], other[pair]
        ground[seer, cell] = height_at(positions[other]) + PERSON[2]
        out[seer, cell, 1:] = to_heading(ways[seer], velocities[other] - velocities[seer])
    out[..., 0] = np.clip(feet[:, None] - ground, -_FARTHEST, _FARTHEST)
    return out.reshape(count, settings.cells, settings.cells, 3)


def _painted(grid: Array, gap: Array, axes: Array, ways: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which pairs (k,), and which of the first's cells (k,), have the second of the pair on them.

    Args:
        grid: (M, 2) m: cells in the heading frame.
        gap: (P, 2) m, world: from the second to the first.
        axes: (P, 2, 2) the first's frame: unit vectors ahead and to the left.
        ways: (P, 2) where the second ones head.
    """
    turn = to_heading(ways, axes).swapaxes(1, 2)
    cells = to_heading(ways, gap)[..., None] + turn @ grid.T  # (P, 2, M), seen by the second
    inside = np.abs(cells) < 0.5 * np.array(PERSON[:2])[:, None]
    pair, cell = np.nonzero(inside[:, 0] & inside[:, 1])
    return pair, cell


def _neighbours(
    middles: Array, positions: Array, settings: MapSettings, groups: NDArray[np.intp] | None
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of people of whom the second may be on the first one's map, with its middle (N, 2) there."""
    reach = np.hypot(settings.side, settings.side) / 2 + np.hypot(*PERSON[:2]) / 2
    everybody = np.arange(len(positions))
    groups = np.zeros_like(everybody) if groups is None else groups
    seer, other = np.nonzero((groups[:, None] == groups) & (everybody[:, None] != everybody))
    gap = middles[seer] - positions[other]
    near = np.hypot(gap[:, 0], gap[:, 1]) < reach
    return seer[near], other[near]
