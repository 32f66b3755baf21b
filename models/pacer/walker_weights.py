"""Trained walkers as safetensors files that carry their settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..trace.weights import WeightsError, load_tensors
from .batch_world import Physics
from .path_follower import FollowerLimits
from .paths import PathSettings
from .policy import ActorCritic
from .walker_config import StyleConfig, WalkerConfig, WalkerRewards


def walker_config_from_dict(values: dict[str, Any]) -> WalkerConfig:
    """Settings from what `dataclasses.asdict` and JSON made of them.

    Raises:
        WeightsError: a setting that this version does not know.
    """
    parts = {
        "physics": Physics,
        "rewards": WalkerRewards,
        "style": StyleConfig,
        "paths": PathSettings,
        "easy_paths": PathSettings,
        "limits": FollowerLimits,
    }
    try:
        plain = {name: _tuples(value) for name, value in values.items() if name not in parts}
        nested = {name: kind(**_tuples(values[name])) for name, kind in parts.items()}
        return WalkerConfig(**nested, **plain)
    except (KeyError, TypeError) as error:
        raise WeightsError(f"these settings are of another version: {error}") from error


def _tuples(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _tuples(inner) for name, inner in value.items()}
    return tuple(value) if isinstance(value, list) else value


def load_walker(path: Path) -> tuple[ActorCritic, WalkerConfig, dict[str, Any]]:
    """Read a walker, its settings, and what else is known of it.

    Raises:
        WeightsError: the file is missing, broken, or does not fit its own settings.
    """
    tensors, facts = load_tensors(path)
    try:
        config = walker_config_from_dict(facts["config"])
        model = ActorCritic(facts["observations"], facts["actions"], config.hidden, config.noise)
        model.load_state_dict(tensors)
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"{path} holds no walker: {error}") from error
    return model.eval(), config, facts
