"""The people of a scene: drawn from a seed without overlaps, or as they were recorded."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .file import SceneError
from .layers import cell_centers

if TYPE_CHECKING:
    from .scene import Scene

VELOCITY_WINDOW = 0.4  # s; the annotation step of the BIWI and UCY recordings
MOVING = 0.3  # m/s; slower counts as standing
SLOWEST = 0.2  # m/s; nobody is asked to walk slower than this


@dataclass(frozen=True, eq=False)
class Track:
    """One recorded pedestrian: `samples` (T, 3) are t in s and world x, y in m."""

    id: int
    samples: np.ndarray

    @property
    def enter_time(self) -> float:
        """First recorded time, s."""
        return float(self.samples[0, 0])

    @property
    def exit_time(self) -> float:
        """Last recorded time, s."""
        return float(self.samples[-1, 0])

    @property
    def enter_xy(self) -> np.ndarray:
        """First recorded place (2,), m."""
        return self.samples[0, 1:]

    @property
    def exit_xy(self) -> np.ndarray:
        """Last recorded place (2,), m."""
        return self.samples[-1, 1:]

    @property
    def enter_velocity(self) -> np.ndarray:
        """Mean velocity (2,) of the first 0.4 s, m/s."""
        last = np.searchsorted(self.samples[:, 0], self.enter_time + VELOCITY_WINDOW - 1e-6)
        last = min(max(int(last), 1), len(self.samples) - 1)
        step = self.samples[last] - self.samples[0]
        return step[1:] / step[0] if last else np.zeros(2)

    @property
    def walking_speed(self) -> float:
        """Mean speed while moving, m/s; at least 0.2."""
        step = np.diff(self.samples, axis=0)
        speed = np.hypot(step[:, 1], step[:, 2]) / step[:, 0]
        moving = speed[speed > MOVING]
        return max(float(moving.mean()) if len(moving) else 0.0, SLOWEST)


@dataclass(frozen=True, eq=False)
class RecordedPopulation:
    """Everybody of a recording, and the ids of those who walked together."""

    tracks: tuple[Track, ...]
    groups: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        known = {track.id for track in self.tracks}
        for track in self.tracks:
            if track.samples.ndim != 2 or track.samples.shape[1] != 3 or not len(track.samples):
                raise SceneError(f"track {track.id}: samples of shape {track.samples.shape}, not (T, 3)")
            if not np.isfinite(track.samples).all() or (np.diff(track.samples[:, 0]) <= 0).any():
                raise SceneError(f"track {track.id}: samples must be finite and their times must grow")
        for group in self.groups:
            if strangers := set(group) - known:
                raise SceneError(f"population.groups: {list(group)} names {min(strangers)}, who has no track")


@dataclass(frozen=True, eq=False)
class Entry:
    """One pedestrian entering the scene.

    Attributes:
        time: When, s.
        xy: Where (2,), world, m; never in an obstacle.
        velocity: World velocity at entry (2,), m/s.
        goal: Where to (2,), world, m.
        preferred_speed: m/s.
        body_seed: Seed of the body's shape.
        group: Number shared by those who walk together; None: alone.
        exit_time: When a recorded pedestrian left, s; None: on arrival.
        track: Recorded samples (T, 3) [t, x, y]; None for a drawn pedestrian.
        moved: Metres from the recorded entry point to `xy`; 0 unless it lay in an obstacle or off the map.
    """

    time: float
    xy: np.ndarray
    velocity: np.ndarray
    goal: np.ndarray
    preferred_speed: float
    body_seed: int
    group: int | None = None
    exit_time: float | None = None
    track: np.ndarray | None = None
    moved: float = 0.0


def body_seed(seed: int, index: int) -> int:
    """Seed of the shape of one pedestrian's body."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def recorded_entries(scene: "Scene", seed: int, count: int | None) -> list[Entry]:
    """The first `count` people of a recorded population; see `Scene.sample_population`."""
    population = scene.population
    assert isinstance(population, RecordedPopulation)
    tracks = sorted(population.tracks, key=lambda track: (track.enter_time, track.id))[:count]
    xy = np.array([track.enter_xy for track in tracks]).reshape(-1, 2)
    placed = _onto_free_ground(scene, xy)
    group_of = {member: index for index, group in enumerate(population.groups) for member in group}
    return [
        Entry(
            time=track.enter_time,
            xy=here,
            velocity=track.enter_velocity,
            goal=track.exit_xy,
            preferred_speed=track.walking_speed,
            body_seed=body_seed(seed, track.id),
            group=group_of.get(track.id),
            exit_time=track.exit_time,
            track=track.samples,
            moved=float(np.hypot(*(here - track.enter_xy))),
        )
        for track, here in zip(tracks, placed, strict=True)
    ]


def _onto_free_ground(scene: "Scene", xy: np.ndarray) -> np.ndarray:
    """Points (N, 2) moved to the nearest free cell's centre where they are in an obstacle or not walkable."""
    low_x, low_y = scene.origin
    rows, cols = scene.shape
    i = np.floor((xy[:, 1] - low_y) / scene.resolution).astype(int)
    j = np.floor((xy[:, 0] - low_x) / scene.resolution).astype(int)
    off = (i < 0) | (j < 0) | (i >= rows) | (j >= cols)
    off |= scene.layers["walkable"][np.clip(i, 0, rows - 1), np.clip(j, 0, cols - 1)] == 0
    off |= scene.obstacle_distance(xy) < 0
    if not off.any():
        return xy
    if scene.blocked().all():
        raise SceneError("layers.walkable: no cell is free, nobody can enter")
    x, y = cell_centers(scene.shape, scene.resolution, scene.origin)
    rows_free, cols_free = np.nonzero(~scene.blocked())
    free = np.stack([x[cols_free], y[rows_free]], axis=-1)
    placed = xy.copy()
    for index in np.nonzero(off)[0]:
        placed[index] = free[((free - xy[index]) ** 2).sum(-1).argmin()]
    return placed
