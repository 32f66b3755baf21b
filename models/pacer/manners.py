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

    def choose(self, wanted: Array, places: Array, velocities: Array, radii: Array, fastest: float) -> Array:
        """Velocities (N, 2), m/s, nearest to the wanted ones that bump into nobody and nothing for a while.

        Args:
            wanted: (N, 2) m/s.
            places: (N, 2) m, world.
            velocities: (N, 2) m/s, now.
            radii: (N,) m of bodies.
            fastest: m/s.
        """
        shape = (self._scenes, -1)
        if self._obstacles is None and len(places) == self._scenes:
            return wanted  # everybody is alone in the open
        params = OrcaParams(
            radius=radii.reshape(shape) + _MARGIN,
            max_speed=fastest,
            neighbor_dist=_NEAR,
            max_neighbors=5,
            time_horizon=_FORESIGHT,
            time_horizon_obst=_FORESIGHT_OBSTACLES,
        )
        three = (*shape, 2)
        chosen = orca_velocity(
            places.reshape(three),
            velocities.reshape(three),
            wanted.reshape(three),
            _HOLD,
            params,
            self._obstacles,
        )
        return chosen.reshape(-1, 2)
