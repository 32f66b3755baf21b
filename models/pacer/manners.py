"""Manners of a walker's follower: it goes round obstacles and gives way to others (ORCA)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..crowd.convex_obstacles import ConvexObstacles
from ..crowd.orca import OrcaParams, orca_velocity
from ..scene import Obstacle

Array = NDArray[np.float64]

_MARGIN = 0.18  # m around bodies: for swinging arms and feet, and for what a body lags behind its follower
_NEAR = 4.0  # m within which others count
_FORESIGHT, _FORESIGHT_OBSTACLES = 3.0, 2.0  # s
_STUCK = 0.5  # share of the wanted speed below which a way round is looked for
_ASIDE, _DETOUR = np.radians(80.0), 1.0  # turn, and m/s at most, on the way round
_HOLD = 0.2  # s for which a choice must be safe


class Manners:
    """What velocities people choose who would rather have others.

    Args:
        scenes: B scenes of as many people each, who know nothing of those of other scenes.
        obstacles: the same in every scene.
    """

    def __init__(self, scenes: int = 1, obstacles: Sequence[Obstacle] = ()):
        self._scenes = scenes
        outlines = [np.asarray(obstacle.polygon, dtype=float) for obstacle in obstacles]
        self._obstacles = ConvexObstacles.from_polygons([outlines] * scenes) if outlines else None

    def choose(
        self, wanted: Array, places: Array, velocities: Array, radii: Array, fastest: float, bend: Array
    ) -> Array:
        """Velocities (N, 2), m/s, nearest to the wanted ones that bump into nobody and nothing for a while.

        Who would have to stop goes aside instead, to the side they have begun to turn to.

        Args:
            wanted: (N, 2) m/s.
            places: (N, 2) m, world.
            velocities: (N, 2) m/s, now.
            radii: (N,) m of bodies.
            fastest: m/s.
            bend: (N,) turn to the left, of any unit, that manners have lately made of what was wanted.
        """
        if self._obstacles is None and len(places) == self._scenes:
            return wanted  # everybody is alone in the open
        shape = (self._scenes, -1)
        params = OrcaParams(
            radius=radii.reshape(shape) + _MARGIN,
            max_speed=fastest,
            neighbor_dist=_NEAR,
            max_neighbors=5,
            time_horizon=_FORESIGHT,
            time_horizon_obst=_FORESIGHT_OBSTACLES,
        )

        def safe(preferred: Array) -> Array:
            three = (*shape, 2)
            states = places.reshape(three), velocities.reshape(three), preferred.reshape(three)
            return orca_velocity(*states, _HOLD, params, self._obstacles).reshape(-1, 2)

        chosen = safe(wanted)
        pace = np.linalg.norm(wanted, axis=-1)
        stuck = (np.linalg.norm(chosen, axis=-1) < _STUCK * pace) & (pace > 0.3)
        if not stuck.any():
            return chosen
        to_left = wanted[:, 0] * chosen[:, 1] - wanted[:, 1] * chosen[:, 0] + pace * pace * bend
        angle = np.where(to_left > 0.0, _ASIDE, -_ASIDE)
        cos, sin = np.cos(angle), np.sin(angle)
        aside = np.stack(
            [cos * wanted[:, 0] - sin * wanted[:, 1], sin * wanted[:, 0] + cos * wanted[:, 1]], -1
        )
        aside *= (_DETOUR / np.maximum(pace, _DETOUR))[:, None]
        round_it = safe(np.where(stuck[:, None], aside, wanted))
        better = np.linalg.norm(round_it, axis=-1) > np.linalg.norm(chosen, axis=-1)
        return np.where((stuck & better)[:, None], round_it, chosen)
