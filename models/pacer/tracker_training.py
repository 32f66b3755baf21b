"""Training of the motion tracker: what it adds to any policy's."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from .config import TrackerConfig
from .policy_training import PolicyTraining
from .tracker_env import TrackerEnv


class TrackerTraining(PolicyTraining):
    """A run of the tracker; the sampler of clips goes on where it was.

    Args:
        env: the worlds.
        config: settings.
    """

    def __init__(self, env: TrackerEnv, config: TrackerConfig):
        super().__init__(env, config)
        self.env = env

    def _adapt(self, figures: dict[str, float]) -> dict[str, float]:
        return {"active_clips": float(self.env.sampler.active)}

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """See `PolicyTraining.state`."""
        tensors, facts = super().state()
        for name, value in self.env.sampler.state().items():
            tensors[f"sampler.{name}"] = torch.from_numpy(np.asarray(value))
        return tensors, facts

    def load_state(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> dict[str, dict[str, Tensor]]:
        """See `PolicyTraining.load_state`."""
        parts = super().load_state(tensors, facts)
        self.env.sampler.load_state({name: value.numpy() for name, value in parts["sampler"].items()})
        self._observations = self.env.reset()
        return parts
