"""Distillation: a network learns to take in a few long steps the way another one takes in many short ones.

Of a network that was trained to denoise, few steps are the mean of what might follow: actions are smoothed, and
people who have not yet settled who goes first walk into each other. Its deterministic sampling is a function from
noise to futures, though, and a function can be learned: at each of a few steps the student predicts the clean
actions with which one step of DDIM leads to where the teacher gets in many (Salimans and Ho 2022, with all steps at
once instead of halving their number again and again). The teacher's two network calls for the weight w of
classifier-free sampling become one (Meng et al. 2023).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .config import DISTILLED_STEPS
from .context import Context
from .diffusion import CosineSchedule, DPMSolver2M
from .network import Trace
from .training import APART, action_errors, intrusion, overlap, state_errors

_FINE = 5  # steps of the schedule that one of the teacher's spans, at most
_FINEST = 2  # and that one spans within the student's first step

_INTRUSION = 0.1
"""Weight of obstacles beside people."""

_PACE = 2.0
"""Weight of the squared error of the mean speed of a batch of people."""


@dataclass(frozen=True)
class Paths:
    """Ways of B people, N steps each, from noise to clean actions.

    Attributes:
        context: What is known of them; everybody of some moments.
        noisy: (B, N, horizon, 2) normalised actions at each of the student's steps.
        clean: (B, N, horizon, 2) what the student has to predict there.
    """

    context: Context
    noisy: Tensor
    clean: Tensor


def teacher_timesteps(timesteps: Sequence[int], stride: int = _FINE, first: int = _FINEST) -> list[int]:
    """The steps between: the student's, and more so that none are further than `stride` apart, down to 1.

    Within the student's first step, where the share of signal grows many times over, none are further than `first`.
    """
    fine: list[int] = []
    for i, (k, after) in enumerate(zip(timesteps, [*timesteps[1:], 0], strict=True)):
        count = -(-(k - after) // (stride if i else first))
        fine += [round(k + (after - k) * j / count) for j in range(count)]
    return fine


@torch.no_grad()
def teacher_paths(
    teacher: Trace,
    schedule: CosineSchedule,
    context: Context,
    generator: torch.Generator,
    timesteps: Sequence[int] = DISTILLED_STEPS,
    weight: float = 0.5,
) -> Paths:
    """Follow the teacher from noise.

    Args:
        teacher: A denoiser, prepared for inference.
        schedule: Noise schedule.
        context: B people.
        generator: Draws the noise.
        timesteps: The student's.
        weight: w of classifier-free sampling.
    """
    encodings = [teacher.encode(context), teacher.encode(context.unconditional())]
    solver = DPMSolver2M(schedule, teacher_timesteps(timesteps))
    noisy = torch.randn(len(context), teacher.config.horizon, 2, generator=generator)
    passed, estimate = [], None
    for i, k in enumerate(solver.timesteps):
        if k in timesteps:
            passed.append(noisy)
        steps = torch.full((len(context),), k)
        given, free = (teacher(noisy, steps, e, estimate=estimate) for e in encodings)
        estimate = schedule.classifier_free(given, free, noisy, k, weight)
        noisy = solver.step(estimate, noisy, i)
    pairs = zip(timesteps, passed, timesteps[1:], passed[1:], strict=False)
    clean = [schedule.clean_between(before, k, after, j) for k, before, j, after in pairs]
    return Paths(context, torch.stack(passed, 1), torch.stack([*clean, noisy], 1))


class DistilledStep(nn.Module):
    """Context encoders and all steps of the student in a single call, as data-parallel training wants it."""

    def __init__(self, trace: Trace):
        super().__init__()
        self.trace = trace

    def forward(self, paths: Paths, timesteps: Sequence[int]) -> Tensor:
        """Predicted clean actions (B, N, horizon, 2), each step with the one before as its estimate."""
        encoding = self.trace.encode(paths.context)
        count, later = len(paths.context), len(timesteps) - 1
        first = self.trace(paths.noisy[:, 0], torch.full((count,), timesteps[0]), encoding)
        rest = self.trace(
            paths.noisy[:, 1:].flatten(0, 1),
            torch.tensor(timesteps[1:]).repeat(count),
            encoding.repeat(later),
            estimate=paths.clean[:, :-1].flatten(0, 1),
        )
        return torch.cat([first[:, None], rest.unflatten(0, (count, later))], 1)


def distillation_loss(
    model: nn.Module,
    trace: Trace,
    schedule: CosineSchedule,
    paths: Paths,
    timesteps: Sequence[int] = DISTILLED_STEPS,
    balance: float = 0.0,
    touch: float = 0.0,
    calm: float = 0.0,
    radius: float = 0.4,
) -> Tensor:
    """Errors of the student along the teacher's paths; the weights are those of `training.denoising_loss`.

    Where the teacher leads people into each other or into obstacles the student need not follow: discs are to stay
    apart, whatever it did. The easiest way to that is to slow down, so the crowd as a whole keeps the teacher's pace.

    Args:
        model: `DistilledStep(trace)` or a data-parallel wrapper of it.
        trace: The student.
        schedule: Noise schedule.
        paths: Of B people.
        timesteps: The student's.
        balance: Power of signal / noise by which errors weigh.
        touch: Weight of discs that overlap others or obstacles at the last step.
        calm: Weight of absolute errors of actions where people have settled.
        radius: Of people's discs [m].
    """
    predicted = model(paths, timesteps).float()
    state = paths.context.initial_state()[:, None].expand(-1, len(timesteps), -1)
    guess, truth = trace.unroll(predicted, state), trace.unroll(paths.clean, state)
    a = schedule.alphas_cumprod[list(timesteps)]
    loss = state_errors(trace, guess, truth, a, balance) + calm * action_errors(predicted, paths.clean, a)
    if not touch:
        return loss
    depth = _INTRUSION * intrusion(guess[:, -1], paths.context, radius)
    if paths.context.rows is not None:
        depth = depth + overlap(guess[:, -1], None, paths.context, 2 * radius + APART)
    slower = (truth - guess)[:, -1, :, 3].mean(0) / trace.trajectory_std[3]
    return loss + touch * depth.mean() + _PACE * slower.square().mean()
