"""Training of the walker: what it adds to any policy's; paths that get harder, and style."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .. import ranks
from .policy_training import PolicyTraining
from .style import DemoWindows, Discriminator, StyleLearner, feature_count
from .walker_config import WalkerConfig
from .walker_env import WalkerEnv, WalkerStep


class StyleError(ValueError):
    """Style that counts, without motion capture."""


class WalkerTraining(PolicyTraining):
    """A run of the walker.

    Args:
        env: the worlds.
        config: settings.
        demos: motion capture, if style counts.
    """

    def __init__(self, env: WalkerEnv, config: WalkerConfig, demos: DemoWindows | None = None):
        env.difficulty, env.starts.learning = config.first_difficulty, True
        super().__init__(env, config)
        self.env = env
        self.config = config
        self.style: StyleLearner | None = None
        if config.style.weight > 0:
            if demos is None:
                raise StyleError("A walker that learns style needs motion capture to learn it from.")
            size = config.style.window * feature_count(len(env.world.hinges))
            torch.manual_seed(config.seed)
            self.style = StyleLearner(Discriminator(size, config.style), demos, config.seed + ranks.number())
            torch.manual_seed(config.seed + ranks.number())
        self._windows: list[NDArray[np.float32]] = []
        self._ordinary_style = 0.3
        self.failing = 1.0
        """Running rate of failures, 1/s."""
        env.age[:] = env.rng.integers(0, config.episode // 2, len(env))  # do not all end together

    def _learn_more(self) -> dict[str, float]:
        if self.style is None:
            return {}
        figures = self.style.learn(np.concatenate(self._windows))
        self._windows.clear()
        return figures | {"style_reward": self._ordinary_style}

    def _adapt(self, figures: dict[str, float]) -> dict[str, float]:
        """Make the paths harder while failures are few; count how people fail."""
        env = self.env
        self.failing += 0.05 * (ranks.mean(figures["failures_per_s"]) - self.failing)
        if self.failing < self.config.widen_below:
            env.difficulty = min(env.difficulty + self.config.widening, 1.0)
        causes = {cause: figures[cause] for cause in ("fell", "strayed", "bumped")}
        ended = max(sum(causes.values()), 1e-9)
        causes = {cause: count / ended for cause, count in causes.items()}
        return causes | {"difficulty": env.difficulty, "level": ranks.mean(env.starts.level)}

    def _rewards(self, step: WalkerStep) -> Tensor:
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
        """See `PolicyTraining.state`."""
        tensors, facts = super().state()
        if self.style:
            weights = self.style.discriminator.state_dict()
            tensors |= {f"style.{name}": value for name, value in weights.items()}
        return tensors, facts | {
            "failing": self.failing,
            "difficulty": self.env.difficulty,
            "falls": self.env.starts.falls.tolist(),
        }

    def load_state(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> dict[str, dict[str, Tensor]]:
        """See `PolicyTraining.load_state`."""
        parts = super().load_state(tensors, facts)
        if self.style and "style" in parts:
            self.style.discriminator.load_state_dict(parts["style"])
        self.failing, self.env.difficulty = float(facts["failing"]), float(facts["difficulty"])
        if np.shape(facts.get("falls", [])) == self.env.starts.falls.shape:
            self.env.starts.falls[:] = facts["falls"]
        return parts

    def _learners(self) -> Iterator[tuple[str, torch.optim.Optimizer, nn.Module]]:
        yield from super()._learners()
        if self.style:
            yield "stylist", self.style.optimizer, self.style.discriminator.network
