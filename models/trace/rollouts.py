"""Recorded scenes walked anew in closed loop: plan, walk a second, plan again (Rempe et al. 2023, sec. 4.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ..crowd.planning import Futures
from .config import TraceConfig
from .crowd_file import SPLITS, CrowdFileError, Crowds
from .metrics import Array
from .objectives import Objective
from .scene_map import SceneMaps
from .windows import CrowdWindows

SECONDS = 10  # of a rollout; every second a new plan
GOAL_SECONDS = 9  # the waypoint is where the person truly is then
HISTORY = 1.0  # s for which a person must have been seen before the rollout begins
GROUP_REACH = 3.0  # m (app. C.5)


@dataclass(frozen=True)
class Rollout:
    """A recorded scene that is walked anew.

    The first `walkers` rows are planned for; everybody else is replayed, and is around for as long as in the
    recording.

    Attributes:
        states: (N, T, 4) recorded world states; zero where absent.
        present: (N, T) bool.
        observed: (N, T, 2) recorded positions, NaN where absent [m].
        walkers: Number of people who are planned for.
        now: Frame at which the rollout begins.
        maps: Map, or None.
        polygons: Obstacle outlines.
        radius: Of the discs [m].
        dt: Time between frames [s].
    """

    states: torch.Tensor
    present: torch.Tensor
    observed: torch.Tensor
    walkers: int
    now: int
    maps: SceneMaps | None
    polygons: Sequence[Array]
    radius: float
    dt: float

    @property
    def goals(self) -> Array:
        """(walkers, 2) where they truly are nine seconds later [m]."""
        return self.observed[: self.walkers, self.now + round(GOAL_SECONDS / self.dt)].numpy()

    @property
    def groups(self) -> NDArray[np.int_]:
        """(walkers,) who walks with whom, -1 alone: within 3 m and in a similar direction (app. C.5)."""
        state = self.states[: self.walkers, self.now].numpy()
        velocity = state[:, 3:] * np.stack([np.cos(state[:, 2]), np.sin(state[:, 2])], 1)
        near = np.linalg.norm(state[:, None, :2] - state[:, :2], axis=-1) <= GROUP_REACH
        number = connected_components(near & (velocity @ velocity.T > 0), directed=False)[1]
        return np.where(np.bincount(number)[number] > 1, number, -1)


def rollouts(crowds: Crowds, config: TraceConfig, split: str = "test") -> list[Rollout]:
    """The scenes of a split in which somebody is seen for a second before and nine seconds after the start.

    Raises:
        CrowdFileError: When the scenes are shorter than a rollout.
    """
    wanted, frames = config.history + round(SECONDS / crowds.dt), crowds.positions.shape[2]
    if frames < wanted:
        raise CrowdFileError(f"a rollout takes {wanted} frames; the scenes of {crowds.name} have {frames}")
    windows = CrowdWindows(crowds, split, config)
    now, found = config.history - 1, []
    before, after = round(HISTORY / crowds.dt), round(GOAL_SECONDS / crowds.dt)
    for scene, row in enumerate(np.flatnonzero(crowds.split == SPLITS.index(split))):
        present = windows.present[scene]
        stays = present[:, now - before] & present[:, now + after]
        order = torch.argsort(stays.int(), descending=True, stable=True)
        order = order[present[order].any(1)]
        if stays.any():
            found.append(
                Rollout(
                    states=windows.states[scene, order],
                    present=present[order],
                    observed=windows.observed[scene, order],
                    walkers=int(stays.sum()),
                    now=now,
                    maps=windows.maps(torch.tensor([scene])),
                    polygons=crowds.polygons_of(int(row)),
                    radius=crowds.radius,
                    dt=crowds.dt,
                )
            )
    return found


Wishes = Callable[[int, Array], list[Objective]]
"""Objectives for a number of people, the walkers first, given their path (walkers, T, 2) so far [m]."""


class LoopPlanner(Protocol):
    """What plans for a scene again and again; `TracePlanner` does."""

    @property
    def config(self) -> TraceConfig:
        """How much of the past it wants to see."""
        ...

    def plan(
        self,
        states: torch.Tensor,
        size: torch.Tensor,
        maps: SceneMaps | None = None,
        objectives: Sequence[Objective] = (),
        present: torch.Tensor | None = None,
        previous: Any = None,
        elapsed: int = 10,
        seed: int = 0,
        ids: Sequence[int] | None = None,
    ) -> Futures:
        """See `ScenePlanner.plan`."""
        ...


def walk(planner: LoopPlanner, rollout: Rollout, wishes: Wishes, seed: int = 0) -> torch.Tensor:
    """Walk a rollout, with a new plan every second that begins with the one before, as in a running graph.

    Args:
        planner: With its sampling and guidance.
        rollout: The scene.
        wishes: What is asked, anew for each plan.
        seed: Of the samples.

    Returns:
        (walkers, 101, 4) world states from the first moment on.
    """
    states, present = rollout.states.clone(), rollout.present.clone()
    walkers, step, history = rollout.walkers, round(1 / rollout.dt), planner.config.history
    present[:walkers, rollout.now :] = True
    plan: Futures | None = None
    for number in range(SECONDS):
        now = rollout.now + number * step
        around = present[:, now].nonzero()[:, 0]  # walkers are always there, and first
        past = slice(now + 1 - history, now + 1)
        size = torch.full((len(around), 2), 2 * rollout.radius)
        path = states[:walkers, rollout.now : now + 1, :2].numpy()
        plan = planner.plan(
            states[around, past],
            size,
            rollout.maps,
            wishes(len(around), path),
            present=present[around, past],
            previous=plan,
            elapsed=step,
            seed=1000 * seed + number,
            ids=around.tolist(),
        )
        rows = np.arange(walkers), plan.chosen[:walkers]
        ahead = [plan.positions[rows], plan.headings[rows][..., None], plan.speeds[rows][..., None]]
        chosen = torch.from_numpy(np.concatenate(ahead, -1)[:, :step]).float()
        states[:walkers, now + 1 : now + 1 + step] = chosen
    return states[:walkers, rollout.now : rollout.now + SECONDS * step + 1]
