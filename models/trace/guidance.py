"""Test-time guidance: how gradients of the objectives bend the denoising (Rempe et al. 2023, sec. 3.1.2)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from . import guidance_losses  # noqa: F401  registers the objectives
from .objectives import Future, Objective


class GuidanceError(ValueError):
    """A guidance setting is out of range."""


@dataclass(frozen=True)
class Guidance:
    """Where gradients are taken, and how far a step goes.

    Attributes:
        mode: `clean` is eq 6: the loss of the clean prediction, its gradient with respect to the noisy input,
            through the network. `noisy` is eq 5: loss and gradient at the noisy mean. `direct` stays in the
            space of clean actions, through the dynamics alone: many times cheaper, so it can afford several
            steps.
        scale: Of a step: `variance` times Sigma_k as printed, `unit` without it, or `polyak`: loss /
            |gradient|^2,
            the step to the zero of the linearised loss, which needs no tuning because every loss has
            minimum 0.
        strength: alpha; for `polyak` between 0 and 2.
        inner_steps: Steps per denoising step in mode `direct`; none at the last one where samples are polished, as
            no denoising would mend what they do to all samples there.
        limit: Longest step of one sample's actions, root mean square over the horizon, in standard
            deviations.
        polish: More steps for the chosen samples at the end, in mode `direct`, and up to twice as many for the
            objectives of safety alone.
        tries: How often whoever is still far from what they are asked tries again, in mode `direct`, while all others
            keep to what they have chosen: from a part of the noise, over their own way and ways in all directions.
        temperature: Factor of the noise that sampling begins with: objectives spread futures by themselves.
        haste: People led to goals that they may reach at any time hurry there, as samples are chosen that get there.
            So much is taken off their accelerations during the first half of the horizon, and half of it given
            back during the second [m/s^2].
        met: A loss up to this needs no step.
        speeds: Guided futures keep between these speeds [m/s]: nobody is made to walk backwards or to race. Who walks
            faster already need not slow down for it; nobody in simulated crowds walks faster than 2 m/s.
    """

    mode: Literal["clean", "noisy", "direct"] = "direct"
    scale: Literal["variance", "unit", "polyak"] = "polyak"
    strength: float = 1.0
    inner_steps: int = 1
    limit: float = 1.0
    polish: int = 6
    tries: int = 0
    temperature: float = 1.0
    haste: float = 0.0
    met: float = 0.0
    speeds: tuple[float, float] = (0.0, 2.2)

    def __post_init__(self):
        if self.mode not in ("clean", "noisy", "direct") or self.scale not in ("variance", "unit", "polyak"):
            raise GuidanceError(f"there is no guidance mode {self.mode!r} with scale {self.scale!r}")
        if not all(isinstance(count, int) for count in (self.polish, self.tries, self.inner_steps)):
            raise GuidanceError("guidance polish, tries and inner_steps must be whole numbers")
        if min(self.polish, self.tries) < 0 or self.inner_steps < 1:
            raise GuidanceError("guidance polish and tries must be >= 0, inner_steps >= 1")
        if not (0 <= self.strength < math.inf and 0 < self.limit < math.inf):
            raise GuidanceError("guidance strength must be finite and >= 0, limit finite and > 0")
        if not 0 <= self.haste < math.inf:
            raise GuidanceError(f"guidance haste must be >= 0 m/s^2, not {self.haste}")
        if not 0 < self.temperature < math.inf:
            raise GuidanceError(f"guidance temperature must be > 0, not {self.temperature}")
        if not 0 <= self.speeds[0] < self.speeds[1]:
            raise GuidanceError(f"guidance speeds must be a range from 0 m/s upwards, not {self.speeds}")

    @property
    def polishes(self) -> bool:
        """Whether chosen samples get steps of their own at the end."""
        return self.mode == "direct" and self.polish > 0

    def step(self, loss: Tensor, gradient: Tensor, variance: Tensor) -> Tensor:
        """What is subtracted from the actions.

        Args:
            loss: (A, M) weighted losses.
            gradient: (A, M, T, 2) of the summed losses.
            variance: Sigma_k of the denoising step.
        """
        if self.scale == "polyak":
            square = gradient.square().sum((2, 3))
            step = gradient * (loss / square.clamp(min=1e-12))[..., None, None]
        else:
            step = gradient * (variance if self.scale == "variance" else 1.0)
        if self.strength != 1.0:
            step = self.strength * step
        size = step.square().mean((2, 3), keepdim=True).sqrt()
        return step * (self.limit / size.clamp(min=self.limit))


_LEAST_PACE = 0.2  # careful steps shorter than this share of a whole one are not worth taking
_GAIN = 0.9  # of a loss: a careful step that leaves more is the last one of its length
_LARGE_GAIN = 0.35  # a careful step that leaves less may be twice as long next time
_LONGEST_PACE = 2.0

FutureOf = Callable[[Tensor], Future]


def total_loss(objectives: Sequence[Objective], future: Future) -> Tensor:
    """(A, M) weighted sum of the losses."""
    return torch.stack([o.share * o.loss(future) for o in objectives]).sum(0)


def guide_direct(
    clean: Tensor,
    future_of: FutureOf,
    objectives: Sequence[Objective],
    guidance: Guidance,
    variance: Tensor,
    careful: bool = False,
) -> Tensor:
    """Clean actions (A, M, T, 2) after cyclic steps for one objective after the other, through the dynamics.

    With the Polyak scale these are projections: each step is the smallest change of the actions that meets
    the linearised wish. In turn they do better than all at once, as with any projections onto several sets.
    A weight shortens (below 1) or lengthens the steps of an objective. Where a loss cannot become zero, such a
    step leaps once its gradient vanishes: denoising mends that, at its end only `careful` steps do, which are
    taken by those alone whose loss falls; for those whose loss falls little, the next one is a quarter as long, for
    those whose loss falls far twice as long.
    """
    pace = [torch.ones(()).expand(clean.shape[:2])] * len(objectives)
    for _ in range(guidance.inner_steps):
        before, actions, future = clean, clean, None
        for i, wish in enumerate(objectives):
            if not (pace[i] > _LEAST_PACE).any():
                continue
            with torch.enable_grad():
                if future is None:
                    actions = clean.detach().requires_grad_()
                    future = future_of(actions)
                loss = wish.loss(future)
                if not ((loss > guidance.met) & (pace[i] > _LEAST_PACE)).any():
                    continue  # nothing moved: the next objective looks at the same future
                gradient = gradient_of(loss, actions)
            length = (wish.share * pace[i])[..., None, None]
            moved = clean - length * guidance.step(loss.detach(), gradient, variance)
            future = None
            if careful:
                with torch.enable_grad():
                    actions = moved.detach().requires_grad_()
                    future = future_of(actions)
                with torch.no_grad():
                    left = wish.loss(future)
                pace[i] = _paced(pace[i], left / loss.detach().clamp(min=1e-12))
                better = left < loss.detach()
                if not better.all():
                    future = None
                    moved = torch.where(better[..., None, None], moved, clean)
            clean = moved
        if clean is before:
            break
    return clean.detach()


def _paced(pace: Tensor, left: Tensor) -> Tensor:
    """How long (A, M) the next careful step is, by the share of the loss that was left after the last.

    Of squared distances a Polyak step leaves a quarter, and one of twice the length nothing.
    """
    pace = torch.where(left < _GAIN, pace, pace / 4)
    return torch.where(left < _LARGE_GAIN, (2 * pace).clamp(max=_LONGEST_PACE), pace)


def gradient_of(loss: Tensor, actions: Tensor) -> Tensor:
    """Gradient of the summed loss; zero where it does not depend on the actions or is not finite."""
    if not loss.requires_grad:
        return torch.zeros_like(actions)
    (gradient,) = torch.autograd.grad(loss.sum(), actions, allow_unused=True, materialize_grads=True)
    return gradient.nan_to_num(0.0, 0.0, 0.0)
