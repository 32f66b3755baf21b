"""Reads Biovision Hierarchy (BVH) files of the CMU database and alike: Y up, facing +Z in the zero pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .recording import (
    AXES_FROM_Y_UP_FACING_Z,
    MotionFormatError,
    Recording,
    global_rotations,
    in_our_axes,
)

Array = NDArray[np.float64]


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    channels: list[str] = field(default_factory=list)


def read_bvh(
    path: Path | str, skeleton: str = "cmu", unit_to_m: float = 1.0, rate_hz: float = 0.0
) -> Recording:
    """Read a BVH file.

    Channels may come in any order and any joint may have its own. Positions of joints other than the root are
    ignored: bones have a fixed length here. The end site of joint ``X`` becomes the joint ``X_end``.

    Args:
        path: the file.
        skeleton: key of `joint_maps.JOINT_MAPS` its joint names belong to.
        unit_to_m: metres per unit of length of the file.
        rate_hz: overrides the file's own rate (some headers are wrong); 0 trusts the file.

    Raises:
        MotionFormatError: the file is not BVH; names the line.
    """
    path = Path(path)
    lines = enumerate(path.read_text(errors="replace").splitlines(), 1)
    joints = _read_hierarchy(path, lines)
    values, frame_time = _read_motion(path, lines, sum(len(j.channels) for j in joints))
    parents = tuple(j.parent for j in joints)
    local = np.tile(np.eye(3), (len(values), len(joints), 1, 1))
    root = np.zeros((len(values), 3))
    column = 0
    for i, joint in enumerate(joints):
        block = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        turns = [k for k, c in enumerate(joint.channels) if c.endswith("rotation")]
        if turns:
            order = "".join(joint.channels[k][0] for k in turns).upper()
            local[:, i] = Rotation.from_euler(order, block[:, turns], degrees=True).as_matrix()
        if i == 0:
            for k, c in enumerate(joint.channels):
                if c.endswith("position"):
                    root[:, "XYZ".index(c[0].upper())] = block[:, k]
            root += joint.offset
    offsets = np.array([j.offset for j in joints])
    offsets[0] = 0.0
    axes = AXES_FROM_Y_UP_FACING_Z
    root, rotations = in_our_axes(axes, root * unit_to_m, global_rotations(local, parents))
    names = tuple(j.name for j in joints)
    rate = rate_hz or 1.0 / frame_time
    return Recording(path.stem, skeleton, names, parents, offsets @ axes.T * unit_to_m, root, rotations, rate)


def _read_hierarchy(path: Path, lines: Iterator[tuple[int, str]]) -> list[_Joint]:
    joints: list[_Joint] = []
    stack: list[int] = []
    for number, line in lines:
        words = line.split()
        try:
            match words:
                case [] | ["HIERARCHY"]:
                    pass
                case ["ROOT" | "JOINT", name, *_]:
                    joints.append(_Joint(name, stack[-1] if stack else -1))
                case ["End", *_]:
                    joints.append(_Joint(f"{joints[stack[-1]].name}_end", stack[-1]))
                case ["{"]:
                    stack.append(len(joints) - 1)
                case ["}"]:
                    stack.pop()
                case ["OFFSET", *numbers]:
                    joints[stack[-1]].offset = [float(n) for n in numbers[:3]]
                case ["CHANNELS", count, *channels]:
                    joints[stack[-1]].channels = channels[: int(count)]
                case ["MOTION"]:
                    if not joints:
                        raise MotionFormatError(f"{path} line {number}: a motion but no skeleton before it.")
                    return joints
                case _:
                    raise MotionFormatError(f"{path} line {number}: {line.strip()[:60]!r} is not BVH.")
        except (IndexError, ValueError) as error:
            if isinstance(error, MotionFormatError):
                raise
            raise MotionFormatError(f"{path} line {number}: {line.strip()[:60]!r} is not BVH.") from error
    raise MotionFormatError(f"{path} ends before its MOTION section: it is not a whole BVH file.")


def _read_motion(path: Path, lines: Iterator[tuple[int, str]], width: int) -> tuple[Array, float]:
    count, frame_time = 0, 0.0
    rows: list[list[float]] = []
    for number, line in lines:
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "Frames:":
                count = int(words[1])
            elif words[:2] == ["Frame", "Time:"]:
                frame_time = float(words[2])
            else:
                rows.append([float(w) for w in words])
        except (IndexError, ValueError) as error:
            raise MotionFormatError(f"{path} line {number}: expected numbers.") from error
        if rows and len(rows[-1]) != width:
            raise MotionFormatError(
                f"{path} line {number} has {len(rows[-1])} numbers; the skeleton has {width} channels."
            )
    if len(rows) < max(count, 1) or not frame_time > 0:
        raise MotionFormatError(f"{path} promises {count} frames and holds {len(rows)}.")
    return np.array(rows[: count or None]), frame_time
