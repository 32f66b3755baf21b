"""From samples to what everybody follows: choose, polish the chosen ones, choose again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from .choice import SAFE, choose_samples, judge, reconsider, regroup, where_no_worse
from .guidance import FutureOf, Guidance, guide_direct
from .objectives import Future, Objective

_REACHED = 1e-4
"""A loss up to this needs no polish: a waypoint missed by a centimetre."""

_PACE = 1.0
"""Of those who set out for somewhere [m/s]."""

Bound = Callable[[Tensor], Tensor]
"""From actions (A, M, horizon, 2) to the nearest ones that may be."""


@dataclass
class Candidates:
    """The samples of a scene, and whose sample everybody takes.

    Attributes:
        actions: (A, M, horizon, 2) normalised.
        future: What follows from them.
        losses: (A, M) by label.
        chosen: (A,) sample numbers.
    """

    actions: Tensor
    future: Future
    losses: dict[str, Tensor]
    chosen: Tensor

    @classmethod
    def judged(
        cls,
        actions: Tensor,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        chosen: Tensor | None = None,
    ) -> "Candidates":
        """Of these actions; without a choice that of the paper, the first sample where nothing is asked."""
        with torch.no_grad():
            future = future_of(actions)
            losses = judge(objectives, future)
        if chosen is None:
            first = torch.zeros(len(actions), dtype=torch.long)
            chosen = choose_samples(losses, objectives) if objectives else first
        return cls(actions, future, losses, chosen)

    @property
    def own(self) -> Tensor:
        """(A, 1, horizon, 2) the chosen actions."""
        return self.actions[torch.arange(len(self.chosen)), self.chosen][:, None]

    def regroup(self, objectives: Sequence[Objective]) -> bool:
        """Let everybody take the sample that suits them; whether anybody changes."""
        before, self.chosen = self.chosen, regroup(self.chosen, self.losses, objectives, self.future)
        return not torch.equal(self.chosen, before)

    def reconsider(self, objectives: Sequence[Objective]) -> None:
        """Let whoever would come to harm take another sample."""
        self.chosen = reconsider(self.chosen, self.losses, objectives, self.future)

    def polish(
        self, future_of: FutureOf, objectives: Sequence[Objective], guidance: Guidance, bound: Bound
    ) -> None:
        """Polish the chosen sample of everybody, in place, where that harms nobody."""
        rows, chosen = torch.arange(len(self.chosen)), self.chosen
        before = replace(self.future, states=self.future.states[rows, chosen][:, None])
        best = polished(self.own, future_of, objectives, guidance, bound)
        better, losses, kept = where_no_worse(best, before, future_of, objectives)
        self.actions[rows[kept], chosen[kept]] = best[kept, 0]
        self.future.states[rows, chosen] = better.states[:, 0]
        for label, loss in losses.items():
            self.losses[label][rows, chosen] = loss[:, 0]


def polished(
    actions: Tensor, future_of: FutureOf, objectives: Sequence[Objective], guidance: Guidance, bound: Bound
) -> Tensor:
    """Actions (A, 1, horizon, 2) after `guidance.polish` steps towards what is asked, safety last."""
    none = torch.zeros(())

    def settled(actions: Tensor) -> Future:
        return replace(future_of(actions), settled=True)

    in_turn = replace(guidance, inner_steps=guidance.polish, met=_REACHED)
    safety = replace(guidance, inner_steps=2 * guidance.polish, met=SAFE)
    best = bound(guide_direct(actions, settled, objectives, in_turn, none, careful=True))
    wishes = [wish for wish in objectives if wish.safety]
    return bound(guide_direct(best, settled, wishes, safety, none, careful=True))


def setting_out(speed: Tensor, samples: int, horizon: int, dt: float) -> Tensor:
    """Turns within a second, in each of M samples in another direction, and then straight on at a usual pace.

    Args:
        speed: (A,) now [m/s].
        samples: M.
        horizon: Actions.
        dt: Between them [s].

    Returns:
        (A, M, horizon, 2) acceleration [m/s^2] and yaw rate [rad/s].
    """
    second = round(1 / dt)
    actions = torch.zeros(len(speed), samples, horizon, 2)
    actions[:, :, :second, 0] = (_PACE - speed)[:, None, None]
    actions[:, :, :second, 1] = (torch.pi * (2 * torch.arange(samples) + 1 - samples) / samples)[:, None]
    return actions
