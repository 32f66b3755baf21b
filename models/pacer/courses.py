"""Random ground to walk on: slopes, rough ground, stairs, scattered blocks (PACER, app. B.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

from ..scene import Obstacle, Terrain

Heights = NDArray[np.float64]

SHARES: dict[str, float] = {
    "slope": 0.2,
    "rough_slope": 0.1,
    "stairs_up": 0.15,
    "stairs_down": 0.15,
    "discrete": 0.05,
    "flat": 0.1,
    "obstacles": 0.1,
}
"""Kind of ground: its share among tiles, relative to the others' (PACER's settings)."""


_BUMP = 0.5  # m between the tops of rough ground


class CourseError(ValueError):
    """Ground of an unknown kind or a course without a tile."""


@dataclass(frozen=True)
class CourseSettings:
    """Sizes of tiles, m; defaults are PACER's but for the number of tiles."""

    levels: int = 5
    """Rows of tiles, harder and harder."""
    columns: int = 10
    tile: float = 20.0
    border: float = 10.0
    """m of flat ground around the tiles."""
    cell: float = 0.1
    """m between two heights; a stair's riser is that deep, and leaves the less room to stand on its tread."""
    platform: float = 3.0
    """m: side of the level place in the middle of slopes and stairs."""
    kinds: tuple[str, ...] = tuple(SHARES)
    """Kinds of ground there are; by their `SHARES`."""


@dataclass(frozen=True)
class Course:
    """Ground made of tiles, and what each of them is."""

    terrain: Terrain
    settings: CourseSettings
    kinds: tuple[tuple[str, ...], ...]
    """By level and column."""
    obstacles: tuple[Obstacle, ...] = ()
    """What stands on tiles of the kind ``obstacles``."""

    @property
    def uneven(self) -> bool:
        """Whether there is any ground that is not level."""
        return bool(np.ptp(self.terrain.heights) > 0.0)

    def kinds_at(self, places: NDArray[np.float64]) -> list[str]:
        """Kind of ground at places (n, 2), m; ``border`` off the tiles."""
        s = self.settings
        cells = np.floor(np.asarray(places) / s.tile).astype(int)
        inside = np.all((cells >= 0) & (cells < [s.columns, s.levels]), axis=1).tolist()
        return [
            self.kinds[y][x] if on else "border" for (x, y), on in zip(cells.tolist(), inside, strict=True)
        ]

    def centres(self) -> NDArray[np.float64]:
        """Middles (levels, columns, 2) of the tiles, m, world."""
        s = self.settings
        x = s.tile * (np.arange(s.columns) + 0.5)
        y = s.tile * (np.arange(s.levels) + 0.5)
        return np.stack(np.meshgrid(x, y), -1).astype(np.float64)


