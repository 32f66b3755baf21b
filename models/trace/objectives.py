"""What a user may ask of a trajectory: one small differentiable loss per objective, found by name.

A loss takes a `Future` and its own parameters and returns (A, M): a sum for each agent and sample, zero
when the wish is met. Nothing is averaged over agents or samples, so a weight means the same for one agent
and for a hundred. A new objective is one decorated function:

    @objective("stay_left")
    def stay_left(future: Future, y: float = 0.0) -> Tensor:
        return torch.relu(y - future.positions[..., 1]).sum(-1)
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import lru_cache
from inspect import signature
from math import isfinite
from typing import Any

import torch
from torch import Tensor

from .scene_map import SceneMaps


class ObjectiveError(ValueError):
    """An objective that does not exist, or parameters that do not fit it."""


@dataclass(frozen=True)
class Future:
    """Predicted futures of the A agents of one scene, M samples each; sample m of everybody is one scene.

    Attributes:
        states: (A, M, T, 4) world x, y [m], heading [rad], speed [m/s]; the first one is one `dt` from now.
        now: (A, 4) current states.
        radius: (A,) discs of the agents [m].
        dt: Time between states [s].
        maps: Signed distance fields; the agents stand on the map of number `scene`, None where unknown.
        scene: Number of the agents' map.
        seed: Of objectives that draw something; constant over one plan.
        ids: Numbers of the agents in the caller's world, for objectives that know more about somebody.
        settled: These are what everybody will follow, no longer samples to be denoised: a soft minimum may be sharp.
    """

    states: Tensor
    now: Tensor
    radius: Tensor
    dt: float = 0.1
    maps: SceneMaps | None = None
    scene: int = 0
    seed: int = 0
    ids: tuple[int, ...] = ()
    settled: bool = False

    @property
    def positions(self) -> Tensor:
        """(A, M, T, 2) world x, y [m]."""
        return self.states[..., :2]

    def clearance(self, points: Tensor) -> Tensor:
        """Signed distance [m] from world points (..., 2) to the obstacles; far away without a map."""
        if self.maps is None:
            return torch.full_like(points[..., 0], 1e3)
        flat = points.reshape(1, -1, 2)
        return self.maps.layer("obstacle").sample(flat, self._scene).reshape(points.shape[:-1])

    def clearance_and_way_out(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The same without a graph, and its gradient (..., 2): away from the obstacles, zero without a map."""
        if self.maps is None:
            return self.clearance(points.detach()), torch.zeros_like(points)
        flat = points.reshape(1, -1, 2)
        distance, slope = self.maps.layer("obstacle").sample_slopes(flat, self._scene)
        return distance.reshape(points.shape[:-1]), slope.reshape(points.shape)

    @property
    def _scene(self) -> Tensor:
        return torch.tensor([self.scene])

    def sloped(self, loss: Tensor, slope: Tensor) -> Tensor:
        """A loss (A, M) that carries its gradient (A, M, T, 2) with respect to the positions.

        For losses that write their gradient out: of tensors this small recording and replaying costs more than
        computing. There are no second derivatives, and none with respect to others' positions.
        """
        return _Sloped.apply(self.positions, loss, slope)


class _Sloped(torch.autograd.Function):
    """The loss as it is; backwards the slope that comes with it."""

    @staticmethod
    def forward(ctx: Any, positions: Tensor, loss: Tensor, slope: Tensor) -> Tensor:
        ctx.save_for_backward(slope)
        return loss

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        (slope,) = ctx.saved_tensors
        return grads[0][..., None, None] * slope, None, None


Loss = Callable[..., Tensor]


@dataclass(frozen=True)
class Kind:
    """A registered objective: its loss, whether agents depend on each other through it, whether it is safety.

    `buffered`: it is safety and its parameter `buffer` is room beyond touching. `untimed`: its parameter `goal` may
    be reached at any time.
    """

    loss: Loss
    joint: bool
    safety: bool
    buffered: bool
    untimed: bool


OBJECTIVES: dict[str, Kind] = {}


def objective(
    name: str, joint: bool = False, safety: bool = False, untimed: bool = False
) -> Callable[[Loss], Loss]:
    """Register a loss under a name.

    Args:
        name: What users write.
        joint: The loss of one agent depends on the futures of others; then samples are chosen for a whole
            scene.
        safety: Nobody is to be hurt: these have the last word when a chosen sample is polished.
        untimed: It leads to a `goal`, which may be reached at any time: see `Guidance.haste`.
    """

    def register(loss: Loss) -> Loss:
        buffered = safety and "buffer" in signature(loss).parameters
        OBJECTIVES[name] = Kind(loss, joint, safety, buffered, untimed)
        return loss

    return register


