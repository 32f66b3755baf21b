"""From noise to actions of everybody in a scene, bent by objectives on the way."""

from collections.abc import Sequence

import torch
from torch import Tensor

from .context import Context
from .diffusion import CosineSchedule, Solver
from .guidance import FutureOf, Guidance, gradient_of, guide_direct, total_loss
from .network import Encoding, Trace
from .objectives import Objective
from .sampling import Sampling
from .settling import setting_out


class Denoiser:
    """A trained denoiser with a way to sample it and a way to guide it.

    Args:
        trace: Trained network.
        sampling: How futures are drawn.
        guidance: How objectives bend them.
    """

    def __init__(self, trace: Trace, sampling: Sampling, guidance: Guidance):
        self.trace, self.sampling, self.guidance = trace.prepared(sampling.reduced), sampling, guidance
        self.config, self.schedule = trace.config, CosineSchedule(trace.config.diffusion_steps)

    def sample(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
        start: Tensor | None = None,
    ) -> Tensor:
        """Denoise all samples of all agents together: (A, M, horizon, 2) normalised actions.

        See `scene_planner.ActionSource`; a `start` is noised part of the way only.
        """
        sampling, shape = self.sampling, (len(context), self.sampling.samples, self.config.horizon, 2)
        solver, first = self._solver(anew=start is None)
        temperature = sampling.temperature * (self.guidance.temperature if objectives else 1.0)
        noise = temperature * torch.randn(shape, generator=generator)
        one = self._encode(context)
        many = [encoding.repeat(sampling.samples) for encoding in one]
        if start is not None:
            noise = self._noised(start, noise, solver.timesteps[first])
        lag = self._lag(objectives, len(context))
        noisy, estimate = noise, start
        for i, k in list(enumerate(solver.timesteps))[first:]:
            # What the last step would be led to nothing mends any more: that is for those who are polished.
            wishes = [] if self.guidance.polishes and i + 1 == len(solver.timesteps) else objectives
            if start is None and i == 0 and not self.config.timesteps:
                # All noise, which says nothing: one prediction serves all samples. To a distilled network it says
                # which of the teacher's futures to go for.
                clean, shift = self._guided(noisy[:, :1], k, one, None, future_of, wishes, lag)
                clean = clean.expand_as(noisy)
            else:
                clean, shift = self._guided(noisy, k, many, estimate, future_of, wishes, lag)
            if objectives:
                clean = self.within_speeds(clean, context.speed)
            noisy, estimate = solver.step(clean, noisy, i, generator) - shift, clean
        return noisy

    def starts(self, own: Tensor, speed: Tensor) -> Tensor:
        """Where to look for other ways (R, M, horizon, 2): near one's own (R, 1, horizon, 2), and in all directions.

        Of those who stand with the goal behind, guidance alone makes people who stand: no turn of theirs gets anywhere.
        """
        ways = setting_out(speed, self.sampling.samples, self.config.horizon, self.config.dt)
        starts = self.trace.normalized(ways)
        starts[:, ::2] = own
        return starts

    def resample(
        self,
        rows: Tensor,
        start: Tensor,
        own: Tensor,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
    ) -> Tensor:
        """New samples (R, M, horizon, 2) of some people (R,), not far from where they start, of the same shape.

        All others keep to their `own` actions (A, 1, horizon, 2).
        """
        sampling = self.sampling
        solver, first = self._solver(anew=False)
        many = [encoding.repeat(sampling.samples) for encoding in self._encode(context.take(rows))]
        estimate = own.repeat(1, sampling.samples, 1, 1)  # of everybody
        noise = torch.randn(estimate.shape, generator=generator)[rows]  # the same whoever else tries again
        estimate[rows] = start
        noisy = self._noised(estimate[rows], noise, solver.timesteps[first])
        lag = self._lag(objectives, len(context))
        for i, k in list(enumerate(solver.timesteps))[first:]:
            others = None  # who the network sees is where they are by now, (R * M, N, horizon, 2)
            if context.rows is not None:
                others = estimate[context.rows[rows]].transpose(1, 2).flatten(0, 1)
            estimate[rows] = self._predict(noisy, k, many, estimate[rows], others) - lag[rows]
            if i + 1 < len(solver.timesteps):
                guided = guide_direct(
                    estimate, future_of, objectives, self.guidance, self.schedule.variance(k)
                )
                estimate[rows] = guided[rows]
            estimate[rows] = self.within_speeds(estimate[rows], context.speed[rows])
            noisy = solver.step(estimate[rows], noisy, i, generator)
        return noisy

    def _solver(self, anew: bool) -> tuple[Solver, int]:
        """A solver, and the number of its first step: for what is not drawn `anew` that at a part of the noise."""
        solver = self.sampling.make_solver(self.schedule)
        if anew:
            return solver, 0
        level = self.sampling.keep * (len(self.schedule) - 1)
        last = len(solver.timesteps) - 1
        return solver, next((i for i, k in enumerate(solver.timesteps) if k <= level), last)

    def _noised(self, actions: Tensor, noise: Tensor, k: int) -> Tensor:
        return self.schedule.add_noise(actions, noise, torch.full((len(actions),), k))

    def _lag(self, objectives: Sequence[Objective], agents: int) -> Tensor:
        """What `haste` takes off normalised actions (A, 1, horizon, 2): nothing of who is not led anywhere."""
        led = torch.zeros(agents, 1, dtype=torch.bool)
        if self.guidance.haste:
            for wish in objectives:
                led = led | wish.led(agents)
        horizon = self.config.horizon
        lag = torch.zeros(horizon, 2)
        lag[: horizon // 2, 0] = self.guidance.haste / self.trace.trajectory_std[4]
        lag[horizon // 2 :, 0] = -lag[0, 0] / 2
        return led[..., None, None] * lag

    def within_speeds(self, actions: Tensor, speed: Tensor) -> Tensor:
        """The nearest actions (A, M, horizon, 2) whose speeds, from (A,) now, keep the bounds of guidance."""
        mean, std = self.trace.trajectory_mean[4], self.trace.trajectory_std[4]
        low, high = self.guidance.speeds
        start = speed[:, None, None].expand(*actions.shape[:2], 1)
        speeds = start + torch.cumsum(actions[..., 0] * std + mean, -1) * self.config.dt
        speeds = torch.cat([start, torch.minimum(speeds.clamp(min=low), start.clamp(min=high))], -1)
        acceleration = (speeds.diff(dim=-1) / self.config.dt - mean) / std
        return torch.stack([acceleration, actions[..., 1]], -1)

    def _guided(
        self,
        noisy: Tensor,
        k: int,
        encodings: list[Encoding],
        estimate: Tensor | None,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        lag: Tensor,
    ) -> tuple[Tensor, Tensor | float]:
        """Guided clean actions, and what guidance takes off the next noisy ones."""
        guidance = self.guidance
        if not objectives:
            return self._predict(noisy, k, encodings, estimate) - lag, 0.0
        variance = self.schedule.variance(k)
        if guidance.mode == "clean":
            with torch.enable_grad():
                noisy = noisy.detach().requires_grad_()
                clean = self._predict(noisy, k, encodings, estimate) - lag
                loss = total_loss(objectives, future_of(clean))
                gradient = gradient_of(loss, noisy)
            return clean.detach() - guidance.step(loss.detach(), gradient, variance), 0.0
        clean = self._predict(noisy, k, encodings, estimate) - lag
        if guidance.mode == "direct":
            return guide_direct(clean, future_of, objectives, guidance, variance), 0.0
        with torch.enable_grad():
            mean = self.schedule.posterior(clean, noisy, k)[0].detach().requires_grad_()
            loss = total_loss(objectives, future_of(mean))
            gradient = gradient_of(loss, mean)
        return clean, guidance.step(loss.detach(), gradient, variance)

    def _encode(self, context: Context) -> list[Encoding]:
        """The conditional encoding, and the unconditional one where it is mixed in; a row per agent."""
        contexts = [context]
        if self.sampling.context_weight:
            contexts.append(context.unconditional())
        with torch.no_grad():
            return [self.trace.encode(c) for c in contexts]

    def _predict(
        self,
        noisy: Tensor,
        k: int,
        encodings: list[Encoding],
        estimate: Tensor | None,
        neighbors: Tensor | None = None,
    ) -> Tensor:
        rows = noisy.flatten(0, 1)
        known = None if estimate is None else estimate.flatten(0, 1)
        steps = torch.full((len(rows),), k)
        with torch.set_grad_enabled(noisy.requires_grad):
            clean = [self.trace(rows, steps, e, neighbors, known).reshape(noisy.shape) for e in encodings]
        if len(clean) == 1:
            return clean[0]
        return self.schedule.classifier_free(clean[0], clean[1], noisy, k, self.sampling.context_weight)
