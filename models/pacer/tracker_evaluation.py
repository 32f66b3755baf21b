"""How well a tracker follows every clip of a library from beginning to end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..motion.library import MotionLibrary
from .config import TrackerConfig
from .policy import ActorCritic
from .tracker_env import TrackerEnv

_LOST = 0.5  # m: mean distance of the joints at which a clip counts as lost (PHC, Luo et al. 2023)


@dataclass(frozen=True)
class Evaluation:
    """Per clip (C,), in the order of the library."""

    tracked: NDArray[np.bool_]
    """Whether the clip was followed to its end, never farther than `_LOST` from it."""
    fell: NDArray[np.bool_]
    """Whether the person fell before its end, near the clip or not."""
    seconds: NDArray[np.float64]
    """s followed."""
    error: NDArray[np.float64]
    """m: mean distance of the 24 joints from the reference in the world, while it was followed."""
    relative_error: NDArray[np.float64]
    """m: the same, both seen from the pelvis."""

    def take(self, clips: NDArray[np.bool_]) -> Evaluation:
        """That of some of the clips, marked (C,)."""
        return Evaluation(
            self.tracked[clips],
            self.fell[clips],
            self.seconds[clips],
            self.error[clips],
            self.relative_error[clips],
        )

    def summary(self) -> dict[str, float]:
        """Shares and means over clips; errors in mm."""
        return {
            "share of clips tracked to end": float(self.tracked.mean()),
            "share of clips without a fall": float(1.0 - self.fell.mean()),
            "mean joint error mm": 1e3 * float(np.nanmean(self.relative_error)),
            "mean joint error in the world mm": 1e3 * float(np.nanmean(self.error)),
            "seconds followed": float(self.seconds.mean()),
        }


def evaluate(
    model: ActorCritic,
    library: MotionLibrary,
    config: TrackerConfig,
    worlds: int = 128,
    mask: NDArray[np.bool_] | None = None,
) -> Evaluation:
    """Track every clip once from its first frame, without noise.

    Args:
        model: the tracker.
        library: the clips.
        config: settings the tracker was trained with.
        worlds: simulated at once.
        mask: (24,) bodies that are told; all when left out.
    """
    count = len(library)
    env = TrackerEnv(replace(config, masked=0.0), library, min(worlds, count))
    tracked, fell = np.zeros((2, count), dtype=bool)
    seconds = np.zeros(count)
    error, relative = np.full((2, count), np.nan)
    for first in range(0, count, len(env.world)):
        clips = np.arange(first, min(first + len(env.world), count))
        ids = np.arange(len(env.world))
        follow = np.concatenate([clips, np.full(len(ids) - len(clips), clips[0])])
        masks = None if mask is None else np.tile(mask, (len(ids), 1))
        env.place(ids, follow, np.zeros(len(ids), dtype=np.intp), masks=masks)
        alive, upright = np.ones((2, len(ids)), dtype=bool)
        sums, steps = np.zeros((2, len(ids))), np.zeros(len(ids))
        lengths = library.lengths[follow]
        for k in range(1, int(lengths.max())):
            seen = torch.from_numpy(env.observe())
            env.advance(model.act(seen).numpy())
            env.hold_at_end()
            errors = env.errors()
            going = k < lengths
            upright &= ~(going & env.fallen())
            alive &= ~(going & ~(errors.places.mean(1) < _LOST)) & upright
            running = going & alive
            sums[:, running] += np.stack([errors.places.mean(1), errors.relative[:, 1:].mean(1)])[:, running]
            steps[running] += 1
            if not (upright & (k + 1 < lengths)).any():
                break
        rows = slice(0, len(clips))
        tracked[clips], fell[clips] = alive[rows], ~upright[rows]
        seconds[clips] = steps[rows] / library.rate_hz
        means = sums[:, rows] / np.where(steps[rows] > 0, steps[rows], np.nan)
        error[clips], relative[clips] = means
    return Evaluation(tracked, fell, seconds, error, relative)
