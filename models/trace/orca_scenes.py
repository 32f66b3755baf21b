"""Synthetic crowds: random scenes walked by ORCA (Rempe et al. 2023, sec. 4 and app. C.1).

Two subsets: `maps` has few people among many obstacles, `interact` many people and no obstacle (and no map).
Beyond the paper, which leaves the generator open: obstacle sizes scale with the area; a person keeps a skin
of 5 cm around the 0.4 m disc, so that touching a wall and entering it are different things; the wanted
velocity relaxes towards a new goal instead of jumping; and whoever is stuck when the next goal is drawn
turns to a random direction.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..crowd.convex_obstacles import ConvexObstacles
from ..crowd.orca import OrcaParams, orca_velocity
from .scene_map import polygon_distance

Subset = Literal["maps", "interact"]
Floats = NDArray[np.float32]
SUBSETS: tuple[Subset, ...] = ("maps", "interact")


@dataclass(frozen=True)
class CrowdSpec:
    """How scenes are drawn.

    Attributes:
        subset: `maps` or `interact`.
        area: Side of the square in which people and obstacles are placed [m].
        seconds: Length of a scene [s].
        rate_hz: Frames that are kept per second.
        substeps: Solver steps per frame; 6 is the 60 Hz of the reference generator.
        radius: Disc of a person [m]; the bounding box is 0.8 m wide.
        skin: Extra distance the simulated people keep [m].
        relax: Time constant with which the wanted velocity follows the goal [s].
        margin: The distance field reaches this far beyond the area [m].
        resolution: Cell size of the distance field [m].
    """

    subset: Subset = "maps"
    area: float = 15.0
    seconds: float = 10.0
    rate_hz: int = 10
    substeps: int = 6
    radius: float = 0.4
    skin: float = 0.05
    relax: float = 0.3
    margin: float = 3.0
    resolution: float = 0.2

    @property
    def most_agents(self) -> int:
        """People in the fullest scene."""
        return 10 if self.subset == "maps" else 20

    @property
    def most_obstacles(self) -> int:
        """Obstacles in the fullest scene."""
        return 20 if self.subset == "maps" else 0

    @property
    def frames(self) -> int:
        """Frames of a scene, both ends included."""
        return round(self.seconds * self.rate_hz) + 1


@dataclass(frozen=True)
class Crowd:
    """One finished scene.

    Attributes:
        positions: (N, frames, 2) world x, y [m].
        polygons: Obstacle outlines, each (V, 2) [m].
        distance: (H, W) signed distance to the obstacles [m], on the grid of `map_axis`.
    """

    positions: Floats
    polygons: list[Floats]
    distance: Floats


def map_axis(spec: CrowdSpec) -> Floats:
    """Cell centres of the distance field along x, and along y [m]; the origin is the middle of the area."""
    reach = spec.area / 2 + spec.margin
    return np.linspace(-reach, reach, round(2 * reach / spec.resolution) + 1, dtype=np.float32)


def draw_polygons(spec: CrowdSpec, rng: np.random.Generator) -> list[Floats]:
    """Ellipses, boxes and triangles of width and height U(0.1, 1/3) of the area, anywhere, at any angle."""
    if not spec.most_obstacles:
        return []
    polygons = []
    for _ in range(rng.integers(1, spec.most_obstacles + 1)):
        corners = rng.choice([12, 4, 3])
        angle = 2 * np.pi * (np.arange(corners) + (0.5 if corners == 4 else 0.0)) / corners
        outline = np.stack([np.cos(angle), np.sin(angle)], 1) / (np.sqrt(0.5) if corners == 4 else 1.0)
        outline *= rng.uniform(0.1, 1 / 3, 2) * spec.area / 2
        turn = rng.uniform(0, 2 * np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        polygons.append(
            (outline @ rotation.T + rng.uniform(-spec.area / 2, spec.area / 2, 2)).astype(np.float32)
        )
    return polygons


def draw_starts(spec: CrowdSpec, polygons: list[Floats], rng: np.random.Generator) -> Floats:
    """Up to the drawn number of people (N, 2) on free ground, apart from each other."""
    wanted = rng.integers(2, spec.most_agents + 1)
    gap = spec.radius + spec.skin + 0.05
    candidates = rng.uniform(-spec.area / 2, spec.area / 2, (40 * wanted, 2)).astype(np.float32)
    candidates = candidates[polygon_distance(candidates, polygons) > gap]
    starts = np.empty((0, 2), np.float32)
    for candidate in candidates:
        if len(starts) < wanted and (np.linalg.norm(starts - candidate, axis=1) > 2 * gap).all():
            starts = np.concatenate([starts, candidate[None]])
    return starts


class Goals:
    """The walking directions and speeds of one scene's people, re-drawn every 2 to 4 seconds."""

    def __init__(self, starts: Floats, rng: np.random.Generator):
        self.rng, self.count = rng, len(starts)
        towards_centre = np.arctan2(-starts[:, 1], -starts[:, 0])
        self.heading = towards_centre + rng.uniform(-np.pi / 4, np.pi / 4, self.count)
        self.speed = rng.uniform(1, 2, self.count)
        self.until = rng.uniform(2, 4, self.count)

    def velocity(self, time: float, moving: NDArray[np.float64]) -> NDArray[np.float64]:
        """Goal velocities (N, 2) at a time [s] given the present velocities (N, 2)."""
        due = time >= self.until
        if due.any():
            stuck = np.linalg.norm(moving, axis=1) < 0.2
            along = np.arctan2(moving[:, 1], moving[:, 0]) + self.rng.normal(0, np.deg2rad(10), self.count)
            fresh = np.where(stuck, self.rng.uniform(-np.pi, np.pi, self.count), along)
            self.heading = np.where(due, fresh, self.heading)
            self.speed = np.where(due, self.rng.uniform(1, 2, self.count), self.speed)
            self.until = np.where(due, time + self.rng.uniform(2, 4, self.count), self.until)
        return self.speed[:, None] * np.stack([np.cos(self.heading), np.sin(self.heading)], 1)


