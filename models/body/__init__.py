"""The humanoid: skeleton, anthropometry, and the body of a shape vector."""

from .anthropometry import N_SHAPE, ShapeError, sample_shapes, shape_for
from .body import FOOT_BODIES, LOWER_LEG_BODIES, SOLE_POINTS, Body, describe
from .skeleton import (
    BODY_INDEX,
    BODY_NAMES,
    JOINT_GAINS,
    JOINT_INDEX,
    JOINT_LIMITS,
    JOINT_NAMES,
    LITE_JOINTS,
    N_BODIES,
    N_JOINTS,
    PARENTS,
    forward_kinematics,
)

__all__ = [
    "BODY_INDEX",
    "BODY_NAMES",
    "FOOT_BODIES",
    "JOINT_GAINS",
    "JOINT_INDEX",
    "JOINT_LIMITS",
    "JOINT_NAMES",
    "LITE_JOINTS",
    "LOWER_LEG_BODIES",
    "N_BODIES",
    "N_JOINTS",
    "N_SHAPE",
    "PARENTS",
    "SOLE_POINTS",
    "Body",
    "ShapeError",
    "describe",
    "forward_kinematics",
    "sample_shapes",
    "shape_for",
]