@dataclass(frozen=True)
class Objective:
    """One wish.

    Attributes:
        name: Of a registered loss.
        parameters: Handed to the loss by name. A (A, ...) tensor with NaN rows leaves those agents out.
        weight: Its share when several objectives pull; a number, or (A,) one for each agent. With 0 it does
            not pull.

    Raises:
        ObjectiveError: When no loss has this name or a weight is negative.
    """

    name: str
    parameters: dict[str, Any] = field(default_factory=dict)
    weight: float | Tensor = 1.0

    def __post_init__(self):
        if not isinstance(self.name, str) or self.name not in OBJECTIVES:
            close = get_close_matches(str(self.name), OBJECTIVES, 1)
            hint = (
                f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(sorted(OBJECTIVES))}"
            )
            raise ObjectiveError(f"there is no objective {self.name!r}{hint}")
        with self._named():
            share = self.share
        if not bool((torch.isfinite(share) & (share >= 0)).all()):
            raise ObjectiveError(
                f"the weight of {self.name!r} must be finite and not negative, it is {self.weight}"
            )

    @property
    def joint(self) -> bool:
        """Whether agents depend on each other through it."""
        return OBJECTIVES[self.name].joint

    @property
    def safety(self) -> bool:
        """Whether it has the last word."""
        return OBJECTIVES[self.name].safety

    @property
    def buffered(self) -> bool:
        """Whether it keeps a `buffer` beyond touching, without which it is about touching alone."""
        return OBJECTIVES[self.name].buffered

    def led(self, agents: int) -> Tensor:
        """(A, 1) who is led to a goal that may be reached at any time.

        Raises:
            ObjectiveError: When the goal does not fit the agents.
        """
        goal = self.parameters.get("goal")
        if goal is None or not OBJECTIVES[self.name].untimed:
            return torch.zeros(agents, 1, dtype=torch.bool)
        with self._named():
            return per_agent(goal, agents, 1)[1] & (self.share > 0)

    @property
    def share(self) -> Tensor:
        """The weight as (A, 1), or (1, 1) where it is the same for all."""
        return torch.as_tensor(self.weight, dtype=torch.float32).reshape(-1, 1)

    def goals(self, agents: int) -> tuple[Tensor, Tensor] | None:
        """Goals (A, 2) [m] and (A,) who has one; None of objectives without goals.

        Raises:
            ObjectiveError: When goals or weights do not fit the agents.
        """
        with self._named():
            if len(self.share) not in (1, agents):
                raise ObjectiveError(f"there are {len(self.share)} weights for {agents} agents")
            if (goal := self.parameters.get("goal")) is None:
                return None
            goals, given = per_agent(goal, agents, 1)
            return goals[:, 0], given[:, 0]

    def loss(self, future: Future) -> Tensor:
        """(A, M) unweighted losses.

        Raises:
            ObjectiveError: When the parameters do not fit the loss.
        """
        with self._named():
            return OBJECTIVES[self.name].loss(future, **self.parameters)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Whatever does not fit is said to be of this objective."""
        try:
            yield
        except (TypeError, ValueError, IndexError, RuntimeError) as error:  # also torch's, of several lines
            reason = str(error).partition("\n")[0]
            raise ObjectiveError(f"objective {self.name!r}: {reason}") from error


def per_agent(values: Tensor | float, agents: int, inner: int = 0) -> tuple[Tensor, Tensor]:
    """A parameter for each agent (A, 1, ...), and (A, 1) whether the agent has one (no NaN).

    Args:
        values: One for all, or with a first axis of A.
        agents: A.
        inner: Axes of one agent's value: 0 for a number, 1 for a point.

    Raises:
        ObjectiveError: On another shape.
    """
    value = torch.as_tensor(values, dtype=torch.float32)
    if value.ndim == inner:
        value = value.expand(agents, *value.shape)
    if value.ndim != inner + 1 or len(value) != agents:
        raise ObjectiveError(
            f"a parameter has the shape {tuple(value.shape)}; it must have {inner} axes, or {inner + 1} of which "
            f"the first counts the {agents} agents"
        )
    if inner and value.shape[-1] != 2:
        raise ObjectiveError(
            f"a place has the {value.shape[-1]} coordinates of {tuple(value.shape)}; it must have 2"
        )
    if isfinite(float(value.sum())):  # looked up at every step: this is the quickest way to see that all are
        return value.reshape(agents, 1, *value.shape[1:]), _everybody(agents)
    given = torch.isfinite(value.reshape(agents, -1)).all(-1)
    value = torch.where(given.reshape(-1, *[1] * inner), value, 0.0)
    return value.reshape(agents, 1, *value.shape[1:]), given[:, None]


@lru_cache(maxsize=8)
def _everybody(agents: int) -> Tensor:
    return torch.ones(agents, 1, dtype=torch.bool)