def simulate_crowds(spec: CrowdSpec, seed: int, scenes: range) -> list[Crowd]:
    """Draw and walk scenes in one batch; a scene depends on the seed and its number only.

    A scene in which nobody found room, or people overlap each other or an obstacle, is drawn again.
    """
    finished: dict[int, Crowd] = {}
    attempt = 0
    while len(finished) < len(scenes):
        todo = [scene for scene in scenes if scene not in finished]
        crowds = _walk(
            spec, [np.random.default_rng([seed, SUBSETS.index(spec.subset), s, attempt]) for s in todo]
        )
        for scene, crowd in zip(todo, crowds, strict=True):
            if len(crowd.positions) >= 2 and smallest_gap(crowd, spec.radius) >= 0:
                finished[scene] = crowd
        attempt += 1
    return [finished[scene] for scene in scenes]


def smallest_gap(crowd: Crowd, radius: float) -> float:
    """Smallest free distance between two discs, or a disc and an obstacle, over a whole scene [m]."""
    frames = crowd.positions.transpose(1, 0, 2)  # (T, N, 2)
    apart = np.linalg.norm(frames[:, :, None] - frames[:, None], axis=-1)
    apart[:, np.arange(len(crowd.positions)), np.arange(len(crowd.positions))] = np.inf
    clear = polygon_distance(crowd.positions.reshape(-1, 2), crowd.polygons)
    return float(min(apart.min() - 2 * radius, clear.min() - radius))


def _walk(spec: CrowdSpec, rngs: list[np.random.Generator]) -> list[Crowd]:
    polygons = [draw_polygons(spec, rng) for rng in rngs]
    starts = [draw_starts(spec, p, rng) for p, rng in zip(polygons, rngs, strict=True)]
    shape = (len(rngs), spec.most_agents)
    position, present = np.zeros((*shape, 2)), np.zeros(shape, bool)
    for b, start in enumerate(starts):
        position[b, : len(start)], present[b, : len(start)] = start, True
    goals = [Goals(start, rng) for start, rng in zip(starts, rngs, strict=True)]
    uniform = [np.stack([rng.uniform(0, 1, shape[1]) for _ in range(3)]) for rng in rngs]
    reach, horizon, horizon_obst = np.stack(uniform, 1)
    params = OrcaParams(
        radius=spec.radius + spec.skin,
        max_speed=2.0,
        neighbor_dist=10 + 10 * reach,
        max_neighbors=10,
        time_horizon=2 + 3 * horizon,
        time_horizon_obst=2 + 3 * horizon_obst,
    )
    obstacles = ConvexObstacles.from_polygons(polygons) if spec.most_obstacles else None
    dt = 1 / (spec.rate_hz * spec.substeps)
    velocity, wanted = np.zeros_like(position), np.zeros_like(position)
    kept = [position]
    for step in range((spec.frames - 1) * spec.substeps):
        for b, goal in enumerate(goals):
            n = goal.count
            wanted[b, :n] += (goal.velocity(step * dt, velocity[b, :n]) - wanted[b, :n]) * min(
                dt / spec.relax, 1
            )
        velocity = orca_velocity(position, velocity, wanted, dt, params, obstacles, present)
        position = position + dt * velocity
        if (step + 1) % spec.substeps == 0:
            kept.append(position)
    walked = np.stack(kept, 2).astype(np.float32)  # (B, N, frames, 2)
    axis = map_axis(spec)
    cells = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)  # row index grows with y
    fields = [polygon_distance(cells, p).reshape(len(axis), len(axis)) for p in polygons]
    return [Crowd(walked[b, : goals[b].count], polygons[b], fields[b]) for b in range(len(rngs))]
