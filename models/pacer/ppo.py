"""Proximal policy optimisation (Schulman et al. 2017) with a learning rate held by the divergence."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .. import ranks
from .policy import ActorCritic, log_prob

_CRITIC_RATE = 5e-4
_ACTOR_NORM, _CRITIC_NORM = 1.0, 1.0  # gradients are clipped apart: a bad critic must not starve the actor
_MEAN_COST = 1e-3  # keeps mean actions from drifting where they make no difference


def advantages(
    rewards: Tensor,
    values: Tensor,
    failed: Tensor,
    cut: Tensor,
    cut_values: Tensor,
    discount: float,
    trace_decay: float,
) -> Tensor:
    """Generalised advantage estimates (T, N); Schulman et al. (2016), eq 16.

    Args:
        rewards: (T, N).
        values: (T + 1, N) of what was acted on; the last row of what follows.
        failed: (T, N) whether the episode ended for good with this step.
        cut: (T, N) whether it was only cut there.
        cut_values: (T, N) value of what was seen at a cut; anything elsewhere.
        discount: per step.
        trace_decay: lambda.
    """
    out = torch.zeros_like(rewards)
    following = torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        goes_on = ~(failed[t] | cut[t])
        ahead = torch.where(goes_on, values[t + 1], torch.where(cut[t], cut_values[t], 0.0))
        delta = rewards[t] + discount * ahead - values[t]
        following = delta + discount * trace_decay * torch.where(goes_on, following, 0.0)
        out[t] = following
    return out


@dataclass(frozen=True)
class Rollout:
    """M samples, flattened over time and worlds."""

    observations: Tensor
    """(M, size), normalised."""
    actions: Tensor
    """(M, A)."""
    means: Tensor
    """(M, A) of the policy that acted."""
    advantages: Tensor
    """(M,)."""
    returns: Tensor
    """(M,), in units of the value."""


class PPO:
    """Updates an actor and a critic, each with its own optimiser and gradient clip.

    Gradients and divergences are means over the processes that train together.

    Args:
        model: what learns.
        rate: first learning rate of the actor.
        rate_bounds: between which it is held.
        target_kl: divergence per update aimed at.
        clip: of the probability ratio.
        epochs: passes over a rollout.
        minibatch: samples per step.
        bfloat16: multiply matrices in bfloat16 while learning: half the time on processors that have it.
    """

    def __init__(
        self,
        model: ActorCritic,
        *,
        rate: float,
        rate_bounds: tuple[float, float],
        target_kl: float,
        clip: float,
        epochs: int,
        minibatch: int,
        bfloat16: bool = False,
    ):
        self.model = model
        self.rate = rate
        self.rate_bounds = rate_bounds
        self.target_kl = target_kl
        self.clip = clip
        self.epochs = epochs
        self.minibatch = minibatch
        self.bfloat16 = bfloat16
        self.actor_optimizer = torch.optim.Adam(model.actor.parameters(), rate, eps=1e-5, fused=True)
        self.critic_optimizer = torch.optim.Adam(
            model.critic.parameters(), _CRITIC_RATE, eps=1e-5, fused=True
        )

    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a rollout; returns the divergence, losses and explained variance."""
        # No cache: it would keep the weights of the first minibatch for the whole update.
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bfloat16, cache_enabled=False):
            return self._update(rollout)

    def _update(self, rollout: Rollout) -> dict[str, float]:
        model, log_std = self.model, self.model.log_std
        advantage = rollout.advantages
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        with torch.no_grad():
            # In bfloat16 the policy that acted is asked once more, so that ratios begin at exactly 1.
            means = model.actor(rollout.observations).float() if self.bfloat16 else rollout.means
            old = log_prob(rollout.actions, means, log_std)
            residual = rollout.returns - model.values(rollout.observations)
            explained = 1 - residual.var() / (rollout.returns.var() + 1e-8)
        losses = []
        divergence = 0.0
        for _ in range(self.epochs):
            divergences = []
            for rows in torch.randperm(len(advantage)).split(self.minibatch):
                observations = rollout.observations[rows]
                mean = model.actor(observations).float()
                ratio = (log_prob(rollout.actions[rows], mean, log_std) - old[rows]).exp()
                gain = torch.minimum(
                    ratio * advantage[rows], ratio.clamp(1 - self.clip, 1 + self.clip) * advantage[rows]
                )
                actor_loss = -gain.mean() + _MEAN_COST * mean.square().mean()
                _descend(self.actor_optimizer, actor_loss, model.actor, _ACTOR_NORM)
                value_loss = (
                    (model.critic(observations)[:, 0].float() - rollout.returns[rows]).square().mean()
                )
                _descend(self.critic_optimizer, value_loss, model.critic, _CRITIC_NORM)
                with torch.no_grad():
                    gap = (mean - means[rows]) / log_std.exp()
                    divergences.append(0.5 * gap.square().sum(-1).mean().item())
                losses.append((actor_loss.item(), value_loss.item()))
            divergence = ranks.mean(sum(divergences) / len(divergences))
            if divergence > 2 * self.target_kl:
                break
        self._hold(divergence)
        actor, critic = torch.tensor(losses).mean(0).tolist()
        return {
            "kl": divergence,
            "actor_loss": actor,
            "critic_loss": critic,
            "explained": explained.item(),
            "rate": self.rate,
        }

    def _hold(self, divergence: float) -> None:
        """Move the learning rate so that the divergence stays near its target."""
        low, high = self.rate_bounds
        if divergence > 1.5 * self.target_kl:
            self.rate = max(self.rate / 1.3, low)
        elif divergence < 0.7 * self.target_kl:
            self.rate = min(self.rate * 1.15, high)
        for group in self.actor_optimizer.param_groups:
            group["lr"] = self.rate


def _descend(optimizer: torch.optim.Optimizer, loss: Tensor, model: nn.Module, norm: float) -> None:
    optimizer.zero_grad()
    loss.backward()
    ranks.average(p.grad for p in model.parameters() if p.grad is not None)
    nn.utils.clip_grad_norm_(model.parameters(), norm)
    optimizer.step()
