"""Optimal reciprocal collision avoidance (ORCA) for a batch of crowds.

van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (2011). Every agent picks the
velocity nearest to the one it prefers inside half-planes, one a neighbour (each of a pair takes half of the
change, section 4.2) and one a static obstacle (the agent takes all of it, section 5.4). When neighbours leave
no such velocity, the least violation of their half-planes is taken and obstacles stay hard (section 5.3).

A last step makes the result safe: agents that would touch within `dt` share the free gap between them, and no
agent steps farther towards an obstacle than its free gap. Standing still always satisfies this, so discs that
are apart before a step are apart during and after it, up to rounding, in any density and for any `dt`, as
long as every agent moves with the velocity returned. Discs that overlap at the start never sink deeper and
are pushed apart.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from .convex_obstacles import ConvexObstacles
from .half_plane_lp import Array, closest_point, dot, least_violation, perpendicular
from .orca_constraints import AgentArrays, Neighbors, ObstaclePieces

RIGHT_TURN = 0.05  # rad by which obstructed agents aim to the right, so that exact symmetry cannot hold them
SLACK = 0.5  # m/s between preferred velocity and constraint at which that turn begins
SAFETY_ROUNDS = 8  # rounds that add only pairs about to touch, before all near pairs are added

PreferredVelocity = Callable[[int, Array, Array], Array]


class OrcaError(ValueError):
    """A crowd state, parameter or time step has the wrong shape or range."""


@dataclass(frozen=True)
class OrcaParams:
    """Agent parameters; each is a number or an array that broadcasts to (B, N)."""

    radius: float | Array = 0.4
    """Disc radius, m (0.8 m diameter: Rempe et al. 2023, supplement, ORCA dataset)."""
    max_speed: float | Array = 2.0
    """Bound on the speed, m/s."""
    neighbor_dist: float | Array = 15.0
    """Centre distance up to which other agents count, m."""
    max_neighbors: int | NDArray[np.int_] = 10
    """Number of nearest agents that count."""
    time_horizon: float | Array = 3.0
    """Time for which the velocity is free of collisions with agents, s."""
    time_horizon_obst: float | Array = 3.0
    """The same for obstacles, s."""

    def broadcast(self, shape: tuple[int, int]) -> AgentArrays:
        """Return every parameter as an array of `shape` (B, N).

        Raises:
            OrcaError: a parameter does not broadcast or is out of range.
        """
        values = {}
        for field in fields(self):
            value = np.asarray(getattr(self, field.name), dtype=np.float64)
            if value.size and not 0 <= value.min() <= value.max() < np.inf:
                raise OrcaError(f"{field.name} must be finite and not negative")
            if field.name.startswith(("radius", "time")) and not value.all():
                raise OrcaError(f"{field.name} must be above zero")
            try:
                values[field.name] = np.broadcast_to(value, shape)
            except ValueError:
                raise OrcaError(
                    f"{field.name} has shape {value.shape}; it must broadcast to {shape}"
                ) from None
        return AgentArrays(**values)


@dataclass(frozen=True)
class Rollout:
    """States after each of H steps: `position`, `velocity` (B, N, H, 2), unwrapped `heading` (B, N, H)."""

    position: Array
    velocity: Array
    heading: Array


def orca_velocity(
    position: Array,
    velocity: Array,
    preferred: Array,
    dt: float,
    params: OrcaParams,
    obstacles: ConvexObstacles | None = None,
    present: NDArray[np.bool_] | None = None,
) -> Array:
    """Choose the next velocity of every agent.

    Args:
        position: (B, N, 2) centres, world frame, m.
        velocity: (B, N, 2) current velocity, m/s.
        preferred: (B, N, 2) wanted velocity, m/s.
        dt: time for which the result is held, s.
        params: agent parameters.
        obstacles: static obstacles of the B scenes.
        present: (B, N) agents that exist; others get zero velocity and are ignored. Their state may be NaN.

    Returns:
        (B, N, 2) velocity, m/s.

    Raises:
        OrcaError: shapes disagree, a present agent's state is not finite, or `dt` is not above zero.
    """
    if (
        position.ndim != 3
        or position.shape[2] != 2
        or not position.shape == velocity.shape == preferred.shape
    ):
        raise OrcaError(
            f"position, velocity and preferred must all be (B, N, 2), not {position.shape}, {velocity.shape} "
            f"and {preferred.shape}"
        )
    shape = position.shape[:2]
    if present is None:
        present = np.ones(shape, bool)
    if present.shape != shape:
        raise OrcaError(f"present has shape {present.shape}; {shape} is needed")
    if obstacles is not None and len(obstacles.valid) != shape[0]:
        raise OrcaError(f"obstacles describe {len(obstacles.valid)} scenes; the agents live in {shape[0]}")
    if not (np.isfinite(dt) and dt > 0):
        raise OrcaError(f"dt is {dt}; a time step above zero is needed")
    agents = params.broadcast(shape)
    here = present[..., None]
    position, velocity, preferred = (
        np.where(here, np.asarray(a, dtype=np.float64), 0.0) for a in (position, velocity, preferred)
    )
    if not all(np.isfinite(a).all() for a in (position, velocity, preferred)):
        raise OrcaError("position, velocity or preferred of a present agent is not finite")
    if position.size == 0:
        return np.zeros_like(position)

    neighbors = Neighbors.find(position, velocity, agents, present, dt)
    pieces = ObstaclePieces.find(position, velocity, agents, present, dt, obstacles)
    max_speed = agents.max_speed.reshape(-1)
    normal = np.concatenate((pieces.normal, neighbors.normal), axis=1)
    offset = np.concatenate((pieces.offset, neighbors.offset), axis=1)
    target = _turned(preferred.reshape(-1, 2), neighbors.normal, neighbors.offset)
    chosen, failed = closest_point(normal, offset, max_speed, target)
    hard = pieces.offset.shape[1]
    stuck = np.flatnonzero(failed < hard)
    if (
        stuck.size
    ):  # obstacles alone leave nothing: their half-planes around standing still always do (section 5.4)
        normal[stuck, :hard], offset[stuck, :hard] = (
            pieces.normal_at_rest[stuck],
            pieces.offset_at_rest[stuck],
        )
        chosen[stuck], failed[stuck] = closest_point(
            normal[stuck], offset[stuck], max_speed[stuck], target[stuck]
        )
    crowded = np.flatnonzero(failed < offset.shape[1])
    if crowded.size:
        chosen[crowded] = least_violation(
            normal[crowded], offset[crowded], hard, max_speed[crowded], chosen[crowded], failed[crowded]
        )
    return _safe(chosen, neighbors, pieces, max_speed, dt).reshape(position.shape) * here


def rollout(
    position: Array,
    velocity: Array,
    preferred: PreferredVelocity,
    steps: int,
    dt: float,
    params: OrcaParams,
    obstacles: ConvexObstacles | None = None,
    present: NDArray[np.bool_] | None = None,
) -> Rollout:
    """Simulate `steps` steps with `preferred(step, position, velocity)` as wanted velocity (B, N, 2).

    Raises:
        OrcaError: see `orca_velocity`.
    """
    position, velocity = np.array(position, dtype=np.float64), np.array(velocity, dtype=np.float64)
    positions = np.empty((*position.shape[:2], steps, 2))
    velocities = np.empty_like(positions)
    for step in range(steps):
        velocity = orca_velocity(
            position, velocity, preferred(step, position, velocity), dt, params, obstacles, present
        )
        position = position + dt * velocity
        positions[:, :, step], velocities[:, :, step] = position, velocity
    return Rollout(positions, velocities, smooth_heading(velocities, dt))


def smooth_heading(velocity: Array, dt: float, time_constant: float = 0.2, full_speed: float = 0.5) -> Array:
    """Heading that follows the direction of travel with a first-order lag and holds while the agent stands.

    Args:
        velocity: (..., H, 2) m/s.
        dt: time between samples, s.
        time_constant: lag at full speed, s.
        full_speed: speed from which the direction counts fully, m/s; below, the lag grows as 1 / speed.

    Returns:
        (..., H) heading in rad, counter-clockwise from x, without jumps of 2 pi.
    """
    speed = np.sqrt(dot(velocity, velocity))
    direction = np.arctan2(velocity[..., 1], velocity[..., 0])
    weight = 1.0 - np.exp(-dt / time_constant * np.minimum(speed / full_speed, 1.0))
    moving = speed > 1e-3
    first = np.take_along_axis(direction, moving.argmax(axis=-1)[..., None], axis=-1)[..., 0]
    heading = np.empty_like(direction)
    angle = np.where(moving.any(axis=-1), first, 0.0)
    for step in range(direction.shape[-1]):
        error = np.remainder(direction[..., step] - angle + np.pi, 2 * np.pi) - np.pi
        angle = angle + np.where(moving[..., step], weight[..., step] * error, 0.0)
        heading[..., step] = angle
    return heading


def _turned(preferred: Array, normal: Array, offset: Array) -> Array:
    """Turn preferred velocities (M, 2) right by up to `RIGHT_TURN` where neighbours leave little `SLACK`."""
    if not offset.shape[1]:
        return preferred
    slack = (dot(normal, preferred[:, None]) - offset).min(axis=1)
    angle = RIGHT_TURN * np.clip(1.0 - slack / SLACK, 0.0, 1.0)[:, None]
    return np.cos(angle) * preferred - np.sin(angle) * perpendicular(preferred)


def _safe(chosen: Array, neighbors: Neighbors, pieces: ObstaclePieces, max_speed: Array, dt: float) -> Array:
    """Return the velocities (M, 2) nearest to `chosen` with which nothing meets within `dt`.

    Pairs are constrained only once they would touch, because a shared gap also slows agents that move along.
    """
    free = np.maximum(neighbors.distance - neighbors.reach, 0.0)
    allowed = np.maximum(np.minimum(neighbors.distance, neighbors.reach) - 1e-9, 0.0)
    touching = np.zeros_like(neighbors.near)
    normal = np.concatenate((pieces.normal_at_rest, neighbors.away), axis=1)
    velocity = chosen
    for round_ in range(SAFETY_ROUNDS + 1):
        shared = np.where(touching, -free / (2 * dt), -np.inf)
        offset = np.concatenate((pieces.offset_step, shared), axis=1)
        velocity, failed = closest_point(normal, offset, max_speed, chosen)
        velocity[failed < offset.shape[1]] = 0.0  # wedged to within rounding
        relative = velocity[neighbors.other] - velocity[:, None]
        square = dot(relative, relative)
        time = np.clip(-dot(neighbors.towards, relative) / np.maximum(square, 1e-12), 0.0, dt)
        closest = neighbors.towards + time[..., None] * relative
        meets = neighbors.near & ~touching & (dot(closest, closest) < allowed**2)
        if not meets.any():
            break
        touching |= meets if round_ < SAFETY_ROUNDS - 1 else neighbors.near
    return velocity
