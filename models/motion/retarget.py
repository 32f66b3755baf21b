"""Carries a recorded motion over to the skeleton and proportions of any `Body`.

Directions of the limbs and turns of pelvis, chest and head are kept; lengths are the body's own, and the
root's path is scaled by the legs'. Elbows and knees are hinges. Then the feet are planted (`feet`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..body import BODY_INDEX, JOINT_INDEX, JOINT_LIMITS, N_BODIES, PARENTS, Body
from ..body.skeleton import matrix_from_quaternion, matrix_from_triplet, triplet_from_matrix
from ..world.humanoid import Actuation, actuated_joints
from . import feet as ground
from .clip import Clip
from .feet import FootMotion
from .joint_maps import JOINT_MAPS
from .recording import MotionFormatError, Recording

Array = NDArray[np.float64]

_SIDES = ("L_", "R_")
_NEXT = {"Hip": "Knee", "Knee": "Ankle", "Ankle": "Toe", "Shoulder": "Elbow", "Elbow": "Wrist"}
"""The limbs: the bone of each body ends at the joint of another."""
_TOES = [JOINT_INDEX["L_Toe_y"], JOINT_INDEX["R_Toe_y"]]
_EDGE = 2  # frames at both ends that filters have no neighbours for
_UP = np.array([0.0, 0.0, 1.0])
_STRAIGHT = np.sin(np.radians([10.0, 30.0]))  # between these an elbow's bend decides where its axis points


class _Source:
    """A recording seen through the names of our bodies."""

    def __init__(self, recording: Recording):
        names = JOINT_MAPS[recording.skeleton]
        index = {name: i for i, name in enumerate(recording.joints)}
        missing = sorted(set(names.values()) - set(index))
        if missing:
            raise MotionFormatError(
                f"{recording.name}: skeletons of kind {recording.skeleton!r} have a joint {missing[0]!r}; "
                f"this one has {', '.join(recording.joints[:6])}, ..."
            )
        self.joint = {body: index[name] for body, name in names.items()}
        self.recording = recording
        zero = np.zeros((len(recording.joints), 3))
        for j, parent in enumerate(recording.parents):
            zero[j] = recording.offsets[j] + (zero[parent] if parent >= 0 else 0.0)
        self._zero = zero

    def bone(self, start: str, end: str) -> Array:
        """Vector (3,) between two joints in the zero pose, m."""
        return self._zero[self.joint[end]] - self._zero[self.joint[start]]

    def rotation(self, body: str) -> Array:
        """World rotations (T, 3, 3)."""
        return self.recording.rotations[:, self.joint[body]]

    def leg_length(self) -> float:
        """Hip to ankle along the bones, mean of both legs, m."""
        parts = [self.bone(s + a, s + b) for s in _SIDES for a, b in (("Hip", "Knee"), ("Knee", "Ankle"))]
        return 0.5 * float(sum(np.linalg.norm(part) for part in parts))


def retarget(recording: Recording, body: Body, actuation: Actuation = "full", rate_hz: float = 30.0) -> Clip:
    """Return a recorded motion as `body` would make it.

    Args:
        recording: any skeleton `joint_maps` knows.
        body: whose proportions.
        actuation: which hinges may turn; the others stay at zero and their neighbours make up for them.
        rate_hz: frames per second of the result.

    Raises:
        MotionFormatError: the recording lacks joints its kind of skeleton has, or is shorter than 0.2 s.
    """
    if recording.duration < 0.2:
        raise MotionFormatError(f"{recording.name} lasts {recording.duration:.2f} s; a motion needs 0.2 s.")
    source = _Source(recording.resampled(rate_hz))
    wanted = {name: source.rotation(name) @ _alignment(source, body, name) for name in source.joint}
    pelvis = wanted["Pelvis"]
    root = source.recording.root * (body.thigh + body.shank) / source.leg_length()
    feet, hinges = _carry_legs(root, wanted, body)
    feet = _level(feet, body, rate_hz)
    drop = ground.find_floor(feet.soles(body), rate_hz)
    root[:, 2] -= drop
    feet.ankle[..., 2] -= drop
    rigid = actuation == "lite"
    planted, contacts = ground.plant(feet, body, rate_hz, rigid)
    root, legs = ground.reach_feet(root, pelvis, hinges, planted, body, rate_hz, rigid)
    joints = _upper_body(wanted, pelvis, body, actuation)
    for side, name in enumerate(_SIDES):
        first = BODY_INDEX[f"{name}Hip"] - 1
        joints[:, first : first + 3] = legs[:, side]
    if actuation == "full":
        _bend_toes(joints, planted, contacts, body)
    quaternion = Rotation.from_matrix(pelvis).as_quat(scalar_first=True)
    clip = Clip(
        recording.name,
        rate_hz,
        np.concatenate([root, _continuous(quaternion)], axis=1),
        _within_limits(joints.reshape(len(joints), -1)),
        contacts,
        {"source": recording.skeleton},
    )
    edge = _EDGE if len(clip) > 5 * _EDGE else 0
    return clip.cut(edge, len(clip) - edge).centred()


def refit(clip: Clip, root: Array, body: Body, name: str, tags: dict[str, str]) -> Clip:
    """Return a clip with another root path or for another body: legs are bent anew so that feet stand still.

    Args:
        clip: gives the posture.
        root: (T, 7) pelvis poses the result should have, world.
        body: whose proportions.
        name: of the result.
        tags: of the result, beside the clip's own.
    """
    pelvis = matrix_from_quaternion(root[:, 3:])
    angles = matrix_from_triplet(clip.joints.reshape(len(clip), N_BODIES - 1, 3))
    wanted = {"Pelvis": pelvis}
    for side in _SIDES:
        above = pelvis
        for part in ("Hip", "Knee", "Ankle"):
            above = above @ angles[:, BODY_INDEX[side + part] - 1]
            wanted[side + part] = above
    place = root[:, :3].copy()
    feet, hinges = _carry_legs(place, wanted, body)
    drop = ground.find_floor(feet.soles(body), clip.rate_hz)
    place[:, 2] -= drop
    feet.ankle[..., 2] -= drop
    rigid = not clip.joints[:, _TOES].any()
    planted, contacts = ground.plant(feet, body, clip.rate_hz, rigid)
    place, legs = ground.reach_feet(place, pelvis, hinges, planted, body, clip.rate_hz, rigid)
    joints = clip.joints.copy().reshape(len(clip), -1, 3)
    for side, prefix in enumerate(_SIDES):
        first = BODY_INDEX[f"{prefix}Hip"] - 1
        joints[:, first : first + 3] = legs[:, side]
    joints = _within_limits(joints.reshape(len(clip), -1))
    moved = np.concatenate([place, root[:, 3:]], axis=1)
    return Clip(name, clip.rate_hz, moved, joints, contacts, clip.tags | tags)


def _alignment(source: _Source, body: Body, name: str) -> Array:
    """Constant rotation (3, 3) from our body's frame to the recorded joint's, both in the zero pose."""
    side, part = (name[:2], name[2:]) if name[1] == "_" else ("", name)
    if part not in _NEXT or side + _NEXT[part] not in source.joint:
        return np.eye(3)
    end = side + _NEXT[part]
    ours, theirs = body.offsets[BODY_INDEX[end]], source.bone(name, end)
    if part != "Ankle":
        return ground.aligning(ours, theirs)
    carried = _alignment(source, body, side + "Knee")  # the foot is rolled with the shank
    return ground.aligning(carried @ ours, theirs) @ carried


def _carry_legs(root: Array, wanted: dict[str, Array], body: Body) -> tuple[FootMotion, Array]:
    """Feet at the ends of legs that point as recorded, and the knees' axes (T, 2, 3), world."""
    ankles, rotations, hinges = [], [], []
    for side in _SIDES:
        place = root
        for start, end in (("Pelvis", "Hip"), ("Hip", "Knee"), ("Knee", "Ankle")):
            above = start if start == "Pelvis" else side + start
            place = place + wanted[above] @ body.offsets[BODY_INDEX[side + end]]
        ankles.append(place)
        rotations.append(wanted[side + "Ankle"])
        # Toes that point outwards are the hip's doing as much as the ankle's.
        hinges.append(wanted[side + "Hip"][..., 1] + wanted[side + "Ankle"][..., 1])
    return FootMotion(np.stack(ankles, 1), np.stack(rotations, 1)), np.stack(hinges, 1)


