"""Actor and critic: two plain networks over one normalised observation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

_CLIP = 6.0  # standard deviations


class Normalizer(nn.Module):
    """Brings observations to zero mean and unit deviation, by the statistics of all it has seen."""

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int):
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("variance", torch.ones(size))
        self.register_buffer("count", torch.tensor(1e-3))

    @torch.no_grad()
    def observe(self, batch: Tensor) -> None:
        """Take in observations (n, size); Chan et al. (1979)."""
        n = torch.tensor(float(len(batch)))
        mean, variance = batch.mean(0), batch.var(0, unbiased=False)
        total = self.count + n
        gap = mean - self.mean
        moment = self.variance * self.count + variance * n + gap.square() * self.count * n / total
        self.mean += gap * n / total
        self.variance.copy_(moment / total)
        self.count.copy_(total)

    def forward(self, observations: Tensor) -> Tensor:
        """Normalised observations (..., size)."""
        return ((observations - self.mean) / (self.variance + 1e-4).sqrt()).clamp(-_CLIP, _CLIP)


def mlp(sizes: Sequence[int], last_gain: float) -> nn.Sequential:
    """A network with SiLU between its layers; the last starts scaled by `last_gain`."""
    layers: list[nn.Module] = []
    for i, (inputs, outputs) in enumerate(pairwise(sizes)):
        layer = nn.Linear(inputs, outputs)
        last = i == len(sizes) - 2
        nn.init.orthogonal_(layer.weight, last_gain if last else 2**0.5)
        nn.init.zeros_(layer.bias)
        layers += [layer] if last else [layer, nn.SiLU()]
    return nn.Sequential(*layers)


class ActorCritic(nn.Module):
    """Gaussian policy of fixed deviation, and a value between 0 and 1.

    The value is the discounted return over the largest there can be, ``r_max / (1 - discount)``: bounded, so
    that a bootstrap never leaves what is possible.

    Args:
        observations: size of an observation.
        actions: size of an action.
        hidden: widths of the hidden layers, of actor and critic each.
        noise: standard deviation of actions.
    """

    log_std: Tensor

    def __init__(self, observations: int, actions: int, hidden: Sequence[int], noise: float):
        super().__init__()
        self.normalizer = Normalizer(observations)
        self.actor = mlp([observations, *hidden, actions], 0.01)
        self.critic = mlp([observations, *hidden, 1], 1.0)
        self.register_buffer("log_std", torch.full((actions,), noise).log())

    def values(self, normal: Tensor) -> Tensor:
        """Values (...), between 0 and 1, of normalised observations (..., size)."""
        return self.critic(normal)[..., 0].clamp(0.0, 1.0)

    @torch.no_grad()
    def act(self, observations: Tensor) -> Tensor:
        """Most likely actions (n, actions) for raw observations (n, size)."""
        return self.actor(self.normalizer(observations))


def log_prob(actions: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Log-density (...) of actions (..., A) under independent Gaussians, but for a constant."""
    return (-0.5 * ((actions - mean) / log_std.exp()).square() - log_std).sum(-1)
