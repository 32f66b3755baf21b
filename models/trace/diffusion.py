"""Denoising diffusion on clean predictions: the cosine schedule, and three solvers that share one interface.

A solver offers `timesteps` (from noisy to clean) and `step(clean, noisy, i)`, where `clean` is the
prediction of the network for `noisy` at `timesteps[i]`. Step indices run from 0 (least noise) to K-1.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor


class CosineSchedule:
    """The cosine noise schedule (Nichol and Dhariwal 2021, eq 17): s = 0.008, betas clipped at 0.999.

    Attributes:
        betas: (K,) variance added by each step.
        alphas_cumprod: (K,) share of the clean signal's variance that is left after each step.
    """

    def __init__(self, steps: int = 100):
        if steps < 1:
            raise ValueError(f"CosineSchedule: steps must be at least 1, not {steps}")
        t = torch.arange(steps + 1, dtype=torch.float64) / steps
        signal = torch.cos((t + 0.008) / 1.008 * math.pi / 2) ** 2
        self.betas = (1 - signal[1:] / signal[:-1]).clamp(max=0.999).float()
        self.alphas_cumprod = torch.cumprod(1 - self.betas, 0)

    def __len__(self) -> int:
        return len(self.betas)

    def add_noise(self, clean: Tensor, noise: Tensor, k: Tensor) -> Tensor:
        """The noisy trajectory of step `k` (TRACE eq 10).

        Args:
            clean: (B, ...) clean sample.
            noise: (B, ...) standard normal.
            k: (B,) step indices.
        """
        a = self.alphas_cumprod[k].reshape(-1, *[1] * (clean.ndim - 1))
        return a.sqrt() * clean + (1 - a).sqrt() * noise

    def noise_from_clean(self, clean: Tensor, noisy: Tensor, k: int) -> Tensor:
        """The noise that turns `clean` into `noisy` at step `k` (TRACE eq 11)."""
        a = self.alphas_cumprod[k]
        return (noisy - a.sqrt() * clean) / (1 - a).sqrt()

    def clean_from_noise(self, noise: Tensor, noisy: Tensor, k: int) -> Tensor:
        """The inverse of `noise_from_clean`."""
        a = self.alphas_cumprod[k]
        return (noisy - (1 - a).sqrt() * noise) / a.sqrt()

    def clean_between(self, noisy: Tensor, k: int, later: Tensor, j: int) -> Tensor:
        """The clean prediction with which one deterministic step of `DDIM` leads from `noisy` at k to `later` at j.

        What a distilled network has to predict (Salimans and Ho 2022, app. G).
        """
        a, b = self.alphas_cumprod[k], self.alphas_cumprod[j]
        ratio = ((1 - b) / (1 - a)).sqrt()
        return (later - ratio * noisy) / (b.sqrt() - ratio * a.sqrt())

    def classifier_free(
        self, conditional: Tensor, unconditional: Tensor, noisy: Tensor, k: int, w: float
    ) -> Tensor:
        """Mix two clean predictions in noise space (TRACE eq 4).

        Args:
            conditional: Clean prediction given the context.
            unconditional: Clean prediction without it.
            noisy: The input of both.
            k: Its step index.
            w: 0 is purely conditional, -1 purely unconditional, above 0 stresses the context.
        """
        given = self.noise_from_clean(conditional, noisy, k)
        free = self.noise_from_clean(unconditional, noisy, k)
        return self.clean_from_noise(given + w * (given - free), noisy, k)

    def posterior(self, clean: Tensor, noisy: Tensor, k: int) -> tuple[Tensor, Tensor]:
        """Mean and variance of the step from k to k-1 (TRACE eq 9); the variance is 0 at k = 0."""
        a, before = self.alphas_cumprod[k], self._before(k)
        beta = 1 - a / before  # of the same rounding as a: at k = 0 the mean is the clean sample itself
        mean = (before.sqrt() * beta * clean + (1 - beta).sqrt() * (1 - before) * noisy) / (1 - a)
        return mean, self.variance(k)

    def variance(self, k: int) -> Tensor:
        """Sigma_k, the variance of that step."""
        return self.betas[k] * (1 - self._before(k)) / (1 - self.alphas_cumprod[k])

    def _before(self, k: int) -> Tensor:
        return self.alphas_cumprod[k - 1] if k > 0 else torch.tensor(1.0)


class Solver(Protocol):
    """One way of walking from noise to a clean sample."""

    timesteps: list[int]

    def step(self, clean: Tensor, noisy: Tensor, i: int, generator: torch.Generator | None = None) -> Tensor:
        """The sample at `timesteps[i + 1]`; after the last step the clean sample."""
        ...


def spaced_timesteps(total: int, steps: int, power: float = 1.0) -> list[int]:
    """`steps` step indices from `total - 1` downwards; the noisiest is always in.

    Args:
        total: Steps of the schedule.
        steps: How many of them.
        power: 1 makes even strides; above 1 they grow towards the clean end as (i / steps)^power does.

    Raises:
        ValueError: When `steps` is not in 1..`total`.
    """
    if not 1 <= steps <= total:
        raise ValueError(f"a solver takes 1 to {total} steps of this schedule, not {steps}")
    indices = [total - 1]
    for i in range(1, steps):
        indices.append(min(round(total - total * (i / steps) ** power), indices[-1]) - 1)
    return indices


class DDPM:
    """Ancestral sampling through every step of the schedule (Ho et al. 2020; TRACE eq 2)."""

    def __init__(self, schedule: CosineSchedule):
        self.schedule = schedule
        self.timesteps = list(range(len(schedule) - 1, -1, -1))

    def step(self, clean: Tensor, noisy: Tensor, i: int, generator: torch.Generator | None = None) -> Tensor:
        """See `Solver.step`; draws one normal sample per element except at the last step."""
        k = self.timesteps[i]
        mean, variance = self.schedule.posterior(clean, noisy, k)
        if k == 0:
            return mean
        noise = torch.randn(noisy.shape, generator=generator, dtype=noisy.dtype)
        return mean + variance.sqrt() * noise


class DDIM:
    """First-order sampling on few steps (Song et al. 2021, eq 12).

    Args:
        schedule: Noise schedule.
        timesteps: Step indices, from noisy to clean.
        eta: 0 is deterministic; 1 draws as much fresh noise as `DDPM` would on these steps.
    """

    def __init__(self, schedule: CosineSchedule, timesteps: Sequence[int], eta: float = 0.0):
        self.schedule, self.eta = schedule, eta
        self.timesteps = list(timesteps)

    def step(self, clean: Tensor, noisy: Tensor, i: int, generator: torch.Generator | None = None) -> Tensor:
        """See `Solver.step`."""
        if i + 1 == len(self.timesteps):
            return clean
        k, after = self.timesteps[i], self.timesteps[i + 1]
        noise = self.schedule.noise_from_clean(clean, noisy, k)
        a, b = self.schedule.alphas_cumprod[k], self.schedule.alphas_cumprod[after]
        sigma = self.eta * ((1 - b) / (1 - a) * (1 - a / b)).sqrt()
        mean = b.sqrt() * clean + (1 - b - sigma**2).sqrt() * noise
        if not self.eta:
            return mean
        return mean + sigma * torch.randn(noisy.shape, generator=generator, dtype=noisy.dtype)


class DPMSolver2M:
    """Second-order multistep sampling, DPM-Solver++(2M) (Lu et al. 2022, algorithm 2).

    The first and the last step are first-order. It remembers the previous clean prediction: use one instance
    per sampling run, in order.

    Args:
        schedule: Noise schedule.
        timesteps: Step indices, from noisy to clean.
    """

    def __init__(self, schedule: CosineSchedule, timesteps: Sequence[int]):
        self.timesteps = list(timesteps)
        a = schedule.alphas_cumprod[self.timesteps].double()
        self._alpha, self._sigma = a.sqrt(), (1 - a).sqrt()
        self._log_snr = torch.log(self._alpha / self._sigma)  # lambda of the paper
        self._previous: Tensor | None = None

    def step(self, clean: Tensor, noisy: Tensor, i: int, generator: torch.Generator | None = None) -> Tensor:
        """See `Solver.step`."""
        previous, self._previous = self._previous, clean
        if i + 1 == len(self.timesteps):
            return clean
        h = self._log_snr[i + 1] - self._log_snr[i]
        if i > 0 and previous is not None:
            r = (self._log_snr[i] - self._log_snr[i - 1]) / h
            clean = clean + (clean - previous) / (2 * float(r))
        ratio, gain = self._sigma[i + 1] / self._sigma[i], self._alpha[i + 1] * torch.expm1(-h)
        return float(ratio) * noisy - float(gain) * clean
