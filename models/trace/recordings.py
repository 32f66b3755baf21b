"""Recorded pedestrians as crowds: tracks smoothed and resampled, recordings cut into short scenes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..scene.layers import signed_distance
from .crowd_file import SPLITS, CrowdFileError, Crowds
from .scene_map import polygon_distance

Floats = NDArray[np.floating]
Split = Literal["train", "val", "test"]

DT = 0.1  # s between frames
SECONDS = 20.0  # of a scene, as nuScenes cuts them
OVERLAP = 82  # frames that a scene shares with the next: 31 of history and 52 of future fit in one of them
MAX_GAP = 1.5  # s unseen; whoever comes back later is somebody else
MARGIN = 8.0  # m of map around the tracks: room for goals beside them
RESOLUTION = 0.2  # m
FAR = 20.0  # m; distances are clipped to it


@dataclass(frozen=True)
class Recording:
    """What a camera saw.

    Attributes:
        name: Of the recording.
        tracks: (T, 3) [t, x, y] of each person, s and m, ascending in time.
        intervals: Which seconds are used for what: (from, to, split).
        obstacles: Simple outlines (K, 2) [m], or None where the map is unknown.
        smoothing: See `smooth_track` [s^3].
    """

    name: str
    tracks: Sequence[Floats]
    intervals: Sequence[tuple[float, float, Split]]
    obstacles: Sequence[Floats] | None = None
    smoothing: float = 0.0


def smooth_track(track: Floats, smoothing: float = 0.0) -> Floats:
    """The cubic smoothing spline of a track (Reinsch 1967), at its own times and in between.

    It minimises the sum of squared distances to the samples [m^2] plus `smoothing` [s^3] times the integral
    of the squared acceleration; 0 interpolates. It turns with the track: no axis is special.

    Args:
        track: (T, 3) [t, x, y], s and m, ascending in time.
        smoothing: Chosen for a recording by leaving out samples (see `leave_one_out`).

    Returns:
        (N, 3) [t, x, y] at all whole multiples of 0.1 s from the first to the last sample.
    """
    times = np.arange(np.ceil(track[0, 0] / DT - 1e-6), np.floor(track[-1, 0] / DT + 1e-6) + 1) * DT
    if len(track) < 3:
        places = np.stack([np.interp(times, track[:, 0], track[:, axis]) for axis in (1, 2)], 1)
    else:
        fitted = smoother(track[:, 0], smoothing) @ track[:, 1:]
        inside = np.clip(times, track[0, 0], track[-1, 0])
        places = CubicSpline(track[:, 0], fitted, bc_type="natural")(inside)
    return np.column_stack([times, places])


def smoother(times: Floats, smoothing: float) -> Floats:
    """(T, T) matrix from samples at these times to the values of their smoothing spline.

    Green and Silverman 1994, sec. 2.1: (1 + smoothing Q R^-1 Q^T)^-1.
    """
    count, h = len(times), np.diff(times).astype(float)
    q, r = np.zeros((count, count - 2)), np.zeros((count - 2, count - 2))
    inner = np.arange(count - 2)
    q[inner, inner], q[inner + 2, inner] = 1 / h[:-1], 1 / h[1:]
    q[inner + 1, inner] = -1 / h[:-1] - 1 / h[1:]
    r[inner, inner] = (h[:-1] + h[1:]) / 3
    r[inner[1:], inner[:-1]] = r[inner[:-1], inner[1:]] = h[1:-1] / 6
    return np.linalg.inv(np.eye(count) + smoothing * q @ np.linalg.solve(r, q.T))


def leave_one_out(track: Floats, smoothing: float) -> Floats:
    """(T,) distance [m] from each sample to the spline through all others, r_i / (1 - H_ii)."""
    matrix = smoother(track[:, 0], max(smoothing, 1e-9))
    residual = track[:, 1:] - matrix @ track[:, 1:]
    return np.hypot(*(residual / (1 - np.diag(matrix))[:, None]).T)


def unbroken(track: Floats) -> list[Floats]:
    """The parts of a track (T, 3) between gaps, each with at least two samples."""
    parts = np.split(track, np.flatnonzero(np.diff(track[:, 0]) > MAX_GAP) + 1)
    return [part for part in parts if len(part) > 1]


def cut_scenes(recording: Recording) -> Iterator[tuple[float, Split, Floats]]:
    """Scenes of 20 s with everybody who is seen in them; windows of training occur in exactly one scene.

    Yields:
        Start [s], split, and positions (N, 201, 2) [m], NaN where somebody is not seen.
    """
    whole = [smooth_track(part, recording.smoothing) for t in recording.tracks for part in unbroken(t)]
    tracks = [track for track in whole if len(track) > 1]
    length = round(SECONDS / DT) + 1
    hop = length - OVERLAP
    for begin, end, split in recording.intervals:
        for first in range(round(begin / DT), max(round(end / DT) - OVERLAP, round(begin / DT) + 1), hop):
            last = min(first + length, round(end / DT))
            rows = []
            for track in tracks:
                frame = np.rint(track[:, 0] / DT).astype(int)
                seen = (frame >= first) & (frame < last)
                if seen.sum() > 1:
                    row = np.full((length, 2), np.nan, np.float32)
                    row[frame[seen] - first] = track[seen, 1:]
                    rows.append(row)
            if rows:
                yield first * DT, split, np.stack(rows)


def triangles(outlines: Sequence[Floats]) -> list[NDArray[np.float32]]:
    """Outlines (K, 2) as triangles (3, 2): a crowd file takes convex obstacles."""
    parts = [shapely.constrained_delaunay_triangles(shapely.Polygon(outline)) for outline in outlines]
    return [
        np.array(triangle.exterior.coords[:3], np.float32)
        for part in parts
        for triangle in shapely.get_parts(part)
        if isinstance(triangle, shapely.Polygon)
    ]


@dataclass(frozen=True)
class RecordedMaps:
    """The maps of R recordings on one grid.

    Attributes:
        distance: (R, H, W), or (R, C, H, W) with several layers, signed distance [m]; (R, 0, 0) without maps.
        origin: World x, y of the centre of cell (0, 0) [m].
        resolution: Cell size [m].
        outlines: Convex outlines (K, 2) of the obstacles of each recording [m].
        layers: Names of the C layers.
    """

    distance: NDArray[np.float16]
    origin: tuple[float, float]
    resolution: float
    outlines: Sequence[Sequence[Floats]]
    layers: tuple[str, ...] = ("obstacle",)


def obstacle_maps(recordings: Sequence[Recording]) -> RecordedMaps:
    """Distances to the outlines of the recordings, or no maps if they have none.

    Raises:
        CrowdFileError: When only some recordings have a map.
    """
    if len({r.obstacles is None for r in recordings}) > 1:
        raise CrowdFileError("recordings with a map and without one cannot share a file")
    places = np.concatenate([track[:, 1:] for r in recordings for track in r.tracks])
    low, high = places.min(0) - MARGIN, places.max(0) + MARGIN
    x, y = (np.arange(a, b + RESOLUTION, RESOLUTION) for a, b in zip(low, high, strict=True))
    origin, outlines = (float(x[0]), float(y[0])), [list(r.obstacles or []) for r in recordings]
    if recordings[0].obstacles is None:
        return RecordedMaps(np.zeros((len(recordings), 0, 0), np.float16), origin, RESOLUTION, outlines)
    cells = np.stack(np.meshgrid(x, y), -1)  # row index grows with y
    fields = [np.clip(signed_distance(shapes, cells), -FAR, FAR) for shapes in outlines]
    return RecordedMaps(
        np.stack(fields).astype(np.float16), origin, RESOLUTION, [triangles(shapes) for shapes in outlines]
    )


def pack_recordings(
    name: str, recordings: Sequence[Recording], radius: float, source: dict, maps: RecordedMaps | None = None
) -> Crowds:
    """One set of crowds of recordings.

    Args:
        name: Of the set.
        recordings: All in metres; each keeps its own frame.
        radius: Disc of a person [m].
        source: How the set was made; the recording and start [s] of each scene are added.
        maps: Of the recordings; their `obstacle_maps` by default.

    Raises:
        CrowdFileError: When there is nobody.
    """
    scenes = [(number, *scene) for number, r in enumerate(recordings) for scene in cut_scenes(r)]
    if not scenes:
        raise CrowdFileError(f"{name}: nobody is seen twice")
    maps = maps or obstacle_maps(recordings)
    most = max(len(scene[3]) for scene in scenes)
    positions = np.full((len(scenes), most, *scenes[0][3].shape[1:]), np.nan, np.float32)
    for row, scene in zip(positions, scenes, strict=True):
        row[: len(scene[3])] = scene[3]
    counts, corners = map(len, maps.outlines), max((len(p) for o in maps.outlines for p in o), default=0)
    outlines = np.full((len(recordings), max(counts), corners, 2), np.nan, np.float32)
    for row, shapes in zip(outlines, maps.outlines, strict=True):
        for padded, shape in zip(row, shapes, strict=False):
            padded[: len(shape)] = shape
    which = np.array([scene[0] for scene in scenes])
    starts = [[recordings[number].name, round(start, 1)] for number, start, _, _ in scenes]
    return Crowds(
        name=name,
        positions=positions,
        polygons=outlines[which],
        distance=maps.distance[which],
        origin=maps.origin,
        resolution=maps.resolution,
        split=np.array([SPLITS.index(scene[2]) for scene in scenes], np.uint8),
        dt=DT,
        radius=radius,
        source={**source, "starts": starts},
        layers=maps.layers,
    )


@dataclass(frozen=True)
class Census:
    """What a set of crowds holds, to be compared with what is known about it.

    Attributes:
        scenes: Number of scenes.
        people: Mean number of people in a scene.
        speed: Mean speed [m/s].
        acceleration: Mean absolute acceleration, second differences at 10 Hz [m/s^2].
        in_obstacles: Share of the time in which a disc overlaps an obstacle.
        in_people: Share of the time in which a disc overlaps another.
    """

    scenes: int
    people: float
    speed: float
    acceleration: float
    in_obstacles: float
    in_people: float


def census(crowds: Crowds, rows: NDArray[np.int_]) -> Census:
    """Count over the scenes `rows`."""
    speeds, accelerations, walls, people, heads = [], [], [], [], []
    for row in rows:
        positions = crowds.positions[row]
        seen = np.isfinite(positions[..., 0])
        heads.append(seen.any(1).sum())
        velocity = np.diff(positions, axis=1) / crowds.dt
        for values, kept in ((velocity, speeds), (np.diff(velocity, axis=1) / crowds.dt, accelerations)):
            size = np.linalg.norm(values, axis=-1)
            kept.append(size[np.isfinite(size)])
        if crowds.has_map:
            walls.append(polygon_distance(positions[seen], crowds.polygons_of(int(row))) < crowds.radius)
        for frame, present in zip(positions.transpose(1, 0, 2), seen.T, strict=True):
            apart = np.linalg.norm(frame[present, None] - frame[present], axis=-1)
            np.fill_diagonal(apart, np.inf)
            people.append((apart < 2 * crowds.radius).any(1))

    def mean(parts: list) -> float:
        return float(np.concatenate(parts).mean()) if parts else 0.0

    return Census(
        len(rows), float(np.mean(heads)), mean(speeds), mean(accelerations), mean(walls), mean(people)
    )
