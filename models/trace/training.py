"""The training objective of TRACE, the input statistics, and the moving average of the weights."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from .context import Context, from_frame
from .diffusion import CosineSchedule
from .network import Trace
from .windows import CrowdWindows

_READS_ESTIMATE = 0.5  # share of steps that learn with an estimate (Chen et al. 2023)
APART = 0.05  # room that people keep beyond their discs [m]
_SETTLED = 8  # power of the clean signal's share by which overlaps and trembling count: late on


def denoising_loss(
    model: nn.Module,
    trace: Trace,
    schedule: CosineSchedule,
    context: Context,
    actions: Tensor,
    generator: torch.Generator,
    drop: float = 0.1,
    balance: float = 0.0,
    touch: float = 0.0,
    calm: float = 0.0,
    radius: float = 0.4,
) -> Tensor:
    """Mean squared error of the predicted clean states and actions, normalised (TRACE eq 3, app. A.1.1).

    Args:
        model: `trace`, or a data-parallel wrapper of `DenoisingStep(trace)`.
        trace: Holds the statistics and the dynamics.
        schedule: Noise schedule.
        context: B samples.
        actions: (B, horizon, 2) true actions, SI units.
        generator: Draws steps, noise and drop-outs.
        drop: Probability with which the map, and independently the neighbours, are dropped.
        balance: Errors at step k weigh (signal / noise)^balance, within 0.3 to 10. 0 is the paper's, which
            lets the noisiest steps rule; with 1 all steps weigh about alike.
        touch: Weight of `overlap`, of whole scenes; the paper has none.
        calm: Weight of the absolute errors of actions where people have settled; the paper has none. Most of the
            time people walk straight on at the same speed, and squares hardly see a little trembling.
        radius: Of people's discs [m].
    """
    count = len(actions)
    lost = torch.rand(2, count, generator=generator) < drop
    context = context.drop(maps=lost[0], neighbors=lost[1])
    clean = trace.normalized(actions)
    if context.moment is None:
        k = torch.randint(len(schedule), (count,), generator=generator)
    else:
        k = torch.randint(len(schedule), (int(context.moment.max()) + 1,), generator=generator)
        k = k[context.moment]
    noise = torch.randn(clean.shape, generator=generator)
    state = context.initial_state()
    neighbors = None
    if trace.config.joint and context.neighbor_actions is not None:
        theirs = trace.normalized(context.neighbor_actions)
        neighbors = schedule.add_noise(theirs, torch.randn(theirs.shape, generator=generator), k)
    twice = trace.config.estimate and bool(torch.rand((), generator=generator) < _READS_ESTIMATE)
    predicted = model(schedule.add_noise(clean, noise, k), k, context, neighbors, twice)
    guess, truth = trace.unroll(predicted.float(), state), trace.unroll(clean, state)
    a = schedule.alphas_cumprod[k]
    loss = state_errors(trace, guess, truth, a, balance)
    if calm:
        loss = loss + calm * action_errors(predicted.float(), clean, a)
    if not touch or context.rows is None:
        return loss
    return loss + touch * (a.pow(_SETTLED) * overlap(guess, truth, context, 2 * radius + APART)).mean()


def state_errors(trace: Trace, guess: Tensor, truth: Tensor, a: Tensor, balance: float) -> Tensor:
    """Mean squared error of states and actions (..., T, 6) in standard deviations, (a / (1 - a))^(balance / 2) each.

    Args:
        trace: Holds the statistics.
        guess: Predicted.
        truth: True.
        a: (...,) share of the clean signal's variance.
        balance: 0 weighs all alike; weights are kept within 0.3 to 10.
    """
    weight = ((a / (1 - a)) ** (balance / 2)).clamp(0.3, 10.0) if balance else torch.ones(())
    return (weight * ((guess - truth) / trace.trajectory_std).square().mean((-2, -1))).mean()


def action_errors(guess: Tensor, truth: Tensor, a: Tensor) -> Tensor:
    """Mean absolute error of normalised actions (..., T, 2), where little noise is left: a^8 of (...,) a each."""
    return (a.pow(_SETTLED) * (guess - truth).abs().mean((-2, -1))).mean()


def overlap(guess: Tensor, truth: Tensor | None, context: Context, apart: float) -> Tensor:
    """How much nearer people are led to each other than they may be, and than they truly come: (B,) [m].

    A mean squared error hardly sees whether two discs just touch or just do not, which the eye sees first.

    Args:
        guess: (B, T, >= 2) predicted x, y, ego frame, of all people of some moments.
        truth: The same, true; None where everybody truly keeps apart.
        context: These people, among each other; who does not see somebody owes them nothing.
        apart: Distance of their centres from which on people may come no nearer [m].

    Returns:
        Summed over neighbours, averaged over time.
    """
    rows = context.rows
    assert rows is not None

    def distance(paths: Tensor) -> Tensor:
        world = from_frame(paths[..., :2], context.pose)
        return (world[rows] - world[:, None]).square().sum(-1).add(1e-6).sqrt()  # (B, N, T)

    allowed = apart if truth is None else distance(truth).clamp(max=apart)
    depth = torch.relu(allowed - distance(guess)) * context.neighbors[:, :, -1, 7, None]
    return depth.sum(1).mean(1)


def intrusion(guess: Tensor, context: Context, apart: float) -> Tensor:
    """How much nearer people are led to obstacles than they may be: (B,) [m], averaged over time; 0 without a map.

    Args:
        guess: (B, T, >= 2) predicted x, y, ego frame.
        context: These people.
        apart: Distance of their centres from which on obstacles may come no nearer [m].
    """
    if context.maps is None:
        return torch.zeros(len(guess))
    clearance = context.maps.layer("obstacle").sample(from_frame(guess[..., :2], context.pose), context.scene)
    return torch.relu(apart - clearance.reshape(guess.shape[:2])).mean(1) * context.map_known


def vary_observation(context: Context, generator: torch.Generator, late: float = 0.3) -> Context:
    """The same people seen otherwise, as they are seen in use and never in simulated crowds.

    Args:
        context: B samples.
        generator: Draws.
        late: Probability with which somebody came into sight at a random frame of the history only.

    Returns:
        A copy with shortened histories and bodies 0.4 m smaller to 0.2 m larger.
    """
    people = torch.cat([context.ego[:, None], context.neighbors], 1)  # (B, 1 + N, H, 8)
    count, rows, frames = people.shape[:3]
    first = torch.randint(frames, (count, rows, 1), generator=generator)
    first = first * (torch.rand(count, rows, 1, generator=generator) < late)
    seen = (torch.arange(frames) >= first)[..., None]
    size = torch.rand(count, rows, 1, 2, generator=generator) * 0.6 - 0.4
    people = (people + torch.nn.functional.pad(size, (5, 1)) * people[..., 7:]) * seen
    return replace(context, ego=people[:, 0], neighbors=people[:, 1:])


class DenoisingStep(nn.Module):
    """Context encoders and one denoising step in a single call, as data-parallel training wants it."""

    def __init__(self, trace: Trace):
        super().__init__()
        self.trace = trace

    def forward(
        self,
        noisy: Tensor,
        k: Tensor,
        context: Context,
        neighbors: Tensor | None = None,
        twice: bool = False,
    ) -> Tensor:
        """Predicted clean actions, see `Trace.forward`; `twice` predicts again with the first as its estimate."""
        encoding, estimate = self.trace.encode(context), None
        if twice:
            with torch.no_grad():
                estimate = self.trace(noisy, k, encoding, neighbors).detach()
        return self.trace(noisy, k, encoding, neighbors, estimate)


@torch.no_grad()
def fit_statistics(
    trace: Trace, sets: Sequence[CrowdWindows], generator: torch.Generator, windows: int = 8192
) -> None:
    """Set the model's means and deviations from random windows of the sets, all sets weighted alike."""
    trajectories, histories = [], []
    for data in sets:
        count = min(windows // len(sets), len(data))
        rows = torch.randint(len(data), (count,), generator=generator)
        context, actions = data.batch(rows)
        trace.trajectory_mean.zero_()
        trace.trajectory_std.fill_(1.0)
        trajectories.append(trace.unroll(actions, context.initial_state()).reshape(-1, 6))
        frames = torch.cat([context.ego[:, None], context.neighbors], 1).reshape(-1, 8)
        histories.append(frames[frames[:, 7] > 0])
    for name, rows in (("trajectory", trajectories), ("history", histories)):
        values = torch.cat(rows)
        deviation = values.std(0)
        getattr(trace, f"{name}_mean").copy_(values.mean(0))
        getattr(trace, f"{name}_std").copy_(torch.where(deviation > 1e-3, deviation, torch.ones(())))


class MovingAverage:
    """Exponential moving average of a model's parameters; its memory grows from nothing to `decay`."""

    def __init__(self, model: nn.Module, decay: float = 0.999):
        self.decay = decay
        self.parameters = {name: p.detach().clone() for name, p in model.named_parameters()}

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Move towards the model after optimiser step number `step`."""
        weight = 1 - min(self.decay, (1 + step) / (10 + step))
        for ours, theirs in zip(self.parameters.values(), model.parameters(), strict=True):
            ours.lerp_(theirs.detach(), weight)
