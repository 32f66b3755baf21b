"""Trained trackers as safetensors files that carry their settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..trace.weights import WeightsError, load_tensors
from .batch_world import Physics
from .config import RewardTerms, TrackerConfig
from .policy import ActorCritic


def config_from_dict(values: dict[str, Any]) -> TrackerConfig:
    """Settings from what `dataclasses.asdict` and JSON made of them.

    Raises:
        WeightsError: a setting that this version does not know.
    """
    values = dict(values)
    try:
        physics = Physics(**values.pop("physics"))
        rewards = RewardTerms(**{name: tuple(pair) for name, pair in values.pop("rewards").items()})
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return TrackerConfig(physics=physics, rewards=rewards, **plain)
    except (KeyError, TypeError) as error:
        raise WeightsError(f"these settings are of another version: {error}") from error


def load_tracker(path: Path) -> tuple[ActorCritic, TrackerConfig, dict[str, Any]]:
    """Read a tracker, its settings, and what else is known of it.

    Raises:
        WeightsError: the file is missing, broken, or does not fit its own settings.
    """
    tensors, facts = load_tensors(path)
    try:
        config = config_from_dict(facts["config"])
        model = ActorCritic(facts["observations"], facts["actions"], config.hidden, config.noise)
        model.load_state_dict(tensors)
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"{path} holds no tracker: {error}") from error
    return model.eval(), config, facts
