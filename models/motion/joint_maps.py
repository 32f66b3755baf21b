"""Which joint of a recorded skeleton is which of our bodies, for every skeleton we can read."""

from __future__ import annotations

_SIDES = (("L_", "Left", "l", "left_"), ("R_", "Right", "r", "right_"))


def _cmu() -> dict[str, str]:
    """CMU database as MotionBuilder-friendly BVH (31 joints)."""
    names = {"Pelvis": "Hips", "Chest": "Spine1", "Neck": "Neck", "Head": "Head"}
    for ours, side, *_ in _SIDES:
        names |= {
            f"{ours}Hip": f"{side}UpLeg",
            f"{ours}Knee": f"{side}Leg",
            f"{ours}Ankle": f"{side}Foot",
            f"{ours}Toe": f"{side}ToeBase",
            f"{ours}Thorax": f"{side}Shoulder",
            f"{ours}Shoulder": f"{side}Arm",
            f"{ours}Elbow": f"{side}ForeArm",
            f"{ours}Wrist": f"{side}Hand",
        }
    return names


def _asf() -> dict[str, str]:
    """CMU database as ASF/AMC; joints are named after the bone that starts there."""
    names = {"Pelvis": "root", "Chest": "thorax", "Neck": "lowerneck", "Head": "head"}
    for ours, _, side, _ in _SIDES:
        names |= {
            f"{ours}Hip": f"{side}femur",
            f"{ours}Knee": f"{side}tibia",
            f"{ours}Ankle": f"{side}foot",
            f"{ours}Toe": f"{side}toes",
            f"{ours}Thorax": f"{side}clavicle",
            f"{ours}Shoulder": f"{side}humerus",
            f"{ours}Elbow": f"{side}radius",
            f"{ours}Wrist": f"{side}wrist",
        }
    return names


def _daz() -> dict[str, str]:
    """CMU database as DAZ-friendly BVH (43 joints)."""
    names = {"Pelvis": "hip", "Chest": "chest", "Neck": "neck", "Head": "head"}
    for ours, _, side, _ in _SIDES:
        names |= {
            f"{ours}Hip": f"{side}Thigh",
            f"{ours}Knee": f"{side}Shin",
            f"{ours}Ankle": f"{side}Foot",
            f"{ours}Toe": f"{side}Foot_end",
            f"{ours}Thorax": f"{side}Collar",
            f"{ours}Shoulder": f"{side}Shldr",
            f"{ours}Elbow": f"{side}ForeArm",
            f"{ours}Wrist": f"{side}Hand",
        }
    return names


def _deepmimic() -> dict[str, str]:
    """DeepMimic's 13-link humanoid and the ends of its bones."""
    names = {"Pelvis": "root", "Chest": "chest", "Head": "neck"}
    for ours, *_, side in _SIDES:
        parts = ("Hip", "Knee", "Ankle", "Toe", "Shoulder", "Elbow", "Wrist")
        names |= {ours + part: side + part.lower() for part in parts}
    return names


def _smpl() -> dict[str, str]:
    """SMPL's 22 body joints under our own names."""
    names = {name: name for name in ("Pelvis", "Chest", "Neck", "Head")}
    for ours, *_ in _SIDES:
        parts = ("Hip", "Knee", "Ankle", "Toe", "Thorax", "Shoulder", "Elbow", "Wrist")
        names |= {ours + part: ours + part for part in parts}
    return names


JOINT_MAPS: dict[str, dict[str, str]] = {
    "cmu": _cmu(),
    "asf": _asf(),
    "daz": _daz(),
    "deepmimic": _deepmimic(),
    "smpl": _smpl(),
}
"""By skeleton: our body -> its joint. Trunk and neck joints in between share out the turn of their ends."""
