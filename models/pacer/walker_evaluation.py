"""How well a walker keeps to random paths, on its feet, and how it looks in figures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..body import describe, sample_shapes
from .courses import CourseSettings
from .paths import PathSettings, sample_paths, with_stops
from .policy import ActorCritic
from .style import Discriminator, StyleHistory, feature_count, style_features
from .walker_config import WalkerConfig
from .walker_env import WalkerEnv
from .walker_observation import TOUCHING, standing

Array = NDArray[np.float64]

PEOPLE_SEED = 90210
"""Of the people who are judged; those of training have small seeds."""
LOST = 4.0
"""m from the path at which a rollout fails, as it does in PACER."""
_RESTING = 0.2  # share of rollouts that start at rest


@dataclass(frozen=True)
class Rollouts:
    """R rollouts of T control steps; what follows an end is not a number."""

    failed: NDArray[np.bool_]
    """(R,)"""
    fell: NDArray[np.bool_]
    """(R,) on to the ground; who failed otherwise strayed from the path."""
    path_error: Array
    """(T, R) m."""
    skate: Array
    """(T, R) m/s: mean speed of sole points that touch; not a number where none does."""
    speed: Array
    """(T, R) m/s, of the pelvis along the ground."""
    strikes: NDArray[np.bool_]
    """(T, R, 2) whether the left or right foot came down."""
    power: Array
    """(T, R) W/kg."""
    style: Array
    """(T, R) reward of a discriminator as PACER reports it; not a number without one."""
    stature: Array
    """(R,) m."""
    mass: Array
    """(R,) kg."""
    period: float
    """s."""

    def summary(self) -> dict[str, Any]:
        """The figures of the paper's table 3, and foot skate; None for the style without a discriminator."""
        styled = bool(np.isfinite(self.style).any())
        return {
            "fail_rate": float(self.failed.mean()),
            "path_error_m": float(np.nanmean(self.path_error)),
            "disc_reward": float(np.nanmean(self.style)) if styled else None,
            "foot_skate_mps": float(np.nanmean(self.skate)),
            "power_w_per_kg": float(np.nanmean(self.power)),
            "rollouts": len(self.failed),
            "falls_by_cause": {
                "fell": int(self.fell.sum()),
                "strayed": int((self.failed & ~self.fell).sum()),
            },
        }


def evaluation_paths(duration: float) -> PathSettings:
    """PACER's random paths (app. B.3) up to 2 m/s, lasting that long, s, and the 6 s of waypoints after it."""
    whole = duration + 6.0
    return PathSettings(duration=whole, vertices=round(10 * whole) + 1, speed_range=(0.0, 2.0))


def roll_out(
    model: ActorCritic,
    config: WalkerConfig,
    rollouts: int,
    *,
    people: int = 30,
    duration: float = 10.0,
    paths: PathSettings | None = None,
    push: float = 0.0,
    course: CourseSettings | None = None,
    discriminator: Discriminator | None = None,
    seed: int = 0,
) -> Rollouts:
    """Walk `rollouts` random paths at once, without noise.

    Args:
        model: the walker.
        config: its settings.
        rollouts: R.
        people: different bodies, drawn from the population but for training's.
        duration: of each rollout, s.
        paths: how the paths wander; `evaluation_paths` when left out.
        course: ground to walk on; level when left out.
        discriminator: what judges style, if anything.
        push: N for 0.2 s on the chest from a random side, 3 s after the start.
        seed: of paths and pushes.
    """
    paths = paths or evaluation_paths(duration)
    config = replace(config, push_interval=0.0, paths=paths, easy_paths=paths, course=course)
    bodies = [describe(shape) for shape in sample_shapes(min(people, rollouts), PEOPLE_SEED)]
    env = WalkerEnv(config, rollouts, bodies, seed)
    start_walks(env, seed)
    steps = round(duration / env.period)
    alive, fell = np.ones(rollouts, dtype=bool), np.zeros(rollouts, dtype=bool)
    error, skate, speed, power, style = np.full((5, steps, rollouts), np.nan)
    window = discriminator.config.window if discriminator else 1
    history = StyleHistory(rollouts, feature_count(len(env.world.hinges)), window)
    strikes = np.zeros((steps, rollouts, 2), dtype=bool)
    stood = standing(env.clear).any(-1)
    rng = np.random.default_rng(seed + 1)
    for k in range(steps):
        actions = env.unmirrored(model.act(torch.from_numpy(env.observe())).numpy())
        if push and k == round(3.0 / env.period):
            env.push(np.arange(rollouts), np.full(rollouts, push), rng.uniform(-np.pi, np.pi, rollouts), 0.2)
        used = env.advance(actions)
        down = env.fallen() | ~np.isfinite(env.world.qpos).all(1)
        offsets = env.offsets
        stands = standing(env.clear).any(-1)
        fell |= alive & down
        alive &= ~down & (offsets < LOST)
        touching = (env.clear < TOUCHING).any((1, 2))
        error[k, alive], power[k, alive] = offsets[alive], used[alive]
        skate[k] = np.where(alive & touching, env.slip, np.nan)
        speed[k, alive] = np.linalg.norm(env.motion.velocity[alive, :2], axis=-1)
        if discriminator:
            history.push(style_features(env.motion))
            if k >= window:
                rewards = discriminator.paper_rewards(torch.from_numpy(history.windows)).numpy()
                style[k, alive] = rewards[alive]
        strikes[k] = stands & ~stood & alive[:, None]
        stood = stands
        env.lead()
    index = env.world.body_index
    return Rollouts(
        ~alive,
        fell,
        error,
        skate,
        speed,
        strikes,
        power,
        style,
        np.array([b.stature for b in bodies])[index],
        np.array([b.mass for b in bodies])[index],
        env.period,
    )


def start_walks(env: WalkerEnv, seed: int) -> None:
    """Put everybody at the beginning of a random path, a fifth of them at rest."""
    rng, n = np.random.default_rng(seed), len(env)
    headings = rng.uniform(-np.pi, np.pi, n)
    paths = sample_paths(env.starts(n), headings, rng, env.config.paths)
    speeds = np.linalg.norm(paths.vertices[:, 1] - paths.vertices[:, 0], axis=1) / paths.spacing
    resting = rng.random(n) < _RESTING
    paths = with_stops(paths, np.where(resting, -10.0, 1e4), np.where(resting, rng.uniform(0.2, 2.0, n), 1e4))
    everyone = np.arange(n)
    env.begin(everyone, paths, np.where(resting, 0.0, speeds), headings, rng.random(n))
    env.settle(everyone)
