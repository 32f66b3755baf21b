"""Many clips as a few arrays, so that thousands of worlds can look up their reference frames at once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ..body import Body, describe
from ..body.rotations import rotation_vector
from ..body.skeleton import N_BODIES, forward_kinematics
from .augment import fit_to
from .clip import Clip
from .recording import MotionFormatError

_FORMAT = 1


class MotionLibrary:
    """Clips of one rate for K bodies; frames of all clips lie one after the other, F in all.

    Args:
        clips: made for the first body.
        bodies: the K people; clips are refitted to all but the first.

    Raises:
        MotionFormatError: no clip, clips of several rates, or one shorter than three frames.
    """

    def __init__(self, clips: Sequence[Clip], bodies: Sequence[Body]):
        if not clips or not bodies:
            raise MotionFormatError("A motion library needs at least one clip and one body.")
        if len({clip.rate_hz for clip in clips}) > 1:
            raise MotionFormatError("The clips of a library must share one rate.")
        self.clips = tuple(clips)
        self.bodies = tuple(bodies)
        self.rate_hz = clips[0].rate_hz
        self.lengths: NDArray[np.intp] = np.array([len(clip) for clip in clips])
        """(C,) frames of each clip."""
        self.starts: NDArray[np.intp] = np.concatenate([[0], np.cumsum(self.lengths)[:-1]])
        """(C,) first frame of each clip."""
        self.speeds = np.array([clip.speed for clip in clips])
        """(C,) m/s."""
        self.turn_rates = np.array([clip.turn_rate for clip in clips])
        """(C,) rad/s, left positive."""
        fitted = [clips if k == 0 else [fit_to(c, bodies[0], b) for c in clips] for k, b in enumerate(bodies)]
        self.contacts = np.concatenate([clip.contacts for clip in clips])
        """(F, 2, 2) bool: heel and ball of left and right foot."""
        self.root = np.array([np.concatenate([c.root for c in group]) for group in fitted])
        """(K, F, 7) pelvis pose, m, wxyz."""
        self.joints = np.array([np.concatenate([c.joints for c in group]) for group in fitted])
        """(K, F, 69) rad."""
        rates = [[c.velocities() for c in group] for group in fitted]
        self.root_velocity = np.array([np.concatenate([v for v, _ in group]) for group in rates])
        """(K, F, 6) m/s and rad/s, world."""
        self.joint_velocities = np.array([np.concatenate([v for _, v in group]) for group in rates])
        """(K, F, 69) rad/s."""
        self.states = np.array(
            [
                np.concatenate([body_states(c, b) for c in group])
                for group, b in zip(fitted, bodies, strict=True)
            ]
        )
        """(K, F, 24, 13) float32: position m, rotation wxyz, velocity m/s, angular velocity rad/s, world."""

    def __len__(self) -> int:
        return len(self.clips)

    def states_at(self, body: NDArray[np.intp], frame: NDArray[np.intp]) -> NDArray[np.float32]:
        """`states` (n, 24, 13) of bodies (n,) in frames (n,); several times as fast as indexing them by both."""
        return self.states.reshape(-1, *self.states.shape[2:]).take(body * self.states.shape[1] + frame, 0)

    @property
    def duration(self) -> float:
        """Of all clips together, s."""
        return float((self.lengths - 1).sum() / self.rate_hz)

    def weights(self, flatten: float = 0.5) -> NDArray[np.float64]:
        """Probability (C,) of each clip: by duration, with rare speeds and turn rates lifted.

        Args:
            flatten: 0 leaves the recorded distribution, 1 makes cells of speed (0.3 m/s) and turn rate (20
            deg/s)
                equally likely.
        """
        cell = np.stack([self.speeds / 0.3, np.degrees(self.turn_rates) / 20], -1).round().astype(int)
        _, which = np.unique(cell, axis=0, return_inverse=True)
        which = which.ravel()
        mass = np.bincount(which, self.lengths.astype(float))
        weights = self.lengths * mass[which] ** -flatten
        return weights / weights.sum()

    def save(self, path: Path | str) -> None:
        """Write clips and bodies as npz; what follows from them is computed anew on loading."""
        meta = {
            "format": _FORMAT,
            "rate_hz": self.rate_hz,
            "names": [clip.name for clip in self.clips],
            "tags": [clip.tags for clip in self.clips],
        }
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            meta=np.array(json.dumps(meta)),
            lengths=self.lengths,
            root=self.root[0].astype(np.float32),
            joints=self.joints[0].astype(np.float32),
            contacts=self.contacts,
            shapes=np.array([body.shape for body in self.bodies]),
        )

    @classmethod
    def load(cls, path: Path | str, bodies: Sequence[Body] = ()) -> MotionLibrary:
        """Read what `save` wrote.

        Args:
            path: the file.
            bodies: take these in place of the stored ones; clips are refitted from the stored first body.

        Raises:
            MotionFormatError: the file is no motion library.
        """
        clips, stored = load_clips(path)
        if not bodies:
            return cls(clips, stored)
        if not np.array_equal(bodies[0].shape, stored[0].shape):
            clips = [fit_to(clip, stored[0], bodies[0]) for clip in clips]
        return cls(clips, bodies)


def load_clips(path: Path | str) -> tuple[list[Clip], list[Body]]:
    """Read the clips and bodies of a library without preparing it for look-ups.

    Raises:
        MotionFormatError: the file is no motion library.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            bounds = np.cumsum(file["lengths"])[:-1]
            root, joints = file["root"].astype(float), file["joints"].astype(float)
            parts = [np.split(array, bounds) for array in (root, joints, file["contacts"])]
            bodies = [describe(shape) for shape in file["shapes"]]
        if meta["format"] != _FORMAT:
            raise MotionFormatError(f"{path} is of format {meta['format']}; this version reads {_FORMAT}.")
    except (FileNotFoundError, MotionFormatError):
        raise
    except (KeyError, BadZipFile, EOFError, OSError, ValueError) as error:
        raise MotionFormatError(f"{path} is no motion library: {error}.") from error
    clips = []
    for name, tags, r, j, c in zip(meta["names"], meta["tags"], *parts, strict=True):
        r[:, 3:] /= np.linalg.norm(r[:, 3:], axis=1, keepdims=True)
        clips.append(Clip(name, meta["rate_hz"], r, j, c, tags))
    return clips, bodies


def body_states(clip: Clip, body: Body) -> NDArray[np.float32]:
    """States (T, 24, 13) of all bodies, world: position, rotation wxyz, velocity, angular velocity."""
    positions, rotations = forward_kinematics(body.offsets, clip.root, clip.joints)
    times = np.arange(len(clip)) / clip.rate_hz
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    quaternions = quaternions.reshape(-1, N_BODIES, 4)
    states = np.empty((len(clip), N_BODIES, 13), dtype=np.float32)
    states[..., :3] = positions
    states[..., 3:7] = quaternions
    states[..., 7:10] = CubicSpline(times, positions)(times, 1)
    ahead = np.minimum(np.arange(len(clip)) + 1, len(clip) - 1)
    behind = np.maximum(np.arange(len(clip)) - 1, 0)
    spans = ((ahead - behind) / clip.rate_hz)[:, None, None]
    states[..., 10:] = rotation_vector(quaternions[ahead], quaternions[behind]) / spans
    return states
