"""Reads Acclaim skeletons (ASF) and motions (AMC) as the CMU database publishes them."""

from __future__ import annotations

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

_INCH = 0.0254
CMU_RATE_HZ = 120.0


@dataclass
class _Bone:
    name: str
    direction: Array = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: Rotation = field(default_factory=Rotation.identity)
    freedoms: tuple[str, ...] = ()


@dataclass
class _Skeleton:
    bones: list[_Bone]  # the root first, parents before children
    parents: list[int]
    unit_to_m: float


def read_asf_amc(asf: Path | str, amc: Path | str, rate_hz: float = CMU_RATE_HZ) -> Recording:
    """Read an AMC motion of an ASF skeleton; a joint is named after the bone that starts there.

    Args:
        asf: the skeleton.
        amc: the motion; the format tells no rate.
        rate_hz: frames per second.

    Raises:
        MotionFormatError: one of the files is not what it should be.
    """
    asf, amc = Path(asf), Path(amc)
    skeleton = _read_skeleton(asf)
    index = {bone.name: i for i, bone in enumerate(skeleton.bones)}
    frames = _read_frames(amc, index)
    count = len(frames)
    local = np.tile(np.eye(3), (count, len(index), 1, 1))
    root = np.zeros((count, 3))
    for i, bone in enumerate(skeleton.bones):
        if not bone.freedoms:
            continue
        try:
            values = np.array([frame.get(bone.name, ()) for frame in frames], dtype=float)
        except ValueError as error:
            raise MotionFormatError(
                f"{amc}: the numbers of {bone.name} change from frame to frame."
            ) from error
        if values.shape != (count, len(bone.freedoms)):
            raise MotionFormatError(
                f"{amc}: {bone.name} needs {len(bone.freedoms)} numbers a frame, as {asf.name} says."
            )
        angles = np.zeros((count, 3))
        for k, freedom in enumerate(bone.freedoms):
            target = root if freedom[0] == "t" else angles
            target[:, "xyz".index(freedom[1])] = values[:, k]
        turn = Rotation.from_euler("xyz", angles, degrees=True)
        local[:, i] = (bone.axis * turn * bone.axis.inv()).as_matrix()
    offsets = np.zeros((len(index), 3))
    for i, parent in enumerate(skeleton.parents):
        if parent > 0:
            offsets[i] = skeleton.bones[parent].direction * skeleton.bones[parent].length
    parents = tuple(skeleton.parents)
    axes, unit = AXES_FROM_Y_UP_FACING_Z, skeleton.unit_to_m
    root, rotations = in_our_axes(axes, root * unit, global_rotations(local, parents))
    return Recording(
        amc.stem, "asf", tuple(index), parents, offsets @ axes.T * unit, root, rotations, rate_hz
    )


def _read_skeleton(path: Path) -> _Skeleton:
    sections: dict[str, list[list[str]]] = {}
    section = ""
    for line in path.read_text(errors="replace").splitlines():
        words = line.split()
        if words and words[0].startswith(":"):
            section = words[0]
            sections[section] = [words[1:]]
        elif words and not words[0].startswith("#"):
            sections.setdefault(section, []).append(words)
    try:
        units = {words[0]: words[1] for words in sections[":units"] if len(words) == 2}
        if units.get("angle", "deg") != "deg":
            raise MotionFormatError(f"{path}: angles must be in degrees.")
        order = next(words[1:] for words in sections[":root"] if words[:1] == ["order"])
        root = _Bone("root", freedoms=tuple(word.lower() for word in order))
        bones = [root, *_read_bones(sections[":bonedata"])]
        children = {words[0]: words[1:] for words in sections[":hierarchy"] if len(words) > 1}
        parents_by_name = {child: parent for parent, group in children.items() for child in group}
        index = {bone.name: i for i, bone in enumerate(bones)}
        parents = [-1] + [index[parents_by_name[bone.name]] for bone in bones[1:]]
    except (KeyError, IndexError, StopIteration) as error:
        raise MotionFormatError(f"{path} is not a whole ASF skeleton: {error} is missing.") from error
    if any(parent >= i for i, parent in enumerate(parents)):
        raise MotionFormatError(f"{path}: a bone is listed before its parent.")
    return _Skeleton(bones, parents, _INCH / float(units.get("length", 1.0)))


def _read_bones(lines: list[list[str]]) -> list[_Bone]:
    bones: list[_Bone] = []
    for words in lines:
        match words:
            case ["name", name]:
                bones.append(_Bone(name))
            case ["direction", *numbers]:
                bones[-1].direction = np.array(numbers[:3], dtype=float)
            case ["length", number]:
                bones[-1].length = float(number)
            case ["axis", x, y, z, order]:
                angles = {"X": float(x), "Y": float(y), "Z": float(z)}
                turn = Rotation.from_euler(order.lower(), [angles[a] for a in order.upper()], degrees=True)
                bones[-1].axis = turn
            case ["dof", *names]:
                bones[-1].freedoms = tuple(name for name in names if name[0] in "rt")
            case _:
                pass
    return bones


def _read_frames(path: Path, bones: dict[str, int]) -> list[dict[str, list[float]]]:
    frames: list[dict[str, list[float]]] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        words = line.split()
        if not words or words[0][0] in "#:":
            continue
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif words[0] in bones and frames:
            try:
                frames[-1][words[0]] = [float(word) for word in words[1:]]
            except ValueError as error:
                raise MotionFormatError(f"{path} line {number}: expected numbers.") from error
        else:
            raise MotionFormatError(f"{path} line {number}: the skeleton has no bone {words[0]!r}.")
    if not frames:
        raise MotionFormatError(f"{path} holds no frame.")
    return frames
