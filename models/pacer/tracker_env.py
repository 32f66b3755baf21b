"""Many worlds whose people imitate reference motions: reset, step, reward (DeepMimic, PACER+)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..body import JOINT_GAINS
from ..motion.library import MotionLibrary
from .batch_world import EVERYONE, BatchWorld
from .body_masks import sample_masks
from .clip_sampler import ClipSampler
from .config import TrackerConfig
from .mathops import lengths, turn_between
from .tracker_observation import Reference, TrackerObservation, sole_heights, standing

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_FALLEN = 0.55  # of the standing pelvis' height
_JITTER = (0.02, 0.05)  # rad and rad/s: spread of initial joint angles and velocities


@dataclass(frozen=True)
class Step:
    """What one control step brought, for N worlds."""

    observations: Floats
    """(N, size) to act on next; after the reset where an episode ended."""
    rewards: Floats
    """(N,) in [0, 1]."""
    failed: NDArray[np.bool_]
    """(N,) the reference was lost: the episode ends and no reward follows."""
    cut: NDArray[np.bool_]
    """(N,) the episode was cut or its clip ended, while reward would have gone on."""
    cut_observations: Floats
    """(number of cut worlds, size): what was seen at the end of those."""
    terms: dict[str, float]
    """``term_NAME``: mean of each reward term, between 0 and 1."""


@dataclass(frozen=True)
class TrackingError:
    """How far worlds (n,) are from their references."""

    places: Array
    """(n, 24) m: of each joint, in the world."""
    relative: Array
    """(n, 24) m: of each joint from the pelvis."""


class TrackerEnv:
    """N worlds that track clips of a library; worlds whose episode ends begin another at once.

    An action (N, H) shifts the PD targets away from the reference's next pose; for hinges of bodies that
    are not told, away from the person's ordinary pose.

    Args:
        config: settings.
        library: clips and bodies.
        worlds: N; that of the settings when left out.
        seed: of all random choices.
    """

    def __init__(
        self, config: TrackerConfig, library: MotionLibrary, worlds: int | None = None, seed: int = 0
    ):
        self.config = config
        self.library = library
        self.world = BatchWorld(library.bodies, worlds or config.worlds, config.physics)
        self.sampler = ClipSampler(library, config.narrow_start, config.widen_below)
        self.observation = TrackerObservation(self.world, library, config.lookahead)
        self.size = self.observation.size
        """How many numbers an observation has."""
        self.n_actions = len(self.world.hinges)
        self.period = config.physics.control_period
        self._rng = np.random.default_rng(seed)
        count = len(self.world)
        self.clips = np.zeros(count, dtype=np.intp)
        """(N,) clip each world tracks."""
        self._frame = np.zeros(count, dtype=np.intp)
        self._begun = np.zeros(count, dtype=np.intp)
        self._last = np.zeros(count, dtype=np.intp)
        self._age = np.zeros(count, dtype=np.intp)
        self._mask = np.ones((count, 24), dtype=bool)
        self._hinge_body = 1 + self.world.hinges // 3
        self._soles = np.array([body.sole for body in library.bodies])
        self._fallen = _FALLEN * np.array([b.pelvis_height for b in library.bodies])[self.world.body_index]
        self._joints = np.ascontiguousarray(library.joints[:, :, self.world.hinges])  # (K, F, H)
        self._rates = np.ascontiguousarray(library.joint_velocities[:, :, self.world.hinges])
        kp, kd, _ = JOINT_GAINS[self.world.hinges].T
        self._targets = self._joints + config.lead * (kd / kp) * self._rates
        self._idle = np.median(self._joints, axis=1)  # (K, H)

    def __len__(self) -> int:
        return len(self.world)

    @property
    def reference(self) -> Reference:
        """Where every world is in its clip."""
        return Reference(self._frame, self._last, self._mask)

    def reset(self) -> Floats:
        """Begin an episode in every world; spread their ages so that they do not all end together."""
        self._begin(np.arange(len(self.world)))
        self._age = self._rng.integers(0, self.config.episode // 2, len(self.world))
        return self.observe()

    def observe(self) -> Floats:
        """Observations (N, size) of the present state."""
        return self.observation.build(EVERYONE, self.reference)

    def place(
        self,
        ids: NDArray[np.intp],
        clips: NDArray[np.intp],
        frames: NDArray[np.intp],
        jitter: bool = False,
        masks: NDArray[np.bool_] | None = None,
    ) -> None:
        """Put worlds (n,) on to frames (n,) of clips (n,), telling the whole body or masks (n, 24)."""
        library, body = self.library, self.world.body_index[ids]
        start = library.starts[clips]
        frame = start + frames
        self.clips[ids], self._frame[ids], self._age[ids] = clips, frame, 0
        self._begun[ids] = frames
        self._last[ids] = start + library.lengths[clips] - 1
        self._mask[ids] = True if masks is None else masks
        joints, rates = library.joints[body, frame], library.joint_velocities[body, frame]
        if jitter:
            joints = joints + self._rng.normal(0.0, _JITTER[0], joints.shape)
            rates = rates + self._rng.normal(0.0, _JITTER[1], rates.shape)
        self.world.reset(ids, library.root[body, frame], joints, library.root_velocity[body, frame], rates)

    def targets(self, actions: Floats) -> Array:
        """PD targets (N, H), rad, of actions (N, H)."""
        body = self.world.body_index
        ahead = np.minimum(self._frame + 1, self._last)
        told = self._mask[:, self._hinge_body]
        base: Array = np.where(told, self._targets[body, ahead], self._idle[body])
        return base + self.config.action_scale * actions

    def advance(self, actions: Floats) -> None:
        """Let one control step pass; no reward, no reset."""
        self.world.step(self.targets(actions))
        self._frame += 1
        self._age += 1

    def step(self, actions: Floats) -> Step:
        """Let one control step pass, judge it, and begin anew where an episode ended."""
        self.advance(actions)
        errors = self.errors()
        rewards, terms = self.rewards(errors)
        failed = self.lost(errors) | ~np.isfinite(rewards)
        cut = ~failed & ((self._frame >= self._last) | (self._age >= self.config.episode))
        ended = np.flatnonzero(failed | cut)
        left = np.flatnonzero(cut)
        cut_observations = np.zeros((0, self.observation.size), dtype=np.float32)
        if len(left):
            cut_observations = self.observation.build(left, self.reference.take(left))
        if len(ended):
            self.sampler.report(self.clips[ended], self._begun[ended], failed[ended])
            self._begin(ended)
        observations = self.observe()
        rewards = np.nan_to_num(rewards).astype(np.float32)
        named = {f"term_{name}": value for name, value in terms.items()}
        return Step(observations, rewards, failed, cut, cut_observations, named)

    def errors(self) -> TrackingError:
        """Distances of all joints from the reference."""
        there = self.library.states_at(self.world.body_index, self._frame)[..., :3]
        gap = self.world.positions - there
        return TrackingError(lengths(gap), lengths(gap - gap[:, :1]))

    def lost(self, errors: TrackingError) -> NDArray[np.bool_]:
        """Whether worlds (N,) fell or are too far from what they were told."""
        distance = self._mean(errors.places, self._mask)
        return self.fallen() | ~(distance < self.config.lost)

    def fallen(self) -> NDArray[np.bool_]:
        """Whether the pelvis of worlds (N,) is far below its standing height."""
        return ~(self.world.qpos[:, 2] > self._fallen)

    def hold_at_end(self) -> None:
        """Let worlds past the end of their clip stay at its last frame."""
        self._frame = np.minimum(self._frame, self._last)

    def rewards(self, errors: TrackingError) -> tuple[Array, dict[str, float]]:
        """Rewards (N,) of the present state, and the mean of each term."""
        world, library, body, frame = self.world, self.library, self.world.body_index, self._frame
        twist = library.root_velocity[body, frame]
        pose = library.root[body, frame]
        told = self._mask[:, self._hinge_body]
        joints = world.joints - self._joints[body, frame]
        rates = world.joint_velocities - self._rates[body, frame]
        place = world.qpos[:, :3] - pose[:, :3]
        velocity = world.qvel[:, :3] - twist[:, :3]
        spin = world.pelvis_spin(EVERYONE) - twist[:, 3:]
        contacts = standing(sole_heights(world, EVERYONE, self._soles)) != library.contacts[frame]
        gaps = {
            "places": self._mean(np.square(errors.relative), self._mask),
            "joints": self._mean(np.square(joints), told),
            "root": _square(place) + 0.3 * np.square(turn_between(world.qpos[:, 3:7], pose[:, 3:])),
            "root_velocity": _square(velocity) + 0.1 * _square(spin),
            "joint_velocities": self._mean(np.square(rates), told),
            "contacts": contacts.reshape(len(contacts), -1).mean(1),
        }
        total, means = np.zeros(len(world)), {}
        for name, error in gaps.items():
            weight, sharpness = getattr(self.config.rewards, name)
            term = np.exp(-sharpness * error)
            total += weight * term
            means[name] = float(term.mean())
        return total, means

    def _begin(self, ids: NDArray[np.intp]) -> None:
        clips, frames = self.sampler.sample(len(ids), self._rng)
        masks = sample_masks(len(ids), self.config.masked, self._rng)
        self.place(ids, clips, frames, jitter=True, masks=masks)

    @staticmethod
    def _mean(values: Array, mask: NDArray[np.bool_]) -> Array:
        """Mean (N,) over what is told; zero where nothing is."""
        return np.einsum("nj,nj->n", values, mask) / np.maximum(mask.sum(1), 1)


def _square(vectors: Array) -> Array:
    return np.einsum("nk,nk->n", vectors, vectors)
