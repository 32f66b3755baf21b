"""Plans for all agents of a scene at once, by any model that turns their context into actions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from ..crowd.planning import Futures
from .context import FAR, Context, scene_context
from .dynamics import rollout
from .guidance import FutureOf
from .network import ActionModel
from .objectives import Future, Objective, ObjectiveError
from .sampling import Sampling
from .scene_map import SceneMaps
from .settling import Candidates

BEYOND = 5.0
"""Goals may lie so far outside the map [m]."""


@dataclass(frozen=True)
class TraceFutures(Futures):
    """Futures and what the next plan starts with.

    Attributes:
        actions: (A, S, horizon, 2) normalised actions behind the futures.
        ids: Numbers of the agents.
    """

    actions: Tensor = field(default_factory=lambda: torch.empty(0))
    ids: tuple[int, ...] = ()


class ActionSource(Protocol):
    """What draws the actions of everybody in a scene."""

    def sample(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
        start: Tensor | None = None,
    ) -> Tensor:
        """Actions of all samples of all agents together: (A, M, horizon, 2), normalised.

        Args:
            context: A agents.
            future_of: From actions to what the objectives look at.
            objectives: What is asked.
            generator: Draws the noise.
            start: (A, M, horizon, 2) actions of the previous plan to start from.
        """
        ...


class ScenePlanner:
    """A planner around whatever draws actions.

    Args:
        model: The network, which knows what normalised actions are.
        sampling: How futures are drawn.
        source: Draws them.
    """

    def __init__(self, model: ActionModel, sampling: Sampling, source: ActionSource):
        self.config, self.sampling = model.config, sampling
        self._model, self._source = model, source

    def settle(
        self,
        found: Candidates,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        seed: int,
    ) -> Candidates:
        """Better samples, or another choice among them; none unless a planner knows some."""
        return found

    def plan(
        self,
        states: np.ndarray | Tensor,
        size: np.ndarray | Tensor,
        maps: SceneMaps | None = None,
        objectives: Sequence[Objective] = (),
        present: np.ndarray | Tensor | None = None,
        previous: TraceFutures | None = None,
        elapsed: int = 10,
        seed: int = 0,
        ids: Sequence[int] | None = None,
    ) -> TraceFutures:
        """Futures of all A agents of a scene.

        Args:
            states: (A, 31, 4) world x, y [m], heading [rad], speed [m/s] at 10 Hz; the last frame is now.
            size: (A, 2) length and width of the agents [m]; the disc that avoids things is half the larger
                one.
            maps: One scene's map, or None where it is unknown.
            objectives: What is asked; see `objectives.OBJECTIVES`.
            present: (A, 31) false where an agent was not seen.
            previous: The last plan: saves denoising steps and keeps plans from flickering. Who is new since
                then starts from walking straight on.
            elapsed: Frames since `previous` was made.
            seed: Same seed, same plan.
            ids: Numbers of the agents, by which `previous` knows them; 0 to A - 1 by default.

        Raises:
            ValueError: On wrong shapes, values that are not finite, a map without the layers the network
                reads, or a previous plan of other agents.
            ObjectiveError: On parameters that do not fit an objective, or a goal outside the map.
        """
        states, size, seed = _float(states), _float(size), seed % 2**63
        names = tuple(range(len(states))) if ids is None else tuple(ids)
        if len(names) != len(states):
            raise ValueError(f"ids must name {len(states)} agents, not {len(names)}")
        if len(set(names)) < len(names):
            raise ValueError(f"ids must differ, not be {_some(names)}")
        if not len(states):
            return _nobody(self.sampling.samples, self.config.plan, self.config.horizon)
        if states.ndim == 3 and states.shape[1] != self.config.history:
            raise ValueError(f"states must hold {self.config.history} frames an agent, not {states.shape[1]}")
        seen = None if present is None else torch.as_tensor(present, dtype=torch.bool)
        config = self.config
        if maps is not None:
            maps = maps.select(config.map_layers)
        check_objectives(objectives, len(states), maps)
        context = scene_context(states, size, maps, seen, config.max_neighbors, config.neighbor_radius)
        now, radius = states[:, -1], size.max(1).values / 2

        def future_of(actions: Tensor) -> Future:
            return Future(self.world_states(actions, now), now, radius, config.dt, maps, seed=seed, ids=names)

        return self.plan_context(context, future_of, objectives, previous, elapsed, seed, names)

    def plan_context(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective] = (),
        previous: TraceFutures | None = None,
        elapsed: int = 10,
        seed: int = 0,
        ids: tuple[int, ...] | None = None,
    ) -> TraceFutures:
        """The same for a context that is already there, and a function from actions to futures."""
        generator = torch.Generator().manual_seed(seed)
        ids = tuple(range(len(context))) if ids is None else ids
        start = None if previous is None else self._shifted(previous, ids, elapsed)
        actions = self._source.sample(context, future_of, objectives, generator, start)
        found = Candidates.judged(actions, future_of, objectives)
        if objectives:
            found = self.settle(found, context, future_of, objectives, seed)
        states = found.future.states.double().numpy()
        return TraceFutures(
            positions=states[..., :2],
            headings=states[..., 2],
            speeds=states[..., 3],
            chosen=found.chosen.numpy(),
            losses={label: loss.double().numpy() for label, loss in found.losses.items()},
            actions=found.actions,
            ids=ids,
        )

    def world_states(self, actions: Tensor, now: Tensor) -> Tensor:
        """World states (A, M, plan, 4) from normalised actions (A, M, horizon, 2) and states now (A, 4)."""
        actions = actions[..., : self.config.plan, :]
        actions = actions * self._model.trajectory_std[4:] + self._model.trajectory_mean[4:]
        return rollout(now[:, None], actions, self.config.dt)

    def _shifted(self, previous: TraceFutures, ids: tuple[int, ...], elapsed: int) -> Tensor:
        """The chosen actions of the last plan, moved on in time, for every sample.

        After their end, and for who was not in it, nothing changes: straight on at the same speed.
        """
        row_of = {agent: row for row, agent in enumerate(previous.ids)}
        if previous.ids and not row_of.keys() & set(ids):
            raise ValueError(f"the previous plan is of agents {_some(previous.ids)}, none of {_some(ids)}")
        if elapsed < 0:
            raise ValueError(f"elapsed must not be negative, it is {elapsed}")
        horizon = self.config.horizon
        start = self._model.normalized(torch.zeros(len(ids), horizon, 2))
        known = [(row, row_of[agent]) for row, agent in enumerate(ids) if agent in row_of]
        if known and elapsed < horizon:
            rows, old = torch.tensor(known).unbind(1)
            chosen = previous.actions[old, torch.as_tensor(previous.chosen)[old]]  # (known, horizon, 2)
            start[rows, : horizon - elapsed] = chosen[:, elapsed:]
        return start[:, None].expand(-1, self.sampling.samples, -1, -1)


def check_objectives(objectives: Sequence[Objective], agents: int, maps: SceneMaps | None) -> None:
    """Goals and weights must fit the agents, and goals lie on the map, or a few steps beyond its border.

    Raises:
        ObjectiveError: They do not; of a goal it says whose, and how far the map reaches.
    """
    place = "the map" if maps else "what can be planned for"
    low, high = maps.bounds() if maps else (torch.full((2,), -FAR), torch.full((2,), FAR))
    for wish in objectives:
        if (found := wish.goals(agents)) is None:
            continue
        goals, given = found
        outside = ((goals < low - BEYOND) | (goals > high + BEYOND)).any(-1) & given
        if outside.any():
            agent = int(outside.nonzero()[0])
            x, y = goals[agent].tolist()
            raise ObjectiveError(
                f"objective {wish.name!r}: the goal of agent {agent}, ({x:.1f}, {y:.1f}), lies outside {place}, "
                f"which reaches from ({low[0]:.1f}, {low[1]:.1f}) to ({high[0]:.1f}, {high[1]:.1f})"
            )


def _nobody(samples: int, steps: int, horizon: int) -> TraceFutures:
    """The plan of an empty scene."""
    positions = np.zeros((0, samples, steps, 2))
    empty = positions[..., 0]
    return TraceFutures(positions, empty, empty, np.zeros(0, int), {}, torch.zeros(0, samples, horizon, 2))


def _some(ids: tuple[int, ...]) -> str:
    return ", ".join(map(str, ids[:5])) + (", ..." if len(ids) > 5 else "")


def _float(values: np.ndarray | Tensor) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)
