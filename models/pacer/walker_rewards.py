"""What a walker is rewarded for, and when it has failed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..body import BODY_INDEX
from ..gait.footholds import HeightAt
from .gait_reference import GaitReference
from .mathops import turn_between
from .walker_config import WalkerRewards
from .walker_observation import TOUCHING, Motion, People, standing

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LOW_PELVIS, _LOW_HEAD = 0.55, 0.60  # of the standing heights, as the simulator judges falls
_HANDS = [BODY_INDEX[n] for n in ("L_Hand", "R_Hand", "L_Elbow", "R_Elbow")]
_KNEES = [BODY_INDEX["L_Knee"], BODY_INDEX["R_Knee"]]
_HAND_CLEARANCE, _KNEE_CLEARANCE = 0.06, 0.08  # m: half their thickness and a little


def reward_errors(
    motion: Motion,
    spin_gap: Array,
    reference: GaitReference,
    targets: Array,
    hinges: NDArray[np.intp],
    clear: Array,
    slip: Array,
    power: Array,
    change: Array,
) -> dict[str, Array]:
    """Errors (N,) of each term of `WalkerRewards`.

    Args:
        motion: now.
        spin_gap: (N, 3) rad/s: spin of the pelvis beyond the reference's.
        reference: where the gait is now.
        targets: (N, 2) m: where the path is now.
        hinges: (H,) which hinges exist.
        clear: (N, 2, 5) m: clearances of the sole points.
        slip: (N,) m/s: mean speed of sole points that touch.
        power: (N,) W/kg.
        change: (N, H) of the action since the last step.
    """
    offset = motion.positions[:, 0, :2] - targets
    place = motion.positions[:, 0] - reference.root[:, :3]
    velocity = motion.velocity - reference.velocity
    return {
        "path": _square(offset),
        "place": _square(place),
        "upright": np.square(turn_between(motion.quaternions[:, 0], reference.root[:, 3:])),
        "joints": np.square(motion.joints - reference.joints[:, hinges]).mean(1),
        "velocity": _square(velocity) + 0.1 * _square(spin_gap),
        "contacts": (standing(clear) != reference.contacts).reshape(len(clear), -1).mean(1),
        "skate": slip,
        "effort": power,
        "calm": np.square(change).mean(1),
    }


def weigh(errors: dict[str, Array], rewards: WalkerRewards) -> tuple[Array, dict[str, Array]]:
    """Sum (N,) of the weighted terms, and the terms, each between 0 and 1."""
    terms, total = {}, 0.0
    for name, error in errors.items():
        weight, sharpness = getattr(rewards, name)
        terms[name] = np.exp(-sharpness * error)
        total = total + weight * terms[name]
    return np.asarray(total), terms


def slip_speed(points: Array, before: Array, clear: Array, clear_before: Array, period: float) -> Array:
    """Mean speed (N,) of the sole points that touch the ground at both moments, m/s; 0 where none does.

    Args:
        points: (N, 2, 5, 3) m, world.
        before: the same a control step ago.
        clear: (N, 2, 5) their clearances, m.
        clear_before: a control step ago.
        period: s.
    """
    touch = (clear < TOUCHING) & (clear_before < TOUCHING)
    speed = np.linalg.norm(points[..., :2] - before[..., :2], axis=-1) / period
    return (speed * touch).sum((1, 2)) / np.maximum(touch.sum((1, 2)), 1)


def fallen(motion: Motion, people: People, height_at: HeightAt) -> Flags:
    """Whether people (N,) lie, kneel or lean on their hands: low pelvis or head, or knee or hand down."""
    joints = [0, BODY_INDEX["Head"], *_KNEES, *_HANDS]
    places = motion.positions[:, joints]
    height = places[..., 2] - height_at(places[..., :2].reshape(-1, 2)).reshape(places.shape[:-1])
    low = ~(height[:, 0] > _LOW_PELVIS * people.pelvis_height) | ~(
        height[:, 1] > _LOW_HEAD * people.head_height
    )
    knees = (height[:, 2:4] < _KNEE_CLEARANCE).any(1)
    return low | knees | (height[:, 4:] < _HAND_CLEARANCE).any(1)


def _square(vectors: Array) -> Array:
    return np.einsum("nk,nk->n", vectors, vectors)
