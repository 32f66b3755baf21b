"""One person's motion to look at: a clip, a recording with what was made of it, or a policy's rollout."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..models.body import BODY_NAMES, PARENTS
from ..models.body.rotations import matrix_from_quaternion

MOTION_FILES = (".bvh", ".amc", ".json", ".npz")
"""Endings of the files of motion that can be read."""
STATURE, MASS = 1.75, 75.0
"""Of whom recordings are carried over to [m, kg]."""
_PLAUSIBLE = (1.2, 2.3)  # m: height of a skeleton in its zero pose
_USUAL_UNITS = (1.0, 0.01, 0.0254 / 0.45, 0.0254)  # m, cm, CMU's own unit, inch


@dataclass(frozen=True, eq=False)
class Take:
    """T frames of one person, and what there is to compare them with."""

    name: str
    rate_hz: float
    shape: NDArray[np.float64]
    """(10,) of the person's body."""
    states: NDArray[np.float32]
    """(T, 24, 7 or more) position [m] and rotation wxyz of each body, world."""
    reference: NDArray[np.float32] | None = None
    """The same of the motion that was to be followed."""
    skeleton: NDArray[np.float64] | None = None
    """(T, J, 3) joints of the recorded skeleton [m], world."""
    parents: tuple[int, ...] = ()
    """Parent of each of its joints, -1 for the root."""
    contacts: NDArray[np.bool_] | None = None
    """(T, 2, 2): whether heel and ball of the left and right foot stand."""
    reference_contacts: NDArray[np.bool_] | None = None
    terms: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """(T,) of each term of the reward."""
    begin: float = 0.0
    """Time of the first frame [s]."""

    def __len__(self) -> int:
        return len(self.states)

    @property
    def end(self) -> float:
        """Time of the last frame [s]."""
        return self.begin + (len(self) - 1) / self.rate_hz

    def frame_at(self, time: float) -> int:
        """The frame shown at a time [s]."""
        return int(np.clip(round((time - self.begin) * self.rate_hz), 0, len(self) - 1))


def joint_angles(states: NDArray, body: str) -> NDArray[np.float64]:
    """Angles (T, 3) [rad] of a joint about its x, y and z hinge, from states (T, 24, 7 or more).

    The inverse of ``Rx(a) Ry(b) Rz(c)``, the rotation of a body as seen from its parent.
    """
    index = BODY_NAMES.index(body)
    own, parent = (matrix_from_quaternion(states[:, i, 3:7]) for i in (index, PARENTS[index]))
    turn = np.einsum("tji,tjk->tik", parent, own)
    return np.unwrap(
        np.stack(
            [
                np.arctan2(-turn[:, 1, 2], turn[:, 2, 2]),
                np.arcsin(np.clip(turn[:, 0, 2], -1.0, 1.0)),
                np.arctan2(-turn[:, 0, 1], turn[:, 0, 0]),
            ],
            axis=-1,
        ),
        axis=0,
    )


def read_takes(
    path: Path, asf: Path | None = None, unit: float | None = None, rate_hz: float = 0.0
) -> list[Take]:
    """The motions of a file, by its ending.

    Args:
        path: BVH, AMC, DeepMimic's JSON, an AMASS npz, or a motion library (npz).
        asf: Skeleton of an AMC motion; None looks beside it.
        unit: Metres per unit of length of a BVH; None finds out by the size of the skeleton.
        rate_hz: Frames per second of a BVH or AMC, where the file does not tell or tells wrong.

    Raises:
        MotionFormatError: not a motion, or one of a skeleton that is not known.
    """
    from ..models.body import describe, shape_for
    from ..models.motion.recording import MotionFormatError

    body = describe(shape_for(STATURE, MASS))
    match path.suffix.lower():
        case ".bvh":
            recording = _read_bvh(path, unit, rate_hz)
        case ".amc":
            from ..models.motion.asf_amc import CMU_RATE_HZ, read_asf_amc

            recording = read_asf_amc(asf or _skeleton_of(path), path, rate_hz or CMU_RATE_HZ)
        case ".json":
            from ..models.motion.deepmimic import read_deepmimic

            recording = read_deepmimic(path)
        case ".npz" if _is_library(path):
            return _library_takes(path)
        case ".npz":
            from ..models.motion.amass import read_amass

            recording = read_amass(path, body)
        case ending:
            raise MotionFormatError(f"{path}: {ending or 'no ending'}; known are {', '.join(MOTION_FILES)}.")
    return [take_of_recording(recording, body)]