def make_tile(kind: str, difficulty: float, settings: CourseSettings, rng: np.random.Generator) -> Heights:
    """Heights (n, n), m, of one tile, 0 at its rim but for rough ground.

    Args:
        kind: one of `SHARES`.
        difficulty: 0 to 1: slopes to 0.7, steps from 0.05 to 0.225 m, blocks from 0.025 to 0.175 m.
        settings: sizes.
        rng: random numbers.

    Raises:
        CourseError: an unknown kind.
    """
    n = round(settings.tile / settings.cell)
    along = (np.arange(n) + 0.5) * settings.cell - 0.5 * settings.tile
    out = np.maximum(np.abs(along[:, None]), np.abs(along[None]))  # distance from the middle, squares
    inwards = np.clip(0.5 * settings.tile - out, 0.0, 0.5 * (settings.tile - settings.platform))
    up = rng.choice([-1.0, 1.0])
    if kind in ("flat", "obstacles"):
        return np.zeros((n, n))
    if kind == "slope":
        return up * 0.7 * difficulty * inwards
    if kind == "rough_slope":
        bump = round(_BUMP / settings.cell)
        coarse = rng.uniform(-0.1, 0.1, (n // bump + 2, n // bump + 2)) * (0.2 + 0.8 * difficulty)
        return up * 0.35 * difficulty * inwards + zoom(coarse, bump, order=1)[:n, :n]
    if kind in ("stairs_up", "stairs_down"):
        height = 0.05 + 0.175 * difficulty
        steps = np.floor(inwards / 0.31 + 1e-9)
        return (height if kind == "stairs_up" else -height) * steps
    if kind == "discrete":
        return _blocks(n, 0.025 + 0.15 * difficulty, out, settings, rng)
    raise CourseError(f"There is no ground of kind {kind!r}; the kinds are {', '.join(SHARES)}.")


def _blocks(
    n: int, height: float, out: Heights, settings: CourseSettings, rng: np.random.Generator
) -> Heights:
    """Forty flat blocks and pits of 1 to 2 m."""
    ground = np.zeros((n, n))
    for _ in range(40):
        width, depth = (rng.uniform(1.0, 2.0, 2) / settings.cell).astype(int)
        x, y = rng.integers(n - width), rng.integers(n - depth)
        ground[x : x + width, y : y + depth] = rng.choice([-1.0, -0.5, 0.5, 1.0]) * height
    ground[out < 0.5 * settings.platform] = 0.0
    return ground


def scatter_obstacles(
    middle: tuple[float, float], side: float, count: int, rng: np.random.Generator, free: float = 1.5
) -> list[Obstacle]:
    """Boxes of 0.5 to 1.5 m, turned at random, that leave 1.2 m between them.

    Args:
        middle: (x, y) m, world, of the square they stand in; it stays free.
        side: m of the square.
        count: how many at most; fewer where there is no room.
        rng: random numbers.
        free: m around the middle without any.
    """
    placed: list[tuple[Heights, float]] = [(np.asarray(middle), free - 1.2)]
    boxes = []
    for _ in range(20 * count):
        half, turn = rng.uniform(0.25, 0.75, 2), rng.uniform(0.0, np.pi)
        reach = float(np.hypot(*half))
        place = np.asarray(middle) + rng.uniform(-0.5, 0.5, 2) * (side - 2 * reach)
        if len(boxes) < count and all(np.hypot(*(place - p)) > reach + r + 1.2 for p, r in placed):
            placed.append((place, reach))
            cos, sin = np.cos(turn), np.sin(turn)
            corners = (
                np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[cos, sin], [-sin, cos]])
            )
            boxes.append(Obstacle(f"box {len(boxes)}", place + corners, 2.0))
    return boxes


def make_course(
    settings: CourseSettings | None = None, kinds: dict[str, float] | None = None, seed: int = 0
) -> Course:
    """Lay tiles: a kind a column, a difficulty a level, level / levels (PACER, app. B.3).

    Args:
        settings: sizes and numbers.
        kinds: shares of the kinds; those of the settings when left out.
        seed: of heights, and of who goes up and who down.

    Raises:
        CourseError: no tile, an unknown kind, or no positive share.
    """
    s = settings or CourseSettings()
    shares = {kind: SHARES.get(kind, 0.0) for kind in s.kinds} if kinds is None else kinds
    if s.levels < 1 or s.columns < 1 or not sum(shares.values()) > 0:
        raise CourseError("A course needs at least one level, one column and one kind of ground.")
    rng = np.random.default_rng(seed)
    bounds = np.cumsum(list(shares.values())) / sum(shares.values())
    names = list(shares)
    row = [names[int(np.searchsorted(bounds, (c + 0.5) / s.columns))] for c in range(s.columns)]
    margin = round(s.border / s.cell)
    strips = [
        np.concatenate([make_tile(kind, level / s.levels, s, rng) for kind in row], axis=1)
        for level in range(s.levels)
    ]
    heights = np.pad(np.concatenate(strips, axis=0), margin).astype(np.float32)
    corner = 0.5 * s.cell - s.border
    boxes = [
        box
        for level in range(s.levels)
        for column, kind in enumerate(row)
        if kind == "obstacles"
        for box in scatter_obstacles(
            (s.tile * (column + 0.5), s.tile * (level + 0.5)),
            s.tile - 1.0,
            round((1 + 2 * level / s.levels) * s.tile**2 / 25.0),
            rng,
        )
    ]
    return Course(Terrain(heights, s.cell, (corner, corner)), s, (tuple(row),) * s.levels, tuple(boxes))
