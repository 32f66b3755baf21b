"""Trained walkers as safetensors files that carry their settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..trace.weights import WeightsError, load_tensors
from .batch_world import Physics
from .courses import CourseSettings
from .local_map import MapSettings
from .path_follower import FollowerLimits
from .paths import PathSettings
from .policy import ActorCritic
from .style import Discriminator
from .walker_config import StyleConfig, WalkerConfig, WalkerRewards
from .weights import load_policy

STYLE = Path(__file__).parent.parent / "weights" / "pacer_style_compact.safetensors"
"""What told the shipped walker from motion capture when its training ended."""


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
    options = {"course": CourseSettings, "map": MapSettings}
    try:
        plain = {name: _tuples(value) for name, value in values.items() if name not in parts | options}
        nested = {name: kind(**_tuples(values[name])) for name, kind in parts.items()}
        for name, kind in options.items():
            if values.get(name) is not None:
                nested[name] = kind(**_tuples(values[name]))
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
    return load_policy(path, "walker", walker_config_from_dict)


def load_discriminator(path: Path) -> Discriminator:
    """Read what judges style.

    Raises:
        WeightsError: the file is missing, broken, or does not fit its own settings.
    """
    tensors, facts = load_tensors(path)
    try:
        config = walker_config_from_dict(facts["config"]).style
        model = Discriminator(len(tensors["normalizer.mean"]), config)
        model.load_state_dict(tensors)
    except (KeyError, RuntimeError) as error:
        raise WeightsError(f"{path} holds no discriminator: {error}") from error
    return model.eval()


def grown(tensors: dict[str, Tensor], size: int, at: int) -> dict[str, Tensor]:
    """Weights of the same walker with more to see: new inputs count for nothing until it learns.

    Args:
        tensors: of an `ActorCritic`.
        size: of an observation, with the new columns.
        at: where those come in.

    Raises:
        WeightsError: the walker sees more than that already.
    """
    more = size - len(tensors["normalizer.mean"])
    if more < 0:
        raise WeightsError(f"a walker that sees {size - more} numbers cannot be made to see {size}")
    out = dict(tensors)
    for name, fill in (("normalizer.mean", 0.0), ("normalizer.variance", 1.0)):
        out[name] = _inserted(tensors[name], at, more, fill)
    for name in ("actor.0.weight", "critic.0.weight"):
        out[name] = _inserted(tensors[name], at, more, 0.0)
    return out


def _inserted(tensor: Tensor, at: int, more: int, fill: float) -> Tensor:
    """The tensor with `more` columns of one value before column `at`."""
    new = tensor.new_full((*tensor.shape[:-1], more), fill)
    return torch.cat([tensor[..., :at], new, tensor[..., at:]], -1)
