"""A recorded skeleton and its motion, as every importer returns it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]

AXES_FROM_Y_UP_FACING_Z: Array = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Takes (left, up, forward), the axes of CMU and SMPL, to ours (forward, left, up)."""
AXES_FROM_Y_UP_FACING_X: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Takes (forward, up, right), the axes of DeepMimic, to ours (forward, left, up)."""


class MotionFormatError(ValueError):
    """A file of motion that cannot be read as what it claims to be; says where and why."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A skeleton of J joints over T frames: x forward, y left, z up; metres.

    In the skeleton's zero pose all rotations are the identity and it faces +x.
    """

    name: str
    skeleton: str
    """Key of `joint_maps.JOINT_MAPS`."""
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for the root; parents come first."""
    offsets: Array
    """(J, 3) m: place in the parent's frame; the root's row is zero."""
    root: Array
    """(T, 3) m, world."""
    rotations: Array
    """(T, J, 3, 3): of each joint's frame in the world."""
    rate_hz: float

    def __len__(self) -> int:
        return len(self.root)

    @property
    def duration(self) -> float:
        """Time from the first to the last frame, s."""
        return (len(self) - 1) / self.rate_hz

    def positions(self) -> Array:
        """World positions (T, J, 3) of all joints, m."""
        positions = np.empty((*self.rotations.shape[:2], 3))
        for j, parent in enumerate(self.parents):
            if parent < 0:
                positions[:, j] = self.root
            else:
                positions[:, j] = positions[:, parent] + self.rotations[:, parent] @ self.offsets[j]
        return positions

    def cut(self, first: int, last: int) -> Recording:
        """Return frames ``first`` to ``last - 1``."""
        return replace(self, root=self.root[first:last], rotations=self.rotations[first:last])

    def without_glitches(self, width: float = 0.045) -> Recording:
        """Return the motion with frames that jump out of line and back replaced: a running median.

        Args:
            width: of the median's window, s; jumps shorter than half of it vanish.
        """
        size = 2 * round(0.5 * width * self.rate_hz) + 1
        flat = Rotation.from_matrix(self.rotations.reshape(-1, 3, 3)).as_quat()
        turns = flat.reshape(len(self), -1, 4)
        flips = np.sign(np.sum(turns[1:] * turns[:-1], -1, keepdims=True))
        turns[1:] *= np.cumprod(np.where(flips == 0, 1.0, flips), axis=0)
        turns = median_filter(turns, (size, 1, 1), mode="nearest")
        rotations = Rotation.from_quat(turns.reshape(-1, 4)).as_matrix().reshape(self.rotations.shape)
        return replace(self, root=median_filter(self.root, (size, 1), mode="nearest"), rotations=rotations)

    def resampled(self, rate_hz: float) -> Recording:
        """Return the motion at another rate: positions by cubic splines, rotations along geodesics."""
        times = np.arange(len(self)) / self.rate_hz
        wanted = np.arange(int(np.floor(self.duration * rate_hz + 1e-6)) + 1) / rate_hz
        wanted = np.minimum(wanted, times[-1])
        root = CubicSpline(times, self.root)(wanted)
        rotations = np.empty((len(wanted), len(self.joints), 3, 3))
        for j in range(len(self.joints)):
            turns = Slerp(times, Rotation.from_matrix(self.rotations[:, j]))
            rotations[:, j] = turns(wanted).as_matrix()
        return replace(self, root=root, rotations=rotations, rate_hz=rate_hz)


def about(axis: int, angle: Array) -> Rotation:
    """Rotations by angles (n,), rad, about the x, y or z axis (0, 1, 2)."""
    return Rotation.from_rotvec(np.eye(3)[axis] * np.asarray(angle)[:, None])


def global_rotations(local: Array, parents: tuple[int, ...]) -> Array:
    """World rotations (T, J, 3, 3) of local ones."""
    rotations = local.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            rotations[:, j] = rotations[:, parent] @ local[:, j]
    return rotations


def in_our_axes(axes: Array, vectors: Array, rotations: Array) -> tuple[Array, Array]:
    """Vectors (..., 3) and rotations (..., 3, 3) seen along our axes (`axes` takes theirs to ours)."""
    return vectors @ axes.T, axes @ rotations @ axes.T
