"""How well a walker keeps to random paths, on its feet, and how it looks in figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..body import N_BODIES, Body, describe, sample_shapes
from ..gait.footholds import HeightAt
from .courses import Course
from .paths import PathSettings, sample_paths, with_stops
from .policy import ActorCritic
from .style import Discriminator, StyleHistory, feature_count, style_features
from .walker_config import WalkerConfig
from .walker_env import WalkerEnv
from .walker_observation import TOUCHING, Motion, People, clearance, standing
from .walker_rewards import slip_speed

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
    """(R,) on to the ground."""
    hit: NDArray[np.bool_]
    """(R,) somebody or something; who failed otherwise strayed from the path."""
    path_error: Array
    """(T, R) m."""
    skate: Array
    """(T, R) m/s: mean speed of sole points that touch; not a number where none does."""
    speed: Array
    """(T, R) m/s, of the pelvis along the ground."""
    strikes: NDArray[np.bool_]
    """(T, R, 2) whether the left or right foot came down."""
    power: Array
    """(T, R) W/kg; not a number where it was not measured."""
    jerk: Array
    """(T, R) m/s^3: mean over the joints of the third difference of their places."""
    style: Array
    """(T, R) reward of a discriminator as PACER reports it; not a number without one."""
    stature: Array
    """(R,) m."""
    mass: Array
    """(R,) kg."""
    ends: Array
    """(R, 2) m, world: where each was last on their feet."""
    period: float
    """s."""

    def summary(self) -> dict[str, Any]:
        """The figures of the paper's table 3, and foot skate; None for the style without a discriminator."""
        return {
            "fail_rate": float(self.failed.mean()),
            "path_error_m": float(np.nanmean(self.path_error)),
            "disc_reward": _mean(self.style),
            "foot_skate_mps": _mean(self.skate),
            "power_w_per_kg": _mean(self.power),
            "jerk_mps3": _mean(self.jerk),
            "rollouts": len(self.failed),
            "falls_by_cause": {
                "fell": int(self.fell.sum()),
                "hit": int(self.hit.sum()),
                "strayed": int((self.failed & ~self.fell & ~self.hit).sum()),
            },
            "fail_rate_by_body": {
                name: _mean(self.failed[who].astype(float)) for name, who in self._builds().items()
            },
        }

    def _builds(self) -> dict[str, NDArray[np.bool_]]:
        """Who (R,) is short or tall, light or heavy for their stature."""
        bulk = self.mass / self.stature**2
        short, light = self.stature < np.median(self.stature), bulk < np.median(bulk)
        return {"short": short, "tall": ~short, "light": light, "heavy": ~light}

    @classmethod
    def joined(cls, parts: Sequence[Rollouts]) -> Rollouts:
        """All rollouts of some, which last equally long."""
        names = [field.name for field in fields(cls) if field.name != "period"]
        arrays = {name: [getattr(part, name) for part in parts] for name in names}
        whole = {n: np.concatenate(a, axis=1 if a[0].ndim > 1 else 0) for n, a in arrays.items()}
        return cls(**whole, period=parts[0].period)


def _mean(values: Array) -> float | None:
    """Mean of what was measured."""
    return float(np.nanmean(values)) if np.isfinite(values).any() else None


class Measurement:
    """What R people do, step by step.

    Args:
        bodies: (R,) theirs.
        hinges: (H,) which hinges exist.
        steps: T.
        period: s.
        height_at: ground height (m,), m, at world points (m, 2).
        discriminator: what judges style, if anything.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        hinges: NDArray[np.intp],
        steps: int,
        period: float,
        height_at: HeightAt,
        discriminator: Discriminator | None = None,
    ):
        count = len(bodies)
        self.people = People.of(bodies)
        self.steps, self._bodies, self._period, self._height_at = steps, bodies, period, height_at
        self._fell: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self._hit: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self._error, self._skate, self._speed, self._power, self._jerk, self._style = np.full(
            (6, steps, count), np.nan
        )
        self._trail = np.full((3, count, N_BODIES, 3), np.nan)  # where joints were, latest first
        self._strikes = np.zeros((steps, count, 2), dtype=bool)
        self._ends = np.zeros((count, 2))
        self._discriminator = discriminator
        self._window = discriminator.config.window if discriminator else 1
        self._history = StyleHistory(count, feature_count(len(hinges)), self._window)
        self._features = np.zeros((count, feature_count(len(hinges))), dtype=np.float32)

    def begin(self, motion: Motion) -> None:
        """See everybody where they start."""
        self._points = motion.sole_points(self.people.soles)
        self._clear = clearance(self._points, self._height_at)
        self._trail[0] = motion.positions

    def add(
        self,
        k: int,
        motion: Motion,
        ids: NDArray[np.intp],
        alive: NDArray[np.bool_],
        offsets: Array,
        fell: NDArray[np.bool_],
        hit: NDArray[np.bool_],
        power: Array | None = None,
    ) -> None:
        """Take in a step.

        Args:
            k: its number.
            motion: of people (n,) after it.
            ids: (n,) who they are; all that have not failed before.
            alive: (n,) who has still not failed.
            offsets: (n,) m from the path.
            fell: (n,) who has just fallen.
            hit: (n,) who has just hit somebody or something.
            power: (n,) W/kg.
        """
        points = motion.sole_points(self.people.soles[ids])
        clear = clearance(points, self._height_at)
        slip = slip_speed(points, self._points[ids], clear, self._clear[ids], self._period)
        stood, stands = standing(self._clear[ids]).any(-1), standing(clear).any(-1)
        self._points[ids], self._clear[ids] = points, clear
        self._fell[ids], self._hit[ids] = fell, hit
        self._ends[ids] = motion.positions[:, 0, :2]
        on = ids[alive]
        touching = (clear < TOUCHING).any((1, 2))
        self._error[k, on] = offsets[alive]
        self._skate[k, on] = np.where(touching, slip, np.nan)[alive]
        self._speed[k, on] = np.linalg.norm(motion.velocity[alive, :2], axis=-1)
        self._strikes[k, on] = np.asarray(stands & ~stood)[alive]
        last, second, third = self._trail[:, ids]
        change = (motion.positions - third - 3.0 * (last - second)) / self._period**3
        self._jerk[k, on] = np.linalg.norm(change, axis=-1).mean(-1)[alive]
        self._trail[:, ids] = np.stack([motion.positions, last, second])
        if power is not None:
            self._power[k, on] = power[alive]
        if self._discriminator:
            self._features[ids] = style_features(motion)
            self._history.push(self._features)
            if k >= self._window:
                windows = torch.from_numpy(self._history.windows[on])
                self._style[k, on] = self._discriminator.paper_rewards(windows).numpy()

    def result(self, failed: NDArray[np.bool_]) -> Rollouts:
        """All of it, for people of whom those marked (R,) have failed."""
        return Rollouts(
            failed,
            self._fell,
            self._hit,
            self._error,
            self._skate,
            self._speed,
            self._strikes,
            self._power,
            self._jerk,
            self._style,
            np.array([body.stature for body in self._bodies]),
            np.array([body.mass for body in self._bodies]),
            self._ends,
            self._period,
        )


def evaluation_paths(duration: float) -> PathSettings:
    """PACER's random paths (app. B.3) up to 2 m/s, lasting that long, s, and the 6 s of waypoints after it."""
    whole = duration + 6.0
    return PathSettings(duration=whole, vertices=round(10 * whole) + 1, speed_range=(0.0, 2.0))


