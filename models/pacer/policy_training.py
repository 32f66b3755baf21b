"""One update of a policy: act in all worlds for a while, then learn from it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .. import ranks
from .learning_config import LearningConfig
from .policy import ActorCritic
from .ppo import PPO, Rollout, advantages

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class Step(Protocol):
    """What one control step of N worlds brought."""

    observations: NDArray[np.float32]
    """(N, size) to act on next; after the reset where an episode ended."""
    rewards: NDArray[np.float32]
    """(N,) in [0, 1]."""
    failed: NDArray[np.bool_]
    """(N,) the episode ended for good."""
    cut: NDArray[np.bool_]
    """(N,) the episode was cut while reward would have gone on."""
    cut_observations: NDArray[np.float32]
    """(number of cut worlds, size): what was seen at the end of those."""
    terms: dict[str, float]
    """Means over the worlds, for the curve."""


class Env(Protocol):
    """N worlds that are acted in together and begin anew by themselves."""

    size: int
    """How many numbers an observation has."""
    n_actions: int
    period: float
    """s of a control step."""

    def __len__(self) -> int:
        """N."""
        ...

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode in every world."""
        ...

    def step(self, actions: NDArray[np.float32]) -> Any:
        """Take actions (N, A); returns a `Step`."""
        ...


class PolicyTraining:
    """Environment, networks and optimisers of one run; under `torchrun` each process brings worlds of its own.

    Args:
        env: the worlds of this process.
        config: settings; `minibatch` counts the samples of all processes.
    """

    def __init__(self, env: Env, config: LearningConfig):
        torch.manual_seed(config.seed)
        self._env, self._learning = env, config
        self.model = ActorCritic(env.size, env.n_actions, config.hidden, config.noise)
        self.ppo = PPO(
            self.model,
            rate=config.rate,
            rate_bounds=config.rate_bounds,
            target_kl=config.target_kl,
            clip=config.clip,
            epochs=config.epochs,
            minibatch=max(config.minibatch // ranks.count(), 1),
            bfloat16=config.bfloat16,
        )
        self.updates = 0
        self.samples = 0
        """Control steps of all processes so far."""
        self._observations = env.reset()
        self.model.normalizer.observe(ranks.gathered(torch.from_numpy(self._observations)))
        torch.manual_seed(config.seed + ranks.number())  # each its own noise

    def update(self) -> dict[str, float]:
        """Collect ``horizon`` steps of all worlds and learn from them; returns figures for the curve."""
        begun = time.perf_counter()
        rollout, figures = self._collect()
        learning = time.perf_counter()
        figures |= self.ppo.update(rollout)
        figures |= self._learn_more()
        now = time.perf_counter()
        figures["learning_share"] = (now - learning) / (now - begun)
        figures["mean_value"] = float(rollout.returns.mean())
        self.updates += 1
        self.samples += len(rollout.returns) * ranks.count()
        return figures | self._adapt(figures)

    def _rewards(self, step: Any) -> Tensor:
        """Rewards (N,) that count, between 0 and 1."""
        return torch.from_numpy(step.rewards)

    def _learn_more(self) -> dict[str, float]:
        """Learn what else there is to learn from the last rollout; returns figures."""
        return {}

    def _adapt(self, figures: dict[str, float]) -> dict[str, float]:
        """Make the task fit what has been learnt; returns figures."""
        return {}

    @torch.no_grad()
    def _collect(self) -> tuple[Rollout, dict[str, float]]:
        env, model, config = self._env, self.model, self._learning
        steps, worlds = config.horizon, len(env)
        observations = torch.empty(steps, worlds, env.size)
        actions = torch.empty(steps, worlds, env.n_actions)
        means = torch.empty_like(actions)
        rewards, cut_values = torch.empty(steps, worlds), torch.zeros(steps, worlds)
        failed, cut = torch.empty(2, steps, worlds, dtype=torch.bool)
        values = torch.empty(steps + 1, worlds)
        terms: list[dict[str, float]] = []
        for t in range(steps):
            seen = torch.from_numpy(self._observations)
            if t % 4 == 0:
                model.normalizer.observe(ranks.gathered(seen))
            observations[t] = model.normalizer(seen)
            values[t] = model.values(observations[t])
            means[t] = model.actor(observations[t])
            actions[t] = means[t] + model.log_std.exp() * torch.randn_like(means[t])
            step = env.step(actions[t].numpy())
            rewards[t] = self._rewards(step) * (1 - config.discount)
            failed[t], cut[t] = torch.from_numpy(step.failed), torch.from_numpy(step.cut)
            if step.cut.any():
                ends = model.normalizer(torch.from_numpy(step.cut_observations))
                cut_values[t, cut[t]] = model.values(ends)
            self._observations = step.observations
            terms.append(step.terms)
        values[steps] = model.values(model.normalizer(torch.from_numpy(self._observations)))
        gains = advantages(rewards, values, failed, cut, cut_values, config.discount, config.trace_decay)
        returns = (gains + values[:-1]).clamp(0.0, 1.0)

        def flat(x: Tensor) -> Tensor:
            return x.reshape(steps * worlds, *x.shape[2:])

        ended = int(failed.sum() + cut.sum())
        figures = {
            "reward": float(rewards.mean()) / (1 - config.discount),
            "failing": float(failed.sum()) / max(ended, 1),
            "failures_per_s": float(failed.float().mean()) / env.period,
        } | {name: float(np.mean([t[name] for t in terms])) for name in terms[0]}
        return Rollout(flat(observations), flat(actions), flat(means), flat(gains), flat(returns)), figures

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and facts that `load_state` goes on from."""
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        for role, optimizer, network in self._learners():
            for name, parameter in network.named_parameters():
                for kind, value in optimizer.state[parameter].items():
                    tensors[f"{role}.{kind}.{name}"] = value
        return tensors, {"updates": self.updates, "samples": self.samples, "rate": self.ppo.rate}

    def load_state(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> dict[str, dict[str, Tensor]]:
        """Go on from `state`; the noise is that of the settings, which may be lowered on the way.

        Returns:
            The tensors by the part of their names before the first point.

        Raises:
            RuntimeError: the networks are of another size.
        """
        parts: dict[str, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            part, name = key.split(".", 1)
            parts.setdefault(part, {})[name] = value
        noise = self.model.log_std.clone()
        self.model.load_state_dict(parts["model"])
        self.model.log_std.copy_(noise)
        for role, optimizer, network in self._learners():
            moments = parts.get(role, {})
            for name, parameter in network.named_parameters():
                if f"step.{name}" in moments:
                    optimizer.state[parameter] = {kind: moments[f"{kind}.{name}"] for kind in _MOMENTS}
        self.updates, self.samples = int(facts["updates"]), int(facts["samples"])
        self.ppo.rate = float(facts["rate"])
        for group in self.ppo.actor_optimizer.param_groups:
            group["lr"] = self.ppo.rate
        return parts

    def _learners(self) -> Iterator[tuple[str, torch.optim.Optimizer, nn.Module]]:
        yield "actor", self.ppo.actor_optimizer, self.model.actor
        yield "critic", self.ppo.critic_optimizer, self.model.critic
