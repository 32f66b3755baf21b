"""The 24-body skeleton shared by every pedestrian: names, order, joints, limits, gains, kinematics.

Bodies, their names and their order are those of SMPL (Loper et al. 2015): state vectors of that layout fit as
they are. Frames: x forward, y left, z up; in the **zero pose** the person stands upright, legs straight, arms
stretched out sideways (T-pose, palms down), and every body frame is parallel to the world.

Every body but the pelvis hangs on three hinges about its own x, y and z axis, in that order, so its rotation
relative to its parent is ``Rx(a) Ry(b) Rz(c)``. Seen from the zero pose:

* hip y < 0 lifts the thigh forward; knee y > 0 bends the knee; ankle y < 0 lifts the toes;
* left shoulder x = -pi/2 (right +pi/2) lets the arm hang, then left shoulder z < 0 (right > 0) swings it
  forward and left elbow z < 0 (right > 0) bends the elbow forward;
* trunk and head y > 0 bends forward.

Mirroring left and right swaps the sides and flips the signs of x and z angles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .rotations import matrix_from_quaternion

_TREE = (
    ("Pelvis", None),
    ("L_Hip", "Pelvis"),
    ("L_Knee", "L_Hip"),
    ("L_Ankle", "L_Knee"),
    ("L_Toe", "L_Ankle"),
    ("R_Hip", "Pelvis"),
    ("R_Knee", "R_Hip"),
    ("R_Ankle", "R_Knee"),
    ("R_Toe", "R_Ankle"),
    ("Torso", "Pelvis"),
    ("Spine", "Torso"),
    ("Chest", "Spine"),
    ("Neck", "Chest"),
    ("Head", "Neck"),
    ("L_Thorax", "Chest"),
    ("L_Shoulder", "L_Thorax"),
    ("L_Elbow", "L_Shoulder"),
    ("L_Wrist", "L_Elbow"),
    ("L_Hand", "L_Wrist"),
    ("R_Thorax", "Chest"),
    ("R_Shoulder", "R_Thorax"),
    ("R_Elbow", "R_Shoulder"),
    ("R_Wrist", "R_Elbow"),
    ("R_Hand", "R_Wrist"),
)

BODY_NAMES: tuple[str, ...] = tuple(name for name, _ in _TREE)
BODY_INDEX: dict[str, int] = {name: i for i, name in enumerate(BODY_NAMES)}
PARENTS: tuple[int, ...] = tuple(-1 if parent is None else BODY_INDEX[parent] for _, parent in _TREE)
"""Index of each body's parent; -1 for the pelvis. A parent always comes before its children."""

JOINT_NAMES: tuple[str, ...] = tuple(f"{name}_{axis}" for name in BODY_NAMES[1:] for axis in "xyz")
"""The 69 hinges; body ``i`` owns the angles ``3 (i - 1)`` to ``3 i - 1``."""
JOINT_INDEX: dict[str, int] = {name: i for i, name in enumerate(JOINT_NAMES)}

N_BODIES = len(BODY_NAMES)
N_JOINTS = len(JOINT_NAMES)

# Degrees (x low, x high, y low, y high, z low, z high) of the LEFT side. Clinical ranges of motion after the
# American Academy of Orthopaedic Surgeons, "Joint Motion" (1965), and Norkin & White, "Measurement of Joint
# Motion" (2016), app. B; the trunk's and neck's totals are shared among their joints; the glide of the collar
# bone after Inman, Saunders & Abbott (1944). Ankles under the body's weight flex farther than those measured on
# a table (30 degrees): the shank leans 45 and more over the foot in a lunge (Bennell et al. 1998), without which
# nobody stands on a slope but on their toes.
_LIMITS_DEG = {
    "Hip": (-30, 45, -125, 30, -45, 45),
    "Knee": (-5, 5, -2, 150, -25, 25),
    "Ankle": (-35, 20, -45, 50, -20, 20),
    "Toe": (-5, 5, -70, 45, -5, 5),
    "Torso": (-20, 20, -20, 45, -15, 15),
    "Spine": (-15, 15, -15, 30, -15, 15),
    "Chest": (-15, 15, -15, 30, -30, 30),
    "Neck": (-25, 25, -30, 30, -40, 40),
    "Head": (-20, 20, -30, 30, -40, 40),
    "Thorax": (-15, 35, -30, 30, -30, 25),
    "Shoulder": (-110, 90, -90, 90, -180, 60),
    "Elbow": (-10, 10, -85, 85, -150, 2),
    "Wrist": (-80, 70, -10, 10, -25, 35),
    "Hand": (-90, 30, -5, 5, -15, 15),
}

# kp (N m/rad), kd (N m s/rad) and torque cap (N m) for a person of 77 kg. Ratio kd/kp = 0.1 s as in PACER
# (app. B), but for hips and knees, which that much damping makes too slow for stairs; stiffness at the level
# found stable in MuJoCo at 120 Hz with `implicitfast`; caps near the peak isokinetic torques of adults (hip and
# knee 200-300 N m; Anderson et al. 2007), but for ankles, whose tendons return what they have stored: 3 N m/kg
# in running (Novacheck 1998). Capped at 150 N m nobody can sprint.
_GAINS = {
    "Hip": (300, 20, 300),
    "Knee": (300, 20, 300),
    "Ankle": (200, 20, 230),
    "Toe": (30, 3, 30),
    "Torso": (400, 40, 300),
    "Spine": (400, 40, 300),
    "Chest": (400, 40, 300),
    "Neck": (60, 6, 50),
    "Head": (60, 6, 50),
    "Thorax": (200, 20, 100),
    "Shoulder": (120, 12, 100),
    "Elbow": (100, 10, 80),
    "Wrist": (20, 2, 20),
    "Hand": (10, 1, 10),
}
GAIN_REFERENCE_MASS = 77.0
"""Mass (kg) the gain table is meant for; gains and caps scale with mass / this (PACER, app. B)."""