def stroll_paths(duration: float) -> PathSettings:
    """Ways of people who have somewhere to go, 0.9 to 1.5 m/s and gentle bends, as long as `evaluation_paths`."""
    return replace(
        evaluation_paths(duration), turn_rate=0.4, sharp_turn=0.0, acceleration=0.4, speed_range=(0.9, 1.5)
    )


def roll_out(
    model: ActorCritic,
    config: WalkerConfig,
    rollouts: int,
    *,
    people: int = 30,
    bodies: Sequence[Body] | None = None,
    duration: float = 10.0,
    paths: PathSettings | None = None,
    push: float = 0.0,
    course: Course | None = None,
    discriminator: Discriminator | None = None,
    seed: int = 0,
) -> Rollouts:
    """Walk `rollouts` random paths at once, without noise.

    Args:
        model: the walker.
        config: its settings.
        rollouts: R.
        people: different bodies, drawn from the population but for training's.
        bodies: who walks, if not those.
        duration: of each rollout, s.
        paths: how the paths wander; `evaluation_paths` when left out.
        course: ground to walk on; level when left out.
        discriminator: what judges style, if anything.
        push: N for 0.2 s on the chest from a random side, 3 s after the start.
        seed: of paths and pushes.
    """
    paths = paths or evaluation_paths(duration)
    config = replace(config, push_interval=0.0, paths=paths, easy_paths=paths, company=1, course=None)
    bodies = bodies or [describe(shape) for shape in sample_shapes(min(people, rollouts), PEOPLE_SEED)]
    env = WalkerEnv(config, rollouts, bodies, seed, course)
    start_walks(env, seed)
    everybody = [bodies[i] for i in env.world.body_index]
    steps = round(duration / env.period)
    measurement = Measurement(everybody, env.world.hinges, steps, env.period, env.height_at, discriminator)
    measurement.begin(env.motion)
    alive = np.ones(rollouts, dtype=bool)
    rng = np.random.default_rng(seed + 1)
    for k in range(steps):
        actions = env.unmirrored(model.act(torch.from_numpy(env.observe())).numpy())
        if push and k == round(3.0 / env.period):
            env.push(np.arange(rollouts), np.full(rollouts, push), rng.uniform(-np.pi, np.pi, rollouts), 0.2)
        power = env.advance(actions)
        down = env.fallen() | ~np.isfinite(env.world.qpos).all(1)
        ids, offsets = np.flatnonzero(alive), env.offsets
        going = ~down & (offsets < LOST)
        nobody = np.zeros(len(ids), dtype=bool)
        measurement.add(k, env.motion.take(ids), ids, going[ids], offsets[ids], down[ids], nobody, power[ids])
        alive &= going
        env.lead()
    return measurement.result(~alive)


def start_walks(env: WalkerEnv, seed: int) -> None:
    """Put everybody at the beginning of a random path, a fifth of them at rest."""
    rng, n = np.random.default_rng(seed), len(env)
    headings = rng.uniform(-np.pi, np.pi, n)
    paths = sample_paths(env.starts.anywhere(n), headings, rng, env.config.paths)
    speeds = paths.first_speeds
    resting = rng.random(n) < _RESTING
    paths = with_stops(paths, np.where(resting, -10.0, 1e4), np.where(resting, rng.uniform(0.2, 2.0, n), 1e4))
    everyone = np.arange(n)
    env.begin(everyone, paths, np.where(resting, 0.0, speeds), headings, rng.random(n))
    env.settle(everyone)
