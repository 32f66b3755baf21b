"""PACER as a control method: a trained policy drives the joints of bodies that obey physics. Needs torch."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ..messages.config import ConfigError
from ..messages.plan import PLAN_DT, PLAN_STEPS
from ..models.body import Body
from ..models.gait.footholds import HeightAt
from ..models.pacer.paths import Paths
from ..models.pacer.walker import WALKER, Walker
from ..models.scene import Obstacle
from ..models.trace.weights import WeightsError

Array = NDArray[np.float64]


class PacerMethod:
    """PD targets from a policy that sees body, ground and plan.

    Args:
        tick: Time from one step to the next [s].
        weights: File, or None for the shipped one.
        threads: Of torch, in this process.

    Raises:
        ConfigError: The weights cannot be used.
    """

    def __init__(self, tick: float, weights: str | None, threads: int) -> None:
        torch.set_num_threads(threads)
        path = Path(weights) if weights else WALKER
        try:
            self._walker = Walker.load(path)
        except WeightsError as error:
            raise ConfigError(f"controller: config: weights: {error}") from None
        if abs(self._walker.period - tick) > 1e-6:
            raise ConfigError(
                f"controller: config: weights: {path} was trained for {1 / self._walker.period:g} steps a second; "
                f"the graph makes {1 / tick:g}"
            )
        self._plans: dict[int, tuple[float, Array]] = {}
        """When each was made [s], and where it leads: (PLAN_STEPS + 1, 2)."""

    @property
    def ids(self) -> list[int]:
        """Who walks, in the order of what `step` takes and returns."""
        return self._walker.ids

    def ground(self, height_at: HeightAt, obstacles: Sequence[Obstacle]) -> None:
        """Walk on other ground from here on, among other obstacles."""
        self._walker.ground(height_at, obstacles)

    def enter(self, ids: Sequence[int], bodies: Sequence[Body], states: Array, now: float) -> None:
        """Take over newcomers as they stand or walk: states (n, 24, 13); until a plan comes they stop."""
        self._walker.enter(ids, bodies, states)
        for agent, state in zip(ids, states, strict=True):
            self._plans[agent] = now, np.repeat(state[:1, :2], PLAN_STEPS + 1, axis=0)

    def leave(self, ids: Sequence[int]) -> None:
        """Let go of people."""
        self._walker.leave(ids)
        for agent in ids:
            del self._plans[agent]

    def take(self, agent: int, stamp: float, points: Array, headings: Array) -> None:
        """Give a person a new plan: points (T, 2), `PLAN_DT` apart after `stamp`; bodies face where they go."""
        self._plans[agent] = stamp, np.vstack([2 * points[0] - points[1], points])

    def step(self, states: Array, now: float) -> tuple[Array, Array | None]:
        """PD targets (N, 69) [rad] until one tick from now [s]; physics moves the pelvis."""
        plans = [self._plans[agent] for agent in self.ids]
        if not plans:
            return np.zeros((0, 69)), None
        paths = Paths(np.stack([way for _, way in plans]), PLAN_DT * PLAN_STEPS)
        return self._walker.step(states, paths, [now - made for made, _ in plans]), None
