"""Steady walking in figures: cadence, step length and symmetry by speed, beside what people do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..body import describe, sample_shapes
from .paths import Paths
from .policy import ActorCritic
from .walker_config import WalkerConfig
from .walker_env import WalkerEnv
from .walker_evaluation import PEOPLE_SEED
from .walker_observation import standing

Array = NDArray[np.float64]

WALK_RATIO = 0.0065
"""m per (step / min): step length over cadence, which adults keep at all speeds (Sekiya et al. 1996)."""
_SETTLING = 4.0  # s before anything is counted
_LEAST = 0.2  # s between two strikes of a foot


@dataclass(frozen=True)
class Steps:
    """How people walk straight on at one speed."""

    wanted: float
    """m/s."""
    speed: float
    """m/s, of those who did not fall."""
    cadence: float
    """Steps per s."""
    asymmetry: float
    """Difference of the times from left to right and right to left strike, over their mean."""
    skate: float
    """m/s: mean speed of sole points that touch."""
    standing: float
    """Share of people on their feet at the end."""

    @property
    def step_length(self) -> float:
        """M."""
        return self.speed / self.cadence

    @property
    def usual_cadence(self) -> float:
        """Steps per s of people at this speed."""
        return float(np.sqrt(self.speed / WALK_RATIO / 60.0))

    @property
    def usual_step_length(self) -> float:
        """m, of people at this speed."""
        return self.speed / self.usual_cadence


def measure_steps(
    model: ActorCritic,
    config: WalkerConfig,
    speeds: Sequence[float] = (0.8, 1.1, 1.4, 1.7),
    people: int = 10,
    duration: float = 14.0,
) -> list[Steps]:
    """Let people walk straight on at each speed, m/s, without noise or pushes."""
    config = replace(config, push_interval=0.0, course=None, company=1)
    bodies = [describe(shape) for shape in sample_shapes(people, PEOPLE_SEED)]
    env = WalkerEnv(config, people * len(speeds), bodies)
    wanted = np.repeat(speeds, people)
    everyone = np.arange(len(env))
    time = np.linspace(0.0, config.paths.duration, config.paths.vertices)
    ways = np.zeros((len(env), len(time), 2))
    ways[..., 0] = wanted[:, None] * time
    env.begin(everyone, Paths(ways, config.paths.duration), wanted, np.zeros(len(env)), everyone / len(env))
    env.settle(everyone)
    feet, slips, places = [], [], []
    alive = np.ones(len(env), dtype=bool)
    for _ in range(round(min(duration, config.paths.duration - 0.5) / env.period)):
        env.advance(env.unmirrored(model.act(torch.from_numpy(env.observe())).numpy()))
        env.lead()
        alive &= ~env.fallen()
        feet.append(standing(env.clear).any(-1))
        slips.append(env.slip)
        places.append(env.motion.positions[:, 0, 0].copy())
    first = round(_SETTLING / env.period)
    stands, moved, slip = np.array(feet)[first:], np.array(places)[first:], np.array(slips)[first:]
    results = []
    for k, speed in enumerate(speeds):
        rows = slice(k * people, (k + 1) * people)
        who = np.flatnonzero(alive[rows]) + rows.start
        strikes = [_strikes(stands[:, i], env.period) for i in who]
        seconds = len(stands) * env.period
        results.append(
            Steps(
                speed,
                float(np.mean((moved[-1, who] - moved[0, who]) / seconds)) if len(who) else np.nan,
                float(np.mean([len(left) + len(right) for left, right in strikes]) / seconds)
                if strikes
                else np.nan,
                float(np.nanmean([_asymmetry(*both) for both in strikes])) if strikes else np.nan,
                float(slip[:, who].mean()) if len(who) else np.nan,
                float(alive[rows].mean()),
            )
        )
    return results


def _strikes(stands: NDArray[np.bool_], period: float) -> tuple[Array, Array]:
    """Times, s, at which the left and the right foot (T, 2) come down."""
    times = []
    for foot in stands.T:
        down = (np.flatnonzero(foot[1:] & ~foot[:-1]) + 1) * period
        kept: list[float] = []
        for time in down.tolist():
            if not kept or time - kept[-1] > _LEAST:
                kept.append(time)
        times.append(np.array(kept))
    return times[0], times[1]


def _asymmetry(left: Array, right: Array) -> float:
    """Difference of left-to-right and right-to-left step times over their mean; nan for too few steps."""
    if len(left) < 3 or len(right) < 3:
        return float("nan")
    after = np.searchsorted(right, left)
    keep = (after > 0) & (after < len(right))
    to_right = right[after[keep]] - left[keep]
    to_left = left[keep] - right[after[keep] - 1]
    one, other = float(np.median(to_right)), float(np.median(to_left))
    return abs(one - other) / (0.5 * (one + other))
