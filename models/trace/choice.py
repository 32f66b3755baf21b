"""Which of its samples everybody takes: the paper's filter, and better mixtures of samples than it finds."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .guidance import FutureOf
from .objectives import Future, Objective

SAFE = 1e-3
"""A loss of safety up to this is none: a millimetre in an obstacle, a thousandth of a disc in another."""

_HARM = 100.0  # weight of what overlaps for real when a sample is chosen anew
_SOON = 1.5  # s, in which harm counts ten times
_REGRET = 0.01
"""A loss, or one above that of one's best sample, that is worth a look: 10 cm of a waypoint, squared."""


def choose_samples(losses: dict[str, Tensor], objectives: Sequence[Objective]) -> Tensor:
    """Filtering (app. A.2.1): the sample with the lowest loss, per agent, or per scene if agents interact.

    Args:
        losses: (A, M) by objective name.
        objectives: With their weights.

    Returns:
        (A,) sample numbers.
    """
    total = torch.stack([wish.share * losses[label] for label, wish in labelled(objectives)]).sum(0)
    if any(wish.joint for wish in objectives):
        return total.sum(0).argmin().expand(len(total))
    return total.argmin(1)


def harm(objectives: Sequence[Objective], future: Future) -> Tensor:
    """(A, M) losses of safety without the room that is kept beyond touching: 0 where nothing overlaps.

    What happens soon counts ten times: of the rest the next plan has another look.
    """
    soon = replace(future, states=future.states[:, :, : round(_SOON / future.dt)])
    total = torch.zeros(future.states.shape[:2])
    for wish in objectives:
        if wish.buffered:
            bare = replace(wish, parameters=wish.parameters | {"buffer": 0.0})
            if (loss := bare.loss(future)).any():
                total = total + (loss + 9 * bare.loss(soon)) * (wish.share > 0)
    return total


def judge(objectives: Sequence[Objective], future: Future) -> dict[str, Tensor]:
    """Losses (A, M) by label."""
    return {label: wish.loss(future) for label, wish in labelled(objectives)}


def _safe(objectives: Sequence[Objective], losses: dict[str, Tensor]) -> bool:
    """Whether not even the room beyond touching is taken by anybody: then there is no `harm` either."""
    return not any((losses[label] > SAFE).any() for label, wish in labelled(objectives) if wish.buffered)


def where_no_worse(
    best: Tensor, before: Future, future_of: FutureOf, objectives: Sequence[Objective]
) -> tuple[Future, dict[str, Tensor], Tensor]:
    """Of polished actions (A, 1, T, 2) what harms nobody more than before.

    Returns:
        The future, its losses (A, 1) by label, and (A,) who keeps what was polished.
    """
    kept = torch.ones(len(best), dtype=torch.bool)
    with torch.no_grad():
        after = future_of(best)
        losses = judge(objectives, after)
        if _safe(objectives, losses):
            return after, losses, kept
        bound = harm(objectives, before) + SAFE
        while True:
            states = torch.where(kept[:, None, None, None], after.states, before.states)
            mixed = replace(after, states=states)
            worse = kept & (harm(objectives, mixed) > bound)[:, 0]
            if not worse.any():
                return mixed, losses if kept.all() else judge(objectives, mixed), kept
            kept &= ~worse


class _Mixture:
    """A scene in which everybody follows a sample of their own.

    Args:
        chosen: (A,) sample numbers.
        alone: (A, M) what each sample costs by itself.
        objectives: With their weights.
        future: Of all samples.
        harm: Weight of the `harm` that people do each other.
    """

    def __init__(
        self,
        chosen: Tensor,
        alone: Tensor,
        objectives: Sequence[Objective],
        future: Future,
        harm: float = 0.0,
    ):
        self.chosen, self._alone, self._future, self._harm = chosen.clone(), alone, future, harm
        self._together = [wish for wish in objectives if wish.joint]
        self._kept = future.states[torch.arange(len(chosen)), chosen][:, None]  # (A, 1, T, 4)

    def mutual(self) -> Tensor:
        """(A,) harm that people do each other."""
        return harm(self._together, replace(self._future, states=self._kept))[:, 0]

    def improve(self, row: int, options: Tensor) -> None:
        """Let one take that of some samples which is best for all while all others keep theirs."""
        states = self._kept.repeat(1, len(options), 1, 1)
        states[row] = self._future.states[row, options]
        mixed = replace(self._future, states=states)
        cost = self._alone[row, options]
        cost = cost + sum((wish.share * wish.loss(mixed)).sum(0) for wish in self._together)
        if self._harm:
            cost = cost + self._harm * harm(self._together, mixed).sum(0)
        best = options[cost.argmin()]
        self.chosen[row], self._kept[row, 0] = best, self._future.states[row, best]