def _level(feet: FootMotion, body: Body, rate_hz: float) -> FootMotion:
    toe = np.stack(
        [
            feet.ankle[:, i] + feet.rotation[:, i] @ body.offsets[BODY_INDEX[s + "Toe"]]
            for i, s in enumerate(_SIDES)
        ],
        1,
    )
    return ground.level_soles(feet, toe, rate_hz)


def _upper_body(wanted: dict[str, Array], pelvis: Array, body: Body, actuation: Actuation) -> Array:
    """Hinge angles (T, 23, 3) of trunk, head and arms, rad; legs are left at zero."""
    joints = np.zeros((len(pelvis), N_BODIES - 1, 3))
    free = np.zeros(joints.shape[1:], dtype=bool)
    free.ravel()[actuated_joints(actuation)] = True
    limits = JOINT_LIMITS.reshape(-1, 3, 2)
    reached = {"Pelvis": pelvis}

    def turn(name: str, to: Array) -> None:
        """Turn a body's joint as far towards a world rotation as hinges and limits allow."""
        row, above = BODY_INDEX[name] - 1, reached[_parent(name)]
        angles = triplet_from_matrix(np.swapaxes(above, -1, -2) @ to)
        angles = np.clip(np.where(free[row], angles, 0.0), *np.moveaxis(limits[row], -1, 0))
        joints[:, row] = angles
        reached[name] = above @ matrix_from_triplet(angles)

    def spread(chain: tuple[str, ...], to: Array) -> None:
        """Share a turn among the joints of a chain that exist."""
        count = sum(free[BODY_INDEX[name] - 1].all() for name in chain)
        for name in chain:
            above = reached[_parent(name)]
            if not free[BODY_INDEX[name] - 1].all():
                reached[name] = above
                continue
            vector = Rotation.from_matrix(np.swapaxes(above, -1, -2) @ to).as_rotvec() / count
            turn(name, above @ Rotation.from_rotvec(vector).as_matrix())
            count -= 1

    spread(("Torso", "Spine", "Chest"), wanted["Chest"])
    spread(("Neck", "Head"), wanted["Head"])
    for side in _SIDES:
        if side + "Thorax" in wanted:
            turn(side + "Thorax", wanted[side + "Thorax"])
        else:
            reached[side + "Thorax"] = reached["Chest"]
        shoulder, bend = _arm(wanted, body, side)
        turn(side + "Shoulder", shoulder)
        turn(side + "Elbow", reached[side + "Shoulder"] @ bend)
        turn(side + "Wrist", reached[side + "Elbow"])
        turn(side + "Hand", reached[side + "Wrist"])
    return joints


