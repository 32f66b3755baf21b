"""Several processes that train one model together (`torchrun`); alone, every function returns what it was given."""

from __future__ import annotations

from collections.abc import Iterable

import torch
import torch.distributed as dist
from torch import Tensor


def count() -> int:
    """How many processes train together."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def number() -> int:
    """Which of them this is, from 0."""
    return dist.get_rank() if count() > 1 else 0


def average(tensors: Iterable[Tensor]) -> None:
    """Replace every tensor by its mean over the processes, in place."""
    if count() == 1:
        return
    parts = list(tensors)
    whole = torch.cat([part.reshape(-1) for part in parts])
    dist.all_reduce(whole)
    whole /= count()
    for part, mean in zip(parts, whole.split([part.numel() for part in parts]), strict=True):
        part.copy_(mean.view_as(part))


def mean(value: float) -> float:
    """Mean of a number over the processes."""
    if count() == 1:
        return value
    total = torch.tensor(value, dtype=torch.float64)
    dist.all_reduce(total)
    return float(total) / count()


def gathered(rows: Tensor) -> Tensor:
    """The rows (n, ...) of all processes, (count * n, ...); each brings as many."""
    if count() == 1:
        return rows
    parts = [torch.empty_like(rows) for _ in range(count())]
    dist.all_gather(parts, rows.contiguous())
    return torch.cat(parts)


def agreed(wish: bool) -> bool:
    """Whether any process wishes it: all must leave a loop at the same step."""
    return mean(float(wish)) > 0.0