@torch.no_grad()
def regroup(
    chosen: Tensor, losses: dict[str, Tensor], objectives: Sequence[Objective], future: Future
) -> Tensor:
    """Who has a far better sample than the one chosen for the whole scene takes it, unless others pay for it.

    The more people a scene has, the less likely it is that one of ten samples of it suits them all.

    Args:
        chosen: (A,) sample numbers.
        losses: (A, M) by label.
        objectives: With their weights.
        future: Of all samples.

    Returns:
        (A,) sample numbers.
    """
    alone = _alone(losses, objectives)
    gain = alone.gather(1, chosen[:, None]) - alone
    better = gain > _REGRET
    mixture = _Mixture(chosen, alone, objectives, future)
    for row in gain.max(1).values.argsort(descending=True)[: int(better.any(1).sum())].tolist():
        mixture.improve(row, torch.cat([chosen[row : row + 1], better[row].nonzero()[:, 0]]))
    return mixture.chosen


@torch.no_grad()
def reconsider(
    chosen: Tensor, losses: dict[str, Tensor], objectives: Sequence[Objective], future: Future
) -> Tensor:
    """Who would come to harm in the chosen scene takes another sample while all others keep theirs.

    Of ten scenes of many people none may be without a mishap, though everybody has a sample without; and the sum
    of the losses would pay for a touch with a little more room elsewhere.

    Arguments and result are those of `regroup`.
    """
    rows = torch.arange(len(chosen))
    if _safe(objectives, {label: loss[rows, chosen] for label, loss in losses.items()}):
        return chosen
    kept = future.states[rows, chosen][:, None]  # (A, 1, T, 4)
    if not (harm(objectives, replace(future, states=kept)) > SAFE).any():
        return chosen
    own_harm = harm([wish for wish in objectives if not wish.joint], future)
    alone = _alone(losses, objectives) + _HARM * own_harm
    mixture = _Mixture(chosen, alone, objectives, future, _HARM)
    settled = torch.zeros(len(rows), dtype=torch.bool)
    while True:
        risk = (own_harm[rows, mixture.chosen] + mixture.mutual()).masked_fill(settled, 0.0)
        row = int(risk.argmax())
        if not risk[row] > SAFE:
            return mixture.chosen
        mixture.improve(row, torch.arange(alone.shape[1]))
        settled[row] = True


def unmet(chosen: Tensor, losses: dict[str, Tensor], objectives: Sequence[Objective]) -> Tensor:
    """(A,) whose chosen sample (A,) is far from what they alone are asked, by losses (A, M) by label."""
    return _alone(losses, objectives).gather(1, chosen[:, None])[:, 0] > _REGRET


def _alone(losses: dict[str, Tensor], objectives: Sequence[Objective]) -> Tensor:
    """(A, M) weighted losses that do not depend on others."""
    shares = [wish.share * losses[label] for label, wish in labelled(objectives) if not wish.joint]
    return torch.stack(shares).sum(0) if shares else torch.zeros_like(next(iter(losses.values())))


def labelled(objectives: Sequence[Objective]) -> list[tuple[str, Objective]]:
    """Objectives under unique labels: the name, numbered from the second of a kind on."""
    labels: list[tuple[str, Objective]] = []
    for wish in objectives:
        same = sum(other.name == wish.name for _, other in labels)
        labels.append((f"{wish.name}_{same + 1}" if same else wish.name, wish))
    return labels
