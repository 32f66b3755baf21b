"""Settings of learning that all policies share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class LearningConfig:
    """Networks and proximal policy optimisation."""

    hidden: tuple[int, ...] = (512, 256)
    """Widths of the hidden layers, of actor and critic each."""
    noise: float = 0.15
    """Standard deviation of actions while training."""
    horizon: int = 16
    """Steps of each world per update."""
    epochs: int = 5
    minibatch: int = 1024
    discount: float = 0.97
    trace_decay: float = 0.95
    """Lambda of generalised advantage estimation (Schulman et al. 2016)."""
    clip: float = 0.2
    bfloat16: bool = True
    """Whether learning multiplies matrices in bfloat16."""
    target_kl: float = 0.03
    """Divergence per update that the learning rate is held to."""
    rate: float = 3e-4
    rate_bounds: tuple[float, float] = (2e-5, 1e-3)
    seed: int = 0


PAPER_LEARNING: dict[str, Any] = dict(
    hidden=(2048, 1024),
    noise=0.055,
    horizon=32,
    epochs=6,
    minibatch=16384,
    discount=0.99,
    bfloat16=False,
    rate=2e-5,
    rate_bounds=(2e-5, 2e-5),
)
"""PACER's (app. B; its public configuration)."""
