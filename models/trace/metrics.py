"""Metrics of predicted crowds: collisions, realism and accuracy (Rempe et al. 2023, app. C.2, C.3, D.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .scene_map import polygon_distance

Array = NDArray[np.floating]

REALISM_STRIDE = 5  # statistics are taken at 2 Hz
BINS = 40
RANGES = {"speed": (0.0, 2.0), "longitudinal": (-1.0, 1.0), "lateral": (-1.0, 1.0)}


def obstacle_collisions(positions: Array, radius: float, polygons: Sequence[Array]) -> Array:
    """Share of the time in which each disc overlaps an obstacle.

    Args:
        positions: (A, T, 2) world [m].
        radius: Of every disc [m].
        polygons: Convex outlines, each (V, 2) [m].

    Returns:
        (A,) in 0 to 1.
    """
    distance = polygon_distance(positions.reshape(-1, 2).astype(np.float32), polygons)
    return (distance < radius).reshape(positions.shape[:2]).mean(1)


def agent_collisions(positions: Array, radius: float) -> Array:
    """(A,) whether each agent's disc ever overlaps another one; positions (A, T, 2) [m]."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)  # (A, A, T)
    apart[np.arange(len(positions)), np.arange(len(positions))] = np.inf
    return (apart < 2 * radius).any((1, 2))


def displacement_errors(positions: Array, truth: Array) -> tuple[Array, Array]:
    """ADE and FDE [m], (A, S) each, of positions (A, S, T, 2) against the true (A, T, 2)."""
    error = np.linalg.norm(positions - truth[:, None], axis=-1)
    return error.mean(-1), error[..., -1]


def waypoint_error(positions: Array, goal: Array) -> Array:
    """(A,) smallest distance [m] of trajectories (A, T, 2) to goals (A, 2)."""
    return np.linalg.norm(positions - goal[:, None], axis=-1).min(1)


def social_distance_error(positions: Array, group: Array, distance: float) -> Array:
    """(G,) mean |distance to the nearest group member - wanted| [m] over time, for each member of a group.

    Args:
        positions: (A, T, 2) [m].
        group: (A,) group numbers; negative walks alone.
        distance: Wanted [m].
    """
    mates = (group[:, None] == group) & (group[:, None] >= 0) & ~np.eye(len(group), dtype=bool)
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    nearest = np.where(mates[..., None], apart, np.inf).min(1)
    return np.abs(nearest[mates.any(1)] - distance).mean(1)


@dataclass(frozen=True)
class Motion:
    """Values at 2 Hz: speed [m/s], longitudinal and lateral acceleration [m/s^2]."""

    speed: Array
    longitudinal: Array
    lateral: Array


def motion(positions: Array, dt: float, compatible: bool = False) -> Motion:
    """Finite differences at 2 Hz of trajectories (..., T, 2) [m].

    Args:
        positions: World positions.
        dt: Time between them [s].
        compatible: Project the magnitude of the acceleration on the world axes, |a| cos(heading) and
            |a| sin(heading), as earlier tools did; otherwise project the acceleration on the direction of
            motion.
    """
    p = positions[..., ::REALISM_STRIDE, :]
    step = REALISM_STRIDE * dt
    velocity = np.diff(p, axis=-2) / step
    acceleration = np.diff(velocity, axis=-2) / step
    speed = np.linalg.norm(velocity, axis=-1)
    before = velocity[..., :-1, :]
    forward = before / np.maximum(np.linalg.norm(before, axis=-1, keepdims=True), 1e-6)
    if compatible:
        size = np.linalg.norm(acceleration, axis=-1)
        return Motion(speed.ravel(), (size * forward[..., 0]).ravel(), (size * forward[..., 1]).ravel())
    along = (acceleration * forward).sum(-1)
    across = forward[..., 0] * acceleration[..., 1] - forward[..., 1] * acceleration[..., 0]
    return Motion(speed.ravel(), along.ravel(), across.ravel())


def histogram_distance(a: Array, b: Array, bounds: tuple[float, float], bins: int = BINS) -> float:
    """Earth mover's distance between two normalised histograms, in the unit of the values.

    In one dimension it is the area between the cumulative histograms. Values beyond the bounds count in the
    outer bins.
    """
    edges = np.linspace(*bounds, bins + 1)
    shares = [np.histogram(np.clip(v, *bounds), edges)[0] / len(v) for v in (a, b)]
    return float(np.abs(np.cumsum(shares[0] - shares[1])).sum() * (edges[1] - edges[0]))


def realism(positions: Array, truth: Array, dt: float, compatible: bool = False) -> dict[str, float]:
    """Distances of the histograms of `motion` between generated and true trajectories, by statistic."""
    ours, theirs = (motion(p, dt, compatible) for p in (positions, truth))
    return {k: histogram_distance(getattr(ours, k), getattr(theirs, k), v) for k, v in RANGES.items()}


def mean_accelerations(positions: Array, dt: float) -> tuple[float, float]:
    """Mean absolute longitudinal and lateral acceleration [m/s^2] (app. C.3, "Realism (Mean)")."""
    ours = motion(positions, dt)
    return float(np.abs(ours.longitudinal).mean()), float(np.abs(ours.lateral).mean())
