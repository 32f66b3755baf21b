"""Trained trackers as safetensors files that carry their settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

from ..trace.weights import WeightsError, load_tensors
from .batch_world import Physics
from .config import RewardTerms, TrackerConfig
from .policy import ActorCritic

TRACKER = Path(__file__).parent.parent / "weights" / "tracker_compact.safetensors"
"""The tracker that comes with footfall."""


class PolicyConfig(Protocol):
    """What settings say of a policy's networks."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        ...

    @property
    def noise(self) -> float:
        """Standard deviation of actions."""
        ...


C = TypeVar("C", bound=PolicyConfig)


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
    return load_policy(path, "tracker", config_from_dict)


def load_policy(
    path: Path, what: str, read: Callable[[dict[str, Any]], C]
) -> tuple[ActorCritic, C, dict[str, Any]]:
    """Read an actor and its critic, their settings, and what else is known of them.

    Args:
        path: safetensors file.
        what: it ought to hold, for errors.
        read: makes settings of the file's.

    Raises:
        WeightsError: the file is missing, broken, or does not fit its own settings.
    """
    tensors, facts = load_tensors(path)
    try:
        config = read(facts["config"])
        model = ActorCritic(facts["observations"], facts["actions"], config.hidden, config.noise)
        model.load_state_dict(tensors)
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"{path} holds no {what}: {error}") from error
    return model.eval(), config, facts
