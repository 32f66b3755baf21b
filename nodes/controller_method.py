"""What the controller's methods are asked, and who they move."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..models.body import Body
from ..models.gait.footholds import HeightAt
from ..models.scene import Obstacle

Array = NDArray[np.float64]

PUT, FASTEST = 0.5, 10.0
"""Whoever has moved farther than this [m], and faster [m/s], was put there."""


class Method(Protocol):
    """A way of moving bodies along plans."""

    @property
    def ids(self) -> list[int]:
        """Who is moved, in the order of what `step` takes and returns."""
        ...

    def ground(self, height_at: HeightAt, obstacles: Sequence[Obstacle]) -> None:
        """Walk on other ground from here on, among other obstacles."""
        ...

    def enter(self, ids: Sequence[int], bodies: Sequence[Body], states: Array, now: float) -> None:
        """Take over newcomers: states (n, 24, 13) as in `BodyStates`, at a time [s]."""
        ...

    def leave(self, ids: Sequence[int]) -> None:
        """Let go of people."""
        ...

    def take(self, agent: int, stamp: float, points: Array, headings: Array) -> None:
        """Give a person a new plan: points (T, 2) and headings (T,), `PLAN_DT` apart after `stamp` [s]."""
        ...

    def step(self, states: Array, now: float) -> tuple[Array, Array | None]:
        """Hinge angles or targets (N, 69) [rad], and pelvis poses (N, 7) if physics has no say in them."""
        ...


class Attendance:
    """Who is there, and who was put somewhere else since the last look."""

    def __init__(self) -> None:
        self._last: dict[int, Array] = {}

    def look(self, ids: Sequence[int], places: Array, elapsed: float) -> tuple[list[int], list[int]]:
        """Who has come and who has gone since the last look; who was put elsewhere has done both.

        Args:
            ids: Who is here now.
            places: (N, 2) where [m].
            elapsed: Since the last look [s].
        """
        here = dict(zip(ids, places, strict=True))
        last = self._last
        reach = PUT + FASTEST * max(elapsed, 0.0)
        put = {i for i in here if i in last and float(np.linalg.norm(here[i] - last[i])) > reach}
        self._last = here
        return [i for i in here if i not in last or i in put], [i for i in last if i not in here or i in put]
