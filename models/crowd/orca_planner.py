"""Plans by simulation: everybody takes the shortest way to the goal and avoids the others by ORCA."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .convex_obstacles import ConvexObstacles
from .navigation import Navigator
from .orca import OrcaParams, rollout, smooth_heading
from .planning import PLAN_DT, PLAN_STEPS, Array, Crowd, Futures
from .routes import Routes

TIME_HORIZON = 2.5
"""Time for which velocities are kept free of collisions with people [s]."""
OBSTACLE_HORIZON = 1.0
"""The same for obstacles [s]."""
HURRY = 1.3
"""Fastest speed over the preferred one, to make way or to catch up."""
GROUP_REACH = 1.0
"""Distance from the middle of the group at which a member begins to be drawn to it [m]."""


@dataclass(frozen=True)
class Place:
    """Where people walk: what is free, what is pleasant, what stands in the way."""

    blocked: NDArray[np.bool_]
    """(H, W) cells where nobody can stand; row index grows with y."""
    cost: Array
    """(H, W) cost of a metre, at least 1."""
    resolution: float
    """Edge of a cell [m]."""
    origin: tuple[float, float]
    """World x, y of the outer corner of cell [0, 0] [m]."""
    obstacles: Sequence[Array]
    """Outlines (K, 2), world [m]."""


class OrcaPlanner:
    """See the module; one sample a pedestrian."""

    def __init__(self, place: Place, clearance: float = 0.3) -> None:
        self._obstacles = ConvexObstacles.from_polygons([place.obstacles])
        self._routes = Routes(Navigator(place.blocked, place.resolution, place.origin, clearance, place.cost))

    def plan(self, crowd: Crowd) -> Futures:
        """Let the crowd walk for five seconds."""
        if not len(crowd):
            empty = np.zeros((0, 1, PLAN_STEPS))
            return Futures(np.zeros((0, 1, PLAN_STEPS, 2)), empty, empty, np.zeros(0, int))
        params = OrcaParams(
            radius=crowd.radius[None],
            max_speed=HURRY * np.maximum(crowd.speed, 0.3)[None],
            neighbor_dist=6.0,
            max_neighbors=10,
            time_horizon=TIME_HORIZON,
            time_horizon_obst=OBSTACLE_HORIZON,
        )

        follow = self._routes.follow(crowd.position, crowd.goal)

        def preferred(step: int, position: Array, velocity: Array) -> Array:
            return _with_groups(follow(position[0], crowd.speed), position[0], crowd.group)[None]

        run = rollout(
            crowd.position[None],
            crowd.velocity[None],
            preferred,
            PLAN_STEPS,
            PLAN_DT,
            params,
            self._obstacles,
        )
        facing = 0.01 * np.stack([np.cos(crowd.heading), np.sin(crowd.heading)], axis=-1)
        velocity = np.concatenate([facing[:, None], run.velocity[0]], axis=1)
        return Futures(
            positions=run.position[0][:, None],
            headings=smooth_heading(velocity, PLAN_DT)[:, None, 1:],
            speeds=np.linalg.norm(run.velocity[0], axis=-1)[:, None],
            chosen=np.zeros(len(crowd), dtype=int),
        )


def _with_groups(wanted: Array, position: Array, group: NDArray[np.int_]) -> Array:
    """Wanted velocities (N, 2), with those who walk together kept together."""
    for number in np.unique(group[group >= 0]):
        members = np.flatnonzero(group == number)
        if len(members) > 1:
            wanted[members] = _together(wanted[members], position[members])
    return wanted


def _together(wanted: Array, position: Array) -> Array:
    """Wanted velocities of a group's members: who is ahead waits, who is far from the others comes nearer."""
    arm = position.mean(axis=0) - position  # (K, 2)
    speed = np.linalg.norm(wanted, axis=1, keepdims=True)
    ahead = -np.sum(arm * wanted, axis=1, keepdims=True) / np.maximum(speed, 1e-6)
    pace = np.clip(1.0 - 0.4 * ahead, 0.4, 1.2)
    distance = np.linalg.norm(arm, axis=1, keepdims=True)
    pull = np.where(speed > 0.1, 0.5 * np.maximum(distance - GROUP_REACH, 0.0), 0.0)
    return pace * wanted + np.minimum(pull, 0.5) * arm / np.maximum(distance, 1e-6)