def _parent(name: str) -> str:
    names = list(BODY_INDEX)
    return names[PARENTS[BODY_INDEX[name]]]


def _arm(wanted: dict[str, Array], body: Body, side: str) -> tuple[Array, Array]:
    """World rotation (T, 3, 3) of the upper arm and local one of the elbow: a hinge about z."""
    sign = 1.0 if side == "L_" else -1.0

    def direction(name: str, end: str) -> Array:
        bone = wanted[side + name] @ body.offsets[BODY_INDEX[side + end]]
        return bone / np.linalg.norm(bone, axis=-1, keepdims=True)

    upper, fore = direction("Shoulder", "Elbow"), direction("Elbow", "Wrist")
    cross = np.cross(upper, fore)
    sine = np.linalg.norm(cross, axis=-1, keepdims=True)
    # The hinge is square to both bones; where the arm is straight, it is the recorded upper arm's own.
    weight = np.clip((sine - _STRAIGHT[0]) / (_STRAIGHT[1] - _STRAIGHT[0]), 0.0, 1.0)
    axis = (
        weight * (-sign * cross / np.maximum(sine, 1e-9)) + (1 - weight) * wanted[side + "Shoulder"][..., 2]
    )
    y = sign * upper
    z = axis - np.sum(axis * y, -1, keepdims=True) * y
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    shoulder = np.asarray(np.stack([np.cross(y, z), y, z], axis=-1), dtype=float)
    angles = np.zeros((len(upper), 3))
    angles[:, 2] = -sign * np.arctan2(sine[:, 0], np.sum(upper * fore, -1))
    return shoulder, matrix_from_triplet(angles)


def _bend_toes(joints: Array, feet: FootMotion, contacts: NDArray[np.bool_], body: Body) -> None:
    """Keep toes flat on the ground while the heel rises: set their y angle in joints (T, 23, 3)."""
    for i, side in enumerate(_SIDES):
        pitch = np.arcsin(np.clip(-feet.rotation[:, i, 2, 0], -1, 1))
        height = (feet.ankle[:, i] + feet.rotation[:, i] @ body.offsets[BODY_INDEX[side + "Toe"]])[:, 2]
        resting = body.ankle_height + body.offsets[BODY_INDEX[side + "Toe"], 2]
        near = np.clip(1 - (height - resting) / 0.05, 0.0, 1.0)
        joints[:, BODY_INDEX[side + "Toe"] - 1, 1] = -near * np.maximum(pitch, 0.0)


def _within_limits(joints: Array) -> Array:
    """Joints (T, 69) without jumps by whole turns, inside their ranges."""
    joints = np.unwrap(joints, axis=0)
    joints -= 2 * np.pi * np.round(joints.mean(0) / (2 * np.pi))
    return np.clip(joints, JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1])


def _continuous(quaternion: Array) -> Array:
    """Quaternions (T, 4) whose sign does not flip from frame to frame."""
    flips = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], -1) < 0, -1.0, 1.0))
    return quaternion * np.concatenate([[1.0], flips])[:, None]