def take_of_recording(recording, body) -> Take:
    """A recording, and what `body` makes of it, on one spot and in one direction."""
    from ..models.motion.library import body_states
    from ..models.motion.recording import about
    from ..models.motion.retarget import retarget

    clip = retarget(recording.without_glitches(), body)
    states = body_states(clip, body)
    resampled = recording.resampled(clip.rate_hz)
    surplus = len(resampled) - len(clip)
    whole = resampled.cut(surplus // 2, surplus // 2 + len(clip))
    joints = whole.positions()
    # The clip begins above the origin and heads along +x; so shall the skeleton.
    pelvis = whole.rotations[0, whole.parents.index(-1)]
    joints -= [*joints[0, 0, :2], np.percentile(joints[..., 2].min(axis=1), 5)]
    turn = about(2, np.array([-np.arctan2(pelvis[1, 0], pelvis[0, 0])]))
    joints = turn.apply(joints.reshape(-1, 3)).reshape(joints.shape)
    return Take(
        recording.name,
        clip.rate_hz,
        body.shape,
        states,
        skeleton=joints,
        parents=recording.parents,
        contacts=clip.contacts,
    )


def _library_takes(path: Path) -> list[Take]:
    from ..models.motion.library import body_states, load_clips

    clips, bodies = load_clips(path)
    return [
        Take(clip.name, clip.rate_hz, bodies[0].shape, body_states(clip, bodies[0]), contacts=clip.contacts)
        for clip in clips
    ]


def _is_library(path: Path) -> bool:
    from zipfile import BadZipFile, ZipFile

    try:
        with ZipFile(path) as file:
            return "meta.npy" in file.namelist()
    except (BadZipFile, FileNotFoundError):
        return False  # whoever reads it says what is wrong


def _read_bvh(path: Path, unit: float | None, rate_hz: float):
    """A BVH of a known skeleton in metres."""
    from ..models.motion.bvh import read_bvh
    from ..models.motion.joint_maps import JOINT_MAPS
    from ..models.motion.recording import MotionFormatError

    recording = read_bvh(path, "cmu", unit or 1.0, rate_hz)
    names = set(recording.joints)
    kinds = [kind for kind, joints in JOINT_MAPS.items() if set(joints.values()) <= names]
    if not kinds:
        raise MotionFormatError(
            f"{path}: its joints ({', '.join(recording.joints[:4])}, ...) are those of no skeleton known: "
            f"{', '.join(JOINT_MAPS)}."
        )
    if unit is None:
        size = _rest_height(recording)
        fitting = [u for u in _USUAL_UNITS if _PLAUSIBLE[0] <= u * size <= _PLAUSIBLE[1]]
        if not fitting:
            raise MotionFormatError(f"{path}: its skeleton is {size:g} units high; give metres per unit.")
        unit = min(fitting, key=lambda u: abs(u * size - STATURE))
    return read_bvh(path, kinds[0], unit, rate_hz)


def _rest_height(recording) -> float:
    """Height of the skeleton in its zero pose, in units of the file."""
    heights = np.zeros(len(recording.joints))
    for joint, parent in enumerate(recording.parents):
        if parent >= 0:
            heights[joint] = heights[parent] + recording.offsets[joint, 2]
    return float(np.ptp(heights))


def _skeleton_of(amc: Path) -> Path:
    """The ASF that belongs to an AMC: `35.asf` to `35_01.amc`, or the only one in the folder."""
    from ..models.motion.recording import MotionFormatError

    own = amc.with_name(amc.stem.split("_")[0] + ".asf")
    if own.exists():
        return own
    found = sorted(amc.parent.glob("*.asf"))
    if len(found) != 1:
        raise MotionFormatError(f"{amc}: there are {len(found)} skeletons (.asf) beside it; name one.")
    return found[0]
