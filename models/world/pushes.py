"""Forces on body parts that last for a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(slots=True)
class Push:
    """A force (3,), N, world, on one body part of one person for so many more time steps."""

    agent: int
    part: int
    force: NDArray[np.float64]
    steps: int


class Pushes:
    """The pushes under way."""

    def __init__(self) -> None:
        self._active: list[Push] = []

    def add(self, push: Push) -> None:
        """Start a push with the next time step."""
        self._active.append(push)

    def cancel(self, agent: int) -> None:
        """End all pushes of a person."""
        self._active = [push for push in self._active if push.agent != agent]

    def apply(self, wrench: NDArray[np.float64]) -> None:
        """Write the forces of one time step into (N, 24, 6) wrenches, N and N m, and count it."""
        if not self._active:
            return
        wrench[:] = 0.0
        for push in self._active:
            push.steps -= 1
            if push.steps >= 0:
                wrench[push.agent, push.part, :3] += push.force
        self._active = [push for push in self._active if push.steps >= 0]
