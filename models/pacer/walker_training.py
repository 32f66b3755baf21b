"""One update of the walker: act in all worlds for a while, then learn from it."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .policy import ActorCritic
from .ppo import PPO, Rollout, advantages
from .style import DemoWindows, Discriminator, StyleLearner, feature_count
from .walker_config import WalkerConfig
from .walker_env import WalkerEnv, WalkerStep


class StyleError(ValueError):
    """Style that counts, without motion capture."""


class WalkerTraining:
    """Environment, networks and optimisers of one run.

    Args:
        env: the worlds.
        config: settings.
        demos: motion capture, if style counts.
    """

    def __init__(self, env: WalkerEnv, config: WalkerConfig, demos: DemoWindows | None = None):
        torch.manual_seed(config.seed)
        self.env = env
        self.config = config
        self.model = ActorCritic(env.size, env.n_actions, config.hidden, config.noise)
        self.ppo = PPO(
            self.model,
            rate=config.rate,
            rate_bounds=config.rate_bounds,
            target_kl=config.target_kl,
            clip=config.clip,
            epochs=config.epochs,
            minibatch=config.minibatch,
            bfloat16=config.bfloat16,
        )
        self.style: StyleLearner | None = None
        if config.style.weight > 0:
            if demos is None:
                raise StyleError("A walker that learns style needs motion capture to learn it from.")
            size = config.style.window * feature_count(len(env.world.hinges))
            self.style = StyleLearner(Discriminator(size, config.style), demos, config.seed)
        self._windows: list[NDArray[np.float32]] = []
        self._ordinary_style = 0.3
        self.updates = 0
        self.samples = 0
        self.failing = 1.0
        """Running rate of failures, 1/s."""
        env.difficulty = 0.0
        self._observations = env.reset()
        env.age[:] = env.rng.integers(0, config.episode // 2, len(env))  # do not all end together
        self.model.normalizer.observe(torch.from_numpy(self._observations))

    def update(self) -> dict[str, float]:
        """Collect ``horizon`` steps of all worlds and learn from them; returns figures for the curve."""
        begun = time.perf_counter()
        rollout, figures = self._collect()
        learning = time.perf_counter()
        figures |= self.ppo.update(rollout)
        if self.style:
            figures |= self.style.learn(np.concatenate(self._windows))
            self._windows.clear()
        now = time.perf_counter()
        figures["learning_share"] = (now - learning) / (now - begun)
        figures["mean_value"] = float(rollout.returns.mean())
        self.updates += 1
        self.samples += len(rollout.returns)
        self._widen(figures["failures_per_s"])
        figures["difficulty"] = self.env.difficulty
        return figures

    def _widen(self, failing: float) -> None:
        """Make the paths harder while failures are few."""
        self.failing += 0.05 * (failing - self.failing)
        if self.failing < self.config.widen_below:
            self.env.difficulty = min(self.env.difficulty + self.config.widening, 1.0)

    @torch.no_grad()
    def _collect(self) -> tuple[Rollout, dict[str, float]]:
        env, model, config = self.env, self.model, self.config
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
                model.normalizer.observe(seen)
            observations[t] = model.normalizer(seen)
            values[t] = model.values(observations[t])
            means[t] = model.actor(observations[t])
            actions[t] = means[t] + model.log_std.exp() * torch.randn_like(means[t])
            step = env.step(actions[t].numpy())
            rewards[t] = self._reward(step) * (1 - config.discount)
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

        ended = max(int(failed.sum() + cut.sum()), 1)
        figures = {
            "reward": float(rewards.mean()) / (1 - config.discount),
            "failing": float(failed.sum()) / ended,
            "failures_per_s": float(failed.float().mean()) / env.period,
        } | {name: float(np.mean([t[name] for t in terms])) for name in terms[0]}
        figures["style_reward"] = self._ordinary_style
        for cause in ("fell", "strayed"):
            figures[cause] *= steps / ended
        return Rollout(flat(observations), flat(actions), flat(means), flat(gains), flat(returns)), figures

    def _reward(self, step: WalkerStep) -> Tensor:
        """Rewards (N,): of the task, and of style where a window is whole; elsewhere ordinary style."""
        task = torch.from_numpy(step.rewards)
        if self.style is None:
            return task
        style = torch.full_like(task, self._ordinary_style)
        if step.whole.any():
            windows = step.windows[step.whole]
            self._windows.append(windows)
            rewards = self.style.discriminator.rewards(torch.from_numpy(windows))
            style[torch.from_numpy(step.whole)] = rewards
            self._ordinary_style += 0.02 * (float(rewards.mean()) - self._ordinary_style)
        share = self.config.style.weight
        return (1 - share) * task + share * style

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and facts that `load_state` goes on from."""
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        if self.style:
            weights = self.style.discriminator.state_dict()
            tensors |= {f"style.{name}": value for name, value in weights.items()}
        for role, optimizer, network in self._learners():
            for name, parameter in network.named_parameters():
                for kind, value in optimizer.state[parameter].items():
                    tensors[f"{role}.{kind}.{name}"] = value
        facts = {
            "updates": self.updates,
            "samples": self.samples,
            "rate": self.ppo.rate,
            "failing": self.failing,
            "difficulty": self.env.difficulty,
        }
        return tensors, facts

    def load_state(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
        """Go on from `state`; the noise is that of the settings, which may be lowered on the way.

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
                kinds = ("step", "exp_avg", "exp_avg_sq")
                if f"step.{name}" in moments:
                    optimizer.state[parameter] = {kind: moments[f"{kind}.{name}"] for kind in kinds}
        if self.style and "style" in parts:
            self.style.discriminator.load_state_dict(parts["style"])
        self.updates, self.samples = int(facts["updates"]), int(facts["samples"])
        self.failing, self.env.difficulty = float(facts["failing"]), float(facts["difficulty"])
        self.ppo.rate = float(facts["rate"])
        for group in self.ppo.actor_optimizer.param_groups:
            group["lr"] = self.ppo.rate

    def _learners(self):
        yield "actor", self.ppo.actor_optimizer, self.model.actor
        yield "critic", self.ppo.critic_optimizer, self.model.critic
        if self.style:
            yield "stylist", self.style.optimizer, self.style.discriminator.network
