"""Procedural paths: random speeds and turns (PACER, app. B.3), looked up for many people at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

HORIZON, SPACING = 10, 0.5
"""Waypoints ahead that a walker is told, and the s between them (PACER, app. B.1)."""


@dataclass(frozen=True)
class PathSettings:
    """How paths wander; defaults are PACER's."""

    duration: float = 10.0
    """s."""
    vertices: int = 101
    turn_rate: float = 2.0
    """rad/s: bound of the turning between vertices."""
    sharp_turn: float = 0.02
    """Probability of a turn by up to half a circle, per vertex."""
    acceleration: float = 2.0
    """m/s^2: bound of the change of speed."""
    speed_range: tuple[float, float] = (0.0, 3.0)
    """m/s."""

    def towards(self, other: PathSettings, share: float) -> PathSettings:
        """Settings that have gone `share` of the way to those of `other`, which has as many vertices."""

        def between(a: float, b: float) -> float:
            return a + share * (b - a)

        return PathSettings(
            self.duration,
            self.vertices,
            between(self.turn_rate, other.turn_rate),
            between(self.sharp_turn, other.sharp_turn),
            between(self.acceleration, other.acceleration),
            (
                between(self.speed_range[0], other.speed_range[0]),
                between(self.speed_range[1], other.speed_range[1]),
            ),
        )


class Paths:
    """N paths of positions over time, each a polyline with vertices at equal times.

    Args:
        vertices: (N, V, 2) m, world.
        duration: s from the first vertex to the last.
    """

    def __init__(self, vertices: Array, duration: float):
        self.vertices = np.asarray(vertices, dtype=float)
        self.duration = duration

    def __len__(self) -> int:
        return len(self.vertices)

    @property
    def spacing(self) -> float:
        """Time between two vertices, s."""
        return self.duration / (self.vertices.shape[1] - 1)

    @property
    def first_speeds(self) -> Array:
        """Speeds (N,), m/s, along the first stretches."""
        return np.linalg.norm(self.vertices[:, 1] - self.vertices[:, 0], axis=1) / self.spacing

    def at(self, times: ArrayLike) -> Array:
        """Positions (N, ..., 2) m at times (N, ...) s; beyond the ends, those of the ends."""
        times = np.asarray(times, dtype=float)
        place = np.clip(times / self.spacing, 0.0, self.vertices.shape[1] - 1)
        before = np.minimum(place.astype(int), self.vertices.shape[1] - 2)
        rows = np.arange(len(self)).reshape(-1, *[1] * (times.ndim - 1))
        part = (place - before)[..., None]
        return (1 - part) * self.vertices[rows, before] + part * self.vertices[rows, before + 1]

    def waypoints(self, times: ArrayLike) -> Array:
        """The next `HORIZON` waypoints (N, 10, 2) m, world, `SPACING` apart, after times (N,) s."""
        ahead = SPACING * np.arange(1, HORIZON + 1)
        return self.at(np.asarray(times, dtype=float)[:, None] + ahead)

    def replace(self, ids: NDArray[np.intp], others: Paths) -> None:
        """Give people (n,) new paths."""
        self.vertices[ids] = others.vertices


def sample_paths(
    starts: ArrayLike,
    headings: ArrayLike,
    rng: np.random.Generator,
    settings: PathSettings | None = None,
    speeds: ArrayLike | None = None,
) -> Paths:
    """Draw paths.

    Args:
        starts: (N, 2) m, world.
        headings: (N,) rad, world: of the first stretch.
        rng: random numbers.
        settings: how they wander.
        speeds: (N,) m/s at the start; drawn from the range of speeds when left out.
    """
    s = settings or PathSettings()
    starts = np.asarray(starts, dtype=float)
    stretches = (len(starts), s.vertices - 1)
    dt = s.duration / (s.vertices - 1)
    turns = rng.uniform(-s.turn_rate * dt, s.turn_rate * dt, stretches)
    sharp = rng.random(stretches) < s.sharp_turn
    turns = np.where(sharp, rng.uniform(-np.pi, np.pi, stretches), turns)
    turns[:, 0] = 0.0
    way = np.asarray(headings, dtype=float)[:, None] + np.cumsum(turns, axis=1)
    low, high = s.speed_range
    speed = np.empty(stretches)
    speed[:, 0] = rng.uniform(low, high, len(starts)) if speeds is None else speeds
    changes = rng.uniform(-s.acceleration * dt, s.acceleration * dt, stretches)
    for k in range(1, stretches[1]):  # clipped at each vertex, so that no walk stays stuck at a bound
        speed[:, k] = np.clip(speed[:, k - 1] + changes[:, k], low, high)
    steps = (speed * dt)[..., None] * np.stack([np.cos(way), np.sin(way)], -1)
    origin = starts[:, None]
    return Paths(np.concatenate([origin, origin + np.cumsum(steps, axis=1)], axis=1), s.duration)


def with_stops(paths: Paths, begins: ArrayLike, ends: ArrayLike, ramp: float = 0.8) -> Paths:
    """The same ways, walked with a stop on each.

    Args:
        paths: N paths.
        begins: (N,) s: from when on the walk slows down; earlier than ``-ramp`` is at rest at first.
        ends: (N,) s: from when on it speeds up again; infinity never.
        ramp: s that both take.
    """
    times = np.linspace(0.0, paths.duration, paths.vertices.shape[1])
    middle = 0.5 * (times[1:] + times[:-1])
    slowing = (middle - np.asarray(begins, dtype=float)[:, None]) / ramp
    rising = (middle - np.asarray(ends, dtype=float)[:, None]) / ramp
    pace = 1.0 - np.clip(slowing, 0.0, 1.0) + np.clip(rising, 0.0, 1.0)
    walked = np.cumsum(np.clip(pace, 0.0, 1.0) * paths.spacing, axis=1)
    return Paths(paths.at(np.concatenate([np.zeros((len(paths), 1)), walked], axis=1)), paths.duration)
