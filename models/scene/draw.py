"""Draw the people of a scene from a seed, nobody overlapping another or an obstacle at entry."""

from typing import TYPE_CHECKING

import numpy as np
import shapely

from .file import Flow, RandomPopulation, SceneError
from .population import SLOWEST, Entry, body_seed

if TYPE_CHECKING:
    from .scene import Scene

HEADWAY = 3.0  # s after which the place of an entry is taken to be free again
TRIES = 200  # batches of candidates before an area counts as full
BATCH = 64
COMPANION_REACH = 2.0  # a companion is at most this many spacings in x and y from the group's first


def draw_entries(scene: "Scene", seed: int, count: int | None) -> list[Entry]:
    """Draw `count` people of a random population; see `Scene.sample_population`."""
    population = scene.population
    assert isinstance(population, RandomPopulation)
    return _Draw(scene, population, seed).entries(population.count if count is None else count)


class _Draw:
    """One seeded draw of a random population by rejection sampling."""

    def __init__(self, scene: "Scene", population: RandomPopulation, seed: int) -> None:
        self.scene, self.population = scene, population
        self.rng = np.random.default_rng(seed)
        self.body_base = seed if population.body_seed is None else population.body_seed
        self.taken: list[tuple[float, np.ndarray]] = []  # time and place of every entry so far
        self.solid = shapely.union_all([shapely.Polygon(obstacle.polygon) for obstacle in scene.obstacles])
        shapely.prepare(self.solid)
        self.areas = {name: shapely.Polygon(polygon) for name, polygon in scene.areas.items()}

    def entries(self, count: int) -> list[Entry]:
        drawn: list[tuple[float, np.ndarray, np.ndarray, float, int | None]] = []
        groups = 0
        for flow, size in self._parties(count):
            who = f"pedestrian {len(drawn) + 1} of {count}"
            speed = min(self._speed() for _ in range(size))  # a group walks as its slowest member does
            time, places = self._places(flow, size, who)
            group = groups if size > 1 else None
            groups += size > 1
            for xy, goal in zip(places, self._goals(flow.goal, places, who), strict=True):
                drawn.append((time, xy, goal, speed, group))
        entries: list[Entry] = []
        for time, xy, goal, speed, group in sorted(drawn, key=lambda row: row[0]):
            way = goal - xy
            velocity = speed * way / max(float(np.hypot(*way)), 1e-9)
            body = body_seed(self.body_base, len(entries))
            entries.append(Entry(time, xy, velocity, goal, speed, body, group))
        return entries

    def _parties(self, count: int) -> list[tuple[Flow, int]]:
        """Flow and size of every group and single, in random order.

        Groups choose a flow by its weight; singles then bring every flow as near to its share as they can.
        """
        sizes: list[int] = []
        while sum(sizes) < count:
            sizes.append(min(self._group_size(), count - sum(sizes)))
        together = [size for size in sizes if size > 1]
        flows = self.population.flows
        share = np.array([flow.weight for flow in flows]) / sum(flow.weight for flow in flows)
        chosen = self.rng.choice(len(flows), size=len(together), p=share)
        missing = share * count - np.bincount(chosen, weights=together, minlength=len(flows))
        upto = np.cumsum(np.maximum(missing, 1e-9))
        singles = len(sizes) - len(together)
        upto = np.floor(upto / upto[-1] * singles + self.rng.random()).astype(int)  # systematic rounding
        parties = [(flows[index], size) for index, size in zip(chosen, together, strict=True)]
        for flow, number in zip(flows, np.diff(upto, prepend=0), strict=True):
            parties += [(flow, 1)] * int(number)
        return [parties[index] for index in self.rng.permutation(len(parties))]

    def _group_size(self) -> int:
        groups = self.population.groups
        sizes = np.array(sorted(groups.sizes))
        weights = np.array([groups.sizes[size] for size in sizes])
        weights = weights / weights.sum()
        mean = float(sizes @ weights)
        in_group = self.rng.random() < groups.share / (mean - groups.share * (mean - 1.0))
        size = int(self.rng.choice(sizes, p=weights))
        return size if in_group else 1

    def _speed(self) -> float:
        mean, sd = self.population.speed_mean, self.population.speed_sd
        while abs(deviation := self.rng.standard_normal()) > 2.0:
            pass
        return max(mean + sd * float(deviation), SLOWEST)

    def _places(self, flow: Flow, size: int, who: str) -> tuple[float, list[np.ndarray]]:
        """When a group enters and each member's place, which are then taken."""
        spacing = self.population.spacing
        for _ in range(TRIES):
            time = float(self.rng.uniform(0.0, self.population.enter_over))
            busy = [xy for when, xy in self.taken if abs(when - time) < HEADWAY]
            members: list[np.ndarray] = []
            for _ in range(size):
                place = self._free(flow.spawn, busy + members, members[0] if members else None)
                if place is None:
                    break
                members.append(place)
            if len(members) == size:
                self.taken += [(time, xy) for xy in members]
                return time, members
        raise SceneError(
            f"areas.{flow.spawn}: no room for {who} at {spacing:g} m from others and {spacing / 2:g} m from"
            f" obstacles; enlarge the area, raise population.enter_over or lower population.count"
        )

    def _goals(self, area: str, members: list[np.ndarray], who: str) -> list[np.ndarray]:
        """A goal in the area for the first member; for the others the same way beside it, or near it."""
        for _ in range(TRIES):
            if (goal := self._free(area, [])) is not None:
                break
        else:
            raise SceneError(f"areas.{area}: no free ground for the goal of {who}; enlarge the area")
        goals = [goal]
        for beside in goal + np.array(members[1:]).reshape(-1, 2) - members[0]:
            free = beside if self._clear(beside[None])[0] else self._free(area, goals, goal)
            goals.append(goal if free is None else free)
        return goals

    def _free(
        self, area: str, others: list[np.ndarray], beside: np.ndarray | None = None
    ) -> np.ndarray | None:
        """A free point of an area, a spacing away from `others`, near `beside`; None if this try failed."""
        polygon, spacing = self.areas[area], self.population.spacing
        low_x, low_y, high_x, high_y = polygon.bounds
        if beside is not None:
            low_x, low_y = np.maximum((low_x, low_y), beside - COMPANION_REACH * spacing)
            high_x, high_y = np.minimum((high_x, high_y), beside + COMPANION_REACH * spacing)
        points = self.rng.uniform((low_x, low_y), (high_x, high_y), size=(BATCH, 2))
        good = shapely.contains_xy(polygon, points[:, 0], points[:, 1])
        if others:
            good &= np.linalg.norm(points[:, None] - np.array(others), axis=-1).min(axis=1) >= spacing
        points = points[good]
        points = points[self._clear(points)]
        return points[0] if len(points) else None

    def _clear(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (N, 2) are on free ground and half a spacing from obstacles."""
        cell = np.floor((points - self.scene.origin) / self.scene.resolution).astype(int)
        rows, cols = self.scene.shape
        on_map = ((cell >= 0) & (cell < (cols, rows))).all(axis=1)
        j, i = np.clip(cell, 0, (cols - 1, rows - 1)).T
        near_solid = shapely.dwithin(self.solid, shapely.points(points), 0.5 * self.population.spacing)
        return on_map & ~self.scene.blocked()[i, j] & ~near_solid
