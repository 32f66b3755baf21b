"""Trained denoisers as safetensors files that carry their configuration and history."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from .config import TraceConfig
from .network import ActionModel, Trace


class WeightsError(ValueError):
    """A file of weights is missing, broken or belongs to another model."""


def save_tensors(path: Path, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
    """Write tensors and JSON facts atomically; the folder is made if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    save_file({k: v.detach().contiguous() for k, v in tensors.items()}, part, {"facts": json.dumps(facts)})
    part.replace(path)


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `save_tensors` wrote.

    Raises:
        WeightsError: When the file is missing or no such file.
    """
    if not Path(path).is_file():
        raise WeightsError(f"there are no weights at {path}")
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads((file.metadata() or {})["facts"])
            return {key: file.get_tensor(key) for key in file.keys()}, facts  # noqa: SIM118
    except (SafetensorError, KeyError, OSError, json.JSONDecodeError) as error:
        raise WeightsError(f"{path} holds no TRACE weights: {error}") from error


def save_model(path: Path, model: ActionModel, facts: dict[str, Any], half: bool = False) -> None:
    """Write a denoiser; `facts` tell how it was trained. `half` writes what was learned in float16."""
    tensors = model.state_dict()
    if half:
        tensors |= {name: parameter.half() for name, parameter in model.named_parameters()}
    save_tensors(path, tensors, {"config": model.config.to_dict(), **facts})


def load_model(path: Path) -> tuple[Trace, dict[str, Any]]:
    """Read a denoiser, ready for inference, and its facts.

    Raises:
        WeightsError: When the file is missing, broken, or does not fit its own configuration.
    """
    tensors, facts = load_tensors(path)
    try:
        model = Trace(TraceConfig.from_dict(facts["config"]))
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise WeightsError(f"{path} has no TRACE configuration: {error}") from error
    if fault := _misfit(tensors, model.state_dict()):
        name = model.config.name
        raise WeightsError(f"{path} does not fit its own configuration {name!r}: {fault}")
    model.load_state_dict(tensors)
    for parameter in model.parameters():
        parameter.requires_grad_(False)
    return model.eval().to(torch.float32), facts


def _misfit(tensors: dict[str, Tensor], wanted: dict[str, Tensor]) -> str | None:
    """The first difference between the tensors there are and those a model has."""
    for name, tensor in wanted.items():
        if name not in tensors:
            return f"it lacks {name}"
        if tensors[name].shape != tensor.shape:
            return f"{name} is {tuple(tensors[name].shape)}, must be {tuple(tensor.shape)}"
    extra = sorted(tensors.keys() - wanted.keys())
    return f"{extra[0]} has no place in it" if extra else None
