"""Where walks begin: on the tiles of a course, mostly on those where some fall and some do not, near one's company."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.layers import signed_distance
from .courses import Course

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_MEMORY = 0.03  # weight of one more walk in the share that falls on a tile
_LEAST = 0.04  # variance of falling or not that every tile counts for; where half fall it is 0.25
_TOGETHER = 3.0  # m within which company begins
_JOINING = 0.5  # share of those who begin while others of their company walk that join them
_ROOM, _APART = 1.0, 1.2  # m to obstacles, and to each other if there is room for that
_TRIES = 12


class Starts:
    """Draws places to begin at.

    Args:
        course: what there is to walk on; None is level ground, on which everybody begins at the origin.
        outlines: polygons (K, 2), m, of what stands there.
        people: N.
        company: how many belong together; people of a company have neighbouring numbers.
        rng: random numbers.
    """

    def __init__(
        self,
        course: Course | None,
        outlines: list[NDArray[np.float64]],
        people: int,
        company: int,
        rng: np.random.Generator,
    ):
        levels, columns = np.shape(course.kinds) if course else (1, 1)
        self.falls: Array = np.full((levels, columns), 0.5)
        """(levels, columns) share of the walks begun on a tile that end with a fall, as remembered."""
        self.learning = False
        """Whether people begin where the outcome is open, from which there is most to learn; otherwise anywhere."""
        self._course, self._outlines, self._company, self._rng = course, outlines, company, rng
        self._tile: Ids = np.zeros((people, 2), dtype=np.intp)  # column and level where each began

    def anywhere(self, count: int) -> Array:
        """Places (n, 2), m, world, near the middles of tiles."""
        if self._course is None:
            return np.zeros((count, 2))
        rng, centres = self._rng, self._course.centres()
        levels, kinds = centres.shape[:2]
        if self.learning:
            doubt = np.maximum(self.falls * (1.0 - self.falls), _LEAST).ravel()
            rows, columns = np.divmod(rng.choice(doubt.size, count, p=doubt / doubt.sum()), kinds)
        else:
            columns, rows = rng.integers(kinds, size=count), rng.integers(levels, size=count)
        return centres[rows, columns] + rng.uniform(-1.0, 1.0, (count, 2))

    def draw(self, ids: Ids, people: Array) -> Array:
        """Places (n, 2), m, world, for people (n,) to begin at: half of them near their company, but not too near.

        Args:
            ids: who begins.
            people: (N, 2) m, world: where everybody is.
        """
        places = self.anywhere(len(ids))
        if self._company > 1:
            self._gather(places, ids, people.copy())
        if self._course:
            last = np.array(np.shape(self._course.kinds))[::-1] - 1
            self._tile[ids] = np.clip(places // self._course.settings.tile, 0, last)
        return places

    @property
    def level(self) -> float:
        """How many levels people master: the share that does not fall, summed over levels; mean over columns."""
        return float((1.0 - self.falls).sum(0).mean())

    def remember(self, ids: Ids, fell: NDArray[np.bool_]) -> None:
        """Count who (n,) of people whose walks have ended fell, by the tile on which they began."""
        for (column, level), down in zip(self._tile[ids], fell, strict=True):
            self.falls[level, column] += _MEMORY * (down - self.falls[level, column])

    def _gather(self, places: Array, ids: Ids, people: Array) -> None:
        """Move places (n, 2) to where company is, in place."""
        size, rng = self._company, self._rng
        present = np.ones(len(people), dtype=bool)
        present[ids] = False
        for row, i in enumerate(ids):
            mates = slice(i - i % size, i - i % size + size)
            there = people[mates][present[mates]]
            if len(there) and rng.random() < _JOINING:
                middle = there[rng.integers(len(there))]
                spots = middle + rng.uniform(-_TOGETHER, _TOGETHER, (_TRIES, 2))
                spots = spots[self._room(spots) > _ROOM]
                if len(spots):
                    gap = np.linalg.norm(spots[:, None] - there, axis=-1).min(1)
                    places[row] = spots[np.argmax(np.minimum(gap, _APART))]
            people[i], present[i] = places[row], True

    def _room(self, spots: Array) -> Array:
        """Distance (n,), m, of places (n, 2) from obstacles; 0 off the course's tiles."""
        if self._course is None:
            return np.full(len(spots), np.inf)
        s = self._course.settings
        size = s.tile * np.array([s.columns, s.levels])
        outside = ((spots < 0.0) | (spots > size)).any(1)
        return np.where(outside, 0.0, signed_distance(self._outlines, spots))
