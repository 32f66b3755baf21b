"""What every planner takes and gives: a crowd now, and its possible futures."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLAN_DT = 0.1
"""Time between the points of a plan [s]."""
PLAN_STEPS = 50
"""Points of a plan: five seconds (TRACE, section 4)."""


@dataclass(frozen=True)
class Crowd:
    """N pedestrians at one moment and what they want; world frame."""

    position: Array
    """(N, 2) m."""
    velocity: Array
    """(N, 2) m/s."""
    heading: Array
    """(N,) rad."""
    radius: Array
    """(N,) m: disk to keep free of other disks."""
    goal: Array
    """(N, 2) m; who has none wants to be where they are."""
    speed: Array
    """(N,) m/s: preferred."""
    group: NDArray[np.int_]
    """(N,) number shared by those who walk together, -1 alone."""

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True)
class Futures:
    """S sampled futures of N pedestrians over T points, the first one `PLAN_DT` from now; world frame."""

    positions: Array
    """(N, S, T, 2) m."""
    headings: Array
    """(N, S, T) rad."""
    speeds: Array
    """(N, S, T) m/s."""
    chosen: NDArray[np.int_]
    """(N,) sample to follow."""
    losses: dict[str, Array] = field(default_factory=dict)
    """(N, S) guidance loss by objective."""


class Planner(Protocol):
    """Plans for a crowd on a map given when it was made."""

    def plan(self, crowd: Crowd) -> Futures:
        """The futures of everybody."""
        ...


class ConstantVelocity:
    """The baseline: everybody keeps their velocity, whatever stands in the way."""

    def plan(self, crowd: Crowd) -> Futures:
        """One sample each, straight on."""
        times = PLAN_DT * np.arange(1, PLAN_STEPS + 1)
        positions = crowd.position[:, None] + crowd.velocity[:, None] * times[:, None]
        speed = np.linalg.norm(crowd.velocity, axis=1)
        direction = np.where(
            speed > 0.05, np.arctan2(crowd.velocity[:, 1], crowd.velocity[:, 0]), crowd.heading
        )
        ones = np.ones((1, PLAN_STEPS))
        return Futures(
            positions=positions[:, None],
            headings=(direction[:, None] * ones)[:, None],
            speeds=(speed[:, None] * ones)[:, None],
            chosen=np.zeros(len(crowd), dtype=int),
        )
