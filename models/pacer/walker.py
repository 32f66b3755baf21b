"""The trained walker at run time: body states and paths in, PD targets and values of plans out.

>>> walker = Walker.load()  # doctest: +SKIP
>>> walker.enter([7], [body], states)  # doctest: +SKIP
>>> targets = walker.step(states, paths, times)  # (1, 69) rad, for the next 1/30 s  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..body import BODY_INDEX, N_BODIES, N_JOINTS, Body
from ..gait import flat_ground
from ..gait.footholds import HeightAt
from ..scene import Obstacle
from ..world.humanoid import actuated_joints
from .gait_reference import GaitReference
from .local_map import draw_local_maps
from .manners import Manners
from .mathops import heading
from .paths import HORIZON, Paths
from .policy import ActorCritic
from .surface import seen_heights
from .walker_config import WalkerConfig
from .walker_observation import (
    FEET,
    LIMIT,
    WAYPOINTS,
    Mirror,
    Motion,
    People,
    clearance,
    driven_hinges,
    observe,
    touching,
)
from .walker_weights import load_walker

Array = NDArray[np.float64]

WALKER = Path(__file__).parent.parent / "weights" / "pacer_compact.safetensors"
"""The walker that is shipped."""

_RESTING = 0.15  # m/s: who is slower is taken over as standing
_ANKLES = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]


class WalkerError(ValueError):
    """People who are unknown, entered twice, or described by arrays of the wrong shape."""


class Walker:
    """One policy that drives everybody who has entered; rows of all arrays are in the order of `ids`.

    Args:
        model: policy and critic.
        config: settings they were trained with.
        height_at: ground height (m,), m, at world points (m, 2).
    """

    def __init__(self, model: ActorCritic, config: WalkerConfig, height_at: HeightAt = flat_ground):
        self.config = config
        self.period = config.physics.control_period
        """Time between two steps, s."""
        self.hinges = actuated_joints(config.physics.actuation)
        """(H,) hinges that are driven; the targets of the others are 0."""
        self._model = model.eval()
        self._driven = driven_hinges(self.hinges, config.arms)
        self._mirror = Mirror(self.hinges, self._driven, config.map.cells if config.map else 0)
        self._ids: list[int] = []
        self._people: People | None = None
        self._reference: GaitReference | None = None
        self._seen = torch.zeros(0, 0)
        self._axes = torch.zeros(0, 2, 2)
        self._pelvis = torch.zeros(0, 2)
        self.ground(height_at)

    @classmethod
    def load(cls, path: Path = WALKER, height_at: HeightAt = flat_ground) -> Walker:
        """Read a walker.

        Raises:
            WeightsError: the file is missing, broken, or does not fit its own settings.
        """
        model, config, _ = load_walker(path)
        return cls(model, config, height_at)

    @property
    def ids(self) -> list[int]:
        """Who is driven."""
        return list(self._ids)

    def ground(self, height_at: HeightAt, obstacles: Sequence[Obstacle] = ()) -> None:
        """Walk on other ground from here on: heights (m,), m, at world points (m, 2), and what stands on it."""
        self.height_at = height_at
        self._seen_heights = seen_heights(height_at, obstacles)
        self._manners = Manners(1, obstacles) if self.config.manners else None
        if self._reference is not None:
            self._reference.ground(height_at, self._manners)

    def enter(self, ids: Sequence[int], bodies: Sequence[Body], states: ArrayLike) -> None:
        """Take over people as they stand or walk.

        Args:
            ids: (n,) new ones.
            bodies: (n,) theirs.
            states: (n, 24, 13) position m, rotation wxyz, velocity m/s, angular velocity rad/s; world.

        Raises:
            WalkerError: someone is here already, or the arrays do not fit.
        """
        states = _checked(states, len(ids))
        if len(bodies) != len(ids) or len(set(ids)) != len(ids):
            raise WalkerError(f"{len(ids)} people need as many different ids and bodies.")
        if here := sorted(set(ids) & set(self._ids)):
            raise WalkerError(f"Walker {here[0]} is here already; nobody enters twice.")
        if not len(ids):
            return
        way = heading(states[:, 0, 3:7])
        ahead = np.einsum("nk,nk->n", states[:, 0, 7:9], way)
        speed = np.where(ahead < _RESTING, 0.0, ahead)
        left, right = np.einsum("nfk,nk->fn", states[:, _ANKLES, :2], way)
        config = self.config
        reference = GaitReference(
            bodies, self.period, self.height_at, config.limits, self._manners, config.body_aware
        )
        start = states[:, 0, :2] - (speed * self.period)[:, None] * way
        facing = np.arctan2(way[:, 1], way[:, 0])
        reference.place(np.arange(len(ids)), start, facing, speed, np.where(left > right, 0.0, 0.5))
        people = People.of(bodies)
        if self._reference is None or self._people is None:
            self._reference, self._people = reference, people
        else:
            self._reference.join(reference)
            self._people = self._people.join(people)
        self._ids += list(ids)

    def leave(self, ids: Sequence[int]) -> None:
        """Let go of people; the others keep their order.

        Raises:
            WalkerError: someone is not here.
        """
        for agent in ids:
            if agent not in self._ids:
                raise WalkerError(f"Walker {agent} is not here and cannot leave.")
        rows = np.array([row for row, agent in enumerate(self._ids) if agent not in set(ids)], dtype=np.intp)
        self._ids = [self._ids[row] for row in rows]
        if self._reference is not None and self._people is not None:
            self._reference.keep(rows)
            self._people = self._people.take(rows)

    @torch.no_grad()
    def step(self, states: ArrayLike, paths: Paths, times: ArrayLike) -> Array:
        """What the joints should be pulled to until the next step, one `period` from now.

        Args:
            states: (N, 24, 13) body states now, world.
            paths: N paths; where one ends, its walker stops.
            times: (N,) s since the beginning of each path.

        Returns:
            PD targets (N, 69), rad.

        Raises:
            WalkerError: the arrays do not fit the people here.
        """
        count = len(self._ids)
        states, times = _checked(states, count), np.asarray(times, dtype=float)
        if len(paths) != count or times.shape != (count,):
            raise WalkerError(f"{count} walkers need as many paths and times.")
        targets = np.zeros((count, N_JOINTS))
        if not count:
            return targets
        reference, people = self._reference, self._people
        assert reference is not None and people is not None
        motion = Motion.of_states(states, self.hinges)
        pelvis = states[:, 0, :2]
        clear = clearance(motion.sole_points(people.soles), self.height_at)
        aims = paths.at(times + reference.preview)
        reference.advance(aims, pelvis, motion.positions[:, FEET], touching(clear))
        way = heading(states[:, 0, 3:7])
        maps = None
        if self.config.map:
            velocity = states[:, 0, 7:9]
            maps = draw_local_maps(pelvis, way, velocity, self._seen_heights, self.config.map)
        seen = observe(
            motion,
            people,
            reference,
            reference.follower.told(paths.at(times), paths.waypoints(times)),
            clear,
            self.hinges,
            self.config.body_aware,
            maps,
        )
        mirrored = reference.steps["phase"] >= 0.5
        seen[mirrored] = self._mirror.observations(seen[mirrored])
        self._seen = torch.from_numpy(seen)
        aside = np.stack([-way[:, 1], way[:, 0]], -1) * np.where(mirrored, -1.0, 1.0)[:, None]
        self._axes = torch.from_numpy(np.stack([way, aside], 1)).float()
        self._pelvis = torch.from_numpy(pelvis.copy()).float()
        actions = self._model.act(self._seen).numpy()
        actions[mirrored] = self._mirror.actions(actions[mirrored])
        config, hinges = self.config, self.hinges
        pose = reference.targets(hinges, config.lead)
        pose[:, self._driven] += config.action_scale * actions
        targets[:, hinges] = pose
        return targets

    def values(self, plans: Tensor) -> Tensor:
        """How well plans could be walked from where everybody was at the last step.

        The critic's value (PACER, sec 3.3, "value function as guidance"): discounted reward over the largest
        possible, with only the waypoints of the observation replaced. Gradients reach the plans.

        Args:
            plans: (N, S, 10, 2) m, world: S plans each, from 0.5 s to 5 s ahead.

        Returns:
            (N, S), mostly between 0 and 1.

        Raises:
            WalkerError: no step has been made with these people, or the plans do not fit.
        """
        count = len(self._ids)
        if len(self._seen) != count:
            raise WalkerError("Values are about the last step; there was none with these people.")
        if plans.ndim != 4 or plans.shape[0] != count or plans.shape[2:] != (HORIZON, 2):
            raise WalkerError(f"Plans for {count} walkers have shape ({count}, S, {HORIZON}, 2).")
        seen = self._seen[:, None].expand(-1, plans.shape[1], -1)
        gap = plans - self._pelvis[:, None, None]
        told = torch.einsum("nstk,nak->nsta", gap, self._axes).flatten(2).clamp(-LIMIT, LIMIT)
        whole = torch.cat([seen[..., : WAYPOINTS.start], told], -1)
        return self._model.critic(self._model.normalizer(whole))[..., 0]


def _checked(states: ArrayLike, count: int) -> Array:
    states = np.asarray(states, dtype=float)
    if states.shape != (count, N_BODIES, 13):
        raise WalkerError(f"{count} walkers need states ({count}, {N_BODIES}, 13), not {states.shape}.")
    return states
