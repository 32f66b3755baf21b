"""How a sole lies on the ground: level, along a slope, or shifted so as to stand on one tread of a stair."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .state import State

Array = NDArray[np.float64]
HeightAt = Callable[[Array], Array]
"""Ground height (m,) in m at world points (m, 2)."""

HALF_WIDTH = 0.045
"""m: of the sole."""
_GAP = 0.03  # m between the points at which the ground is felt across a sole: a third of its width
_ASIDE = _GAP * np.arange(-1, 4)  # m outwards: footholds tried where an edge runs along the sole
_ACROSS = np.arange(_ASIDE[0] - HALF_WIDTH, _ASIDE[-1] + HALF_WIDTH + 0.01, _GAP)  # m: what they cover
_ALONG = np.array([0.1, 0.5, 0.9])  # shares of the sole's length at which its width is felt
_SHIFTS = np.linspace(-1.0, 1.0, 7)  # footholds tried on broken ground: shares of the feet's reach
_SOLE = np.linspace(0.0, 1.0, 5)  # shares of the sole's length at which the ground is felt
_ROUGH = 0.015  # m: bump under the sole that counts as broken ground
STEEPEST = 0.9
"""Rise over run of a ground the foot lies on; steeper is an edge."""


def settle(s: State, feet: tuple[NDArray[np.intp], ...], height_at: HeightAt) -> Array:
    """Lay the soles of k feet on the ground under their goals.

    Args:
        s: walkers; the feet's ``shift`` is set.
        feet: (rows, sides), each (k,), of the feet in ``s``.
        height_at: the ground.

    Returns:
        Places (k, 6), x y z yaw pitch roll.
    """
    heel, tip, goal = s["heel"][feet][:, 0], s["tip"][feet][:, 0], s["goal"][feet].copy()
    offset = s["offset"][feet[0]]
    goal[:, :2] += offset
    goal[:, :2] += _step_aside(s, feet, goal, heel, tip, height_at)
    height = _ground_under(goal, heel, tip, np.zeros(len(heel)), height_at)
    slope, rough = _line_fit(height, heel, tip)
    shift = np.zeros(len(heel))
    reach = s["reach"][feet[0]]
    broken = np.flatnonzero((rough > _ROUGH) & (reach > 0.0))
    if broken.size:
        before = s["shift"][feet][broken]
        tried = _SHIFTS[:, None] * reach[broken]  # (c, b)
        toe, back = np.tile(tip[broken], len(_SHIFTS)), np.tile(heel[broken], len(_SHIFTS))
        under = _ground_under(np.tile(goal[broken], (len(_SHIFTS), 1)), back, toe, tried.ravel(), height_at)
        steep, bumps = _line_fit(under, back, toe)
        bumps = bumps.reshape(tried.shape)
        cost = 3.0 * np.maximum(bumps - _ROUGH, 0.0) + 0.3 * np.abs(tried) + 0.3 * np.abs(tried - before)
        best, column = cost.argmin(0), np.arange(broken.size)
        shift[broken], rough[broken] = tried[best, column], bumps[best, column]
        height[broken] = under.reshape(*tried.shape, -1)[best, column]
        slope[broken] = steep.reshape(tried.shape)[best, column]
    s["shift"][feet] = shift

    edge = rough > _ROUGH  # an edge is under the sole after all: stand level on its top
    slope = np.where(edge, 0.0, slope)
    z = np.where(edge, height.max(-1), height[:, 0] - slope * heel)
    cos, sin = np.cos(goal[:, 2]), np.sin(goal[:, 2])
    middle = shift + 0.5 * (heel + tip)
    side = np.array([-0.04, 0.04])
    x, y = goal[:, 0] + cos * middle, goal[:, 1] + sin * middle
    xy = np.stack([x[:, None] - sin[:, None] * side, y[:, None] + cos[:, None] * side], -1)
    sides = height_at(xy.reshape(-1, 2)).reshape(-1, 2)
    tilt = (sides[:, 1] - sides[:, 0]) / 0.08
    tilt = np.where(edge | (np.abs(tilt) > 0.5), 0.0, tilt)
    x, y = goal[:, 0] + cos * shift - offset[:, 0], goal[:, 1] + sin * shift - offset[:, 1]
    return np.stack([x, y, z, goal[:, 2], -np.arctan(slope), np.arctan(tilt)], axis=-1)


def _step_aside(
    s: State, feet: tuple[NDArray[np.intp], ...], goal: Array, heel: Array, tip: Array, height_at: HeightAt
) -> Array:
    """Shifts (k, 2), m, world, of soles at goals (k, 3) that stood half on an edge beside them.

    A foot that hangs over an edge along its length rolls over; a few centimetres aside it does not.
    """
    out = 1.0 - 2.0 * feet[1]  # left is outwards for the left foot
    left = np.stack([-np.sin(goal[:, 2]), np.cos(goal[:, 2])], -1) * out[:, None]
    ahead = np.stack([np.cos(goal[:, 2]), np.sin(goal[:, 2])], -1)
    along = heel[:, None] + (tip - heel)[:, None] * _ALONG
    spots = goal[:, None, None, :2] + along[:, :, None, None] * ahead[:, None, None]
    spots = spots + _ACROSS[:, None] * left[:, None, None]  # (k, 3, 8, 2)
    rise = np.abs(np.diff(height_at(spots.reshape(-1, 2)).reshape(spots.shape[:-1]), axis=-1))
    edge = np.maximum(rise - STEEPEST * _GAP, 0.0)  # (k, 3, 7)
    under = edge[..., :-2] + edge[..., 1:-1] + edge[..., 2:]  # of each of the footholds tried (k, 3, 5)
    under = np.median(under, axis=1)  # an edge across the sole is none beside it
    before = s["aside"][feet]
    cost = 3.0 * under + 0.3 * np.abs(_ASIDE) + 0.3 * np.abs(_ASIDE - before[:, None])
    aside = np.where((under > 0.0).any(1), _ASIDE[cost.argmin(1)], 0.0)
    s["aside"][feet] = aside
    return np.asarray(aside[:, None] * left, dtype=np.float64)


def _ground_under(goal: Array, heel: Array, tip: Array, shift: Array, height_at: HeightAt) -> Array:
    """Ground height (k, 5) from heel to tip of soles at goals (k, 3) shifted forward by (k,)."""
    along = (heel + shift)[:, None] + (tip - heel)[:, None] * _SOLE
    x = goal[:, :1] + np.cos(goal[:, 2:]) * along
    y = goal[:, 1:2] + np.sin(goal[:, 2:]) * along
    return height_at(np.stack([x, y], -1).reshape(-1, 2)).reshape(along.shape)


def _line_fit(height: Array, heel: Array, tip: Array) -> tuple[Array, Array]:
    """Slope (k,) from heel to tip and how far (k,), m, the ground in between departs from it."""
    rise = height[:, -1] - height[:, 0]
    slope = rise / (tip - heel)
    rough = np.abs(height - height[:, :1] - rise[:, None] * _SOLE).max(-1)
    return slope, np.where(np.abs(slope) > STEEPEST, np.maximum(rough, 0.1), rough)


def step_up(start: Array, end: Array) -> Array:
    """Height (...) in m by which place ``end`` (..., 6) lies above the slope the feet stand on at both."""
    ahead = np.cos(end[..., 3]) * (end[..., 0] - start[..., 0]) + np.sin(end[..., 3]) * (
        end[..., 1] - start[..., 1]
    )
    return end[..., 2] - start[..., 2] + np.tan(0.5 * (start[..., 4] + end[..., 4])) * ahead