_LITE_AXES = {"Knee": "y", "Elbow": "z"} | dict.fromkeys(
    ("Hip", "Ankle", "Torso", "Chest", "Shoulder"), "xyz"
)


def joint_group(body: str) -> str:
    """Return the side-less name of a body, e.g. ``"Hip"`` for ``"L_Hip"``."""
    return body.removeprefix("L_").removeprefix("R_")


def _limits(body: str) -> NDArray[np.float64]:
    limits = np.radians(np.array(_LIMITS_DEG[joint_group(body)], dtype=float).reshape(3, 2))
    if body.startswith("R_"):  # mirrored: x and z angles change sign
        limits[[0, 2]] = -limits[[0, 2], ::-1]
    return limits


JOINT_LIMITS: NDArray[np.float64] = np.concatenate([_limits(name) for name in BODY_NAMES[1:]])
"""(69, 2) rad: lower and upper limit of every hinge."""
JOINT_GAINS: NDArray[np.float64] = np.array(
    [_GAINS[joint_group(name)] for name in BODY_NAMES[1:] for _ in "xyz"], dtype=float
)
"""(69, 3): kp, kd and torque cap of every hinge at `GAIN_REFERENCE_MASS`."""
LITE_JOINTS: NDArray[np.bool_] = np.array(
    [axis in _LITE_AXES.get(joint_group(name), "") for name in BODY_NAMES[1:] for axis in "xyz"]
)
"""(69,) bool: the 28 hinges that exist in the lite body; the others are rigid and read as angle 0."""
for _table in (JOINT_LIMITS, JOINT_GAINS, LITE_JOINTS):
    _table.flags.writeable = False

_DEPTHS = np.zeros(N_BODIES, dtype=int)
for _body in range(1, N_BODIES):
    _DEPTHS[_body] = _DEPTHS[PARENTS[_body]] + 1
_LEVELS = [np.flatnonzero(depth == _DEPTHS) for depth in range(1, _DEPTHS.max() + 1)]
_PARENT_ARRAY = np.array(PARENTS)


def matrix_from_triplet(angles: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) ``Rx(a) Ry(b) Rz(c)`` of hinge triplets (..., 3) in rad."""
    angles = np.asarray(angles, dtype=float)
    sa, sb, sc = np.moveaxis(np.sin(angles), -1, 0)
    ca, cb, cc = np.moveaxis(np.cos(angles), -1, 0)
    matrix = np.empty((*angles.shape[:-1], 3, 3))
    matrix[..., 0, 0] = cb * cc
    matrix[..., 0, 1] = -cb * sc
    matrix[..., 0, 2] = sb
    matrix[..., 1, 0] = ca * sc + sa * sb * cc
    matrix[..., 1, 1] = ca * cc - sa * sb * sc
    matrix[..., 1, 2] = -sa * cb
    matrix[..., 2, 0] = sa * sc - ca * sb * cc
    matrix[..., 2, 1] = sa * cc + ca * sb * sc
    matrix[..., 2, 2] = ca * cb
    return matrix


def triplet_from_matrix(matrix: ArrayLike) -> NDArray[np.float64]:
    """Hinge triplets (..., 3) in rad of rotation matrices (..., 3, 3); y lies in [-pi/2, pi/2]."""
    matrix = np.asarray(matrix, dtype=float)
    return np.stack(
        [
            np.arctan2(-matrix[..., 1, 2], matrix[..., 2, 2]),
            np.arcsin(np.clip(matrix[..., 0, 2], -1.0, 1.0)),
            np.arctan2(-matrix[..., 0, 1], matrix[..., 0, 0]),
        ],
        axis=-1,
    )


def forward_kinematics(
    offsets: ArrayLike, root: ArrayLike, joints: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World positions and rotations of all bodies.

    Args:
        offsets: parent-to-child offsets, (24, 3) or (..., 24, 3), m, in the parent's frame (`Body.offsets`).
        root: pelvis pose (..., 7) in the world, [x y z qw qx qy qz].
        joints: hinge angles (..., 69), rad, in the order of `JOINT_NAMES`.

    Returns:
        Positions (..., 24, 3) in m and rotation matrices (..., 24, 3, 3), both in the world frame.
    """
    offsets = np.asarray(offsets, dtype=float)
    root = np.asarray(root, dtype=float)
    joints = np.asarray(joints, dtype=float)
    batch = joints.shape[:-1]
    local = matrix_from_triplet(joints.reshape(*batch, N_BODIES - 1, 3))
    positions = np.empty((*batch, N_BODIES, 3))
    rotations = np.empty((*batch, N_BODIES, 3, 3))
    positions[..., 0, :] = root[..., :3]
    rotations[..., 0, :, :] = matrix_from_quaternion(root[..., 3:])
    for level in _LEVELS:
        parents = _PARENT_ARRAY[level]
        parent_rotations = rotations[..., parents, :, :]
        step = parent_rotations @ offsets[..., level, :, None]
        positions[..., level, :] = positions[..., parents, :] + step[..., 0]
        rotations[..., level, :, :] = parent_rotations @ local[..., level - 1, :, :]
    return positions, rotations
