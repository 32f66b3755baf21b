"""A motion of our skeleton: what retargeting makes and tracking follows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from ..body.rotations import yaw
from ..body.skeleton import BODY_NAMES, N_JOINTS
from .recording import MotionFormatError, about

Array = NDArray[np.float64]

_MIRROR = [
    BODY_NAMES.index(name.replace("L_", "R_") if name.startswith("L_") else name.replace("R_", "L_"))
    for name in BODY_NAMES
]
MIRROR_BODIES: NDArray[np.intp] = np.array(_MIRROR)
"""(24,) index of each body's counterpart on the other side."""
MIRROR_JOINTS: NDArray[np.intp] = np.array(
    [3 * (_MIRROR[body] - 1) + axis for body in range(1, len(BODY_NAMES)) for axis in range(3)]
)
"""(69,) index of each hinge's counterpart."""
MIRROR_SIGNS: Array = np.tile([-1.0, 1.0, -1.0], N_JOINTS // 3)
"""(69,) sign the angle takes: mirroring left and right flips turns about x and z."""


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """T frames of one person's motion on level ground, z = 0."""

    name: str
    rate_hz: float
    root: Array
    """(T, 7) pelvis pose, world, [x y z qw qx qy qz], m."""
    joints: Array
    """(T, 69) hinge angles, rad, in the order of `skeleton.JOINT_NAMES`."""
    contacts: NDArray[np.bool_]
    """(T, 2, 2): whether heel and ball of the left and right foot stand on the ground."""
    tags: dict[str, str] = field(default_factory=dict)
    """What is known about it: ``description``, ``source``, ``parent`` clip and ``augmentation``."""

    def __len__(self) -> int:
        return len(self.root)

    @property
    def duration(self) -> float:
        """Time from the first to the last frame, s."""
        return (len(self) - 1) / self.rate_hz

    def velocities(self) -> tuple[Array, Array]:
        """Derivatives of the splines through all frames.

        Returns:
            The root's linear m/s and angular rad/s velocity, world frame, (T, 6), and hinge velocities (T,
            69) in rad/s.

        Raises:
            MotionFormatError: the clip has fewer than three frames.
        """
        if len(self) < 3:
            raise MotionFormatError(f"Clip {self.name} has {len(self)} frames; velocities need three.")
        times = np.arange(len(self)) / self.rate_hz
        root = np.empty((len(self), 6))
        root[:, :3] = CubicSpline(times, self.root[:, :3])(times, 1)
        turns = Rotation.from_quat(self.root[:, 3:], scalar_first=True)
        root[:, 3:] = turns.apply(RotationSpline(times, turns)(times, 1))
        return root, np.asarray(CubicSpline(times, self.joints)(times, 1))

    def heading(self) -> Array:
        """Heading (T,) of the pelvis, rad, continuous."""
        return np.unwrap(yaw(self.root[:, 3:]))

    @property
    def speed(self) -> float:
        """Mean horizontal speed of the pelvis along its path, m/s; swaying does not count."""
        path = self._path()
        return float(np.linalg.norm(np.diff(path, axis=0), axis=1).mean() * self.rate_hz)

    @property
    def turn_rate(self) -> float:
        """Mean rate of turning, rad/s, left positive."""
        heading = self.heading()
        return float((heading[-1] - heading[0]) / self.duration)

    def _path(self) -> Array:
        """Horizontal path (n, 2) of the pelvis, averaged over 0.5 s."""
        width = max(min(round(0.5 * self.rate_hz), len(self) // 2), 1)
        window = np.ones(width) / width
        return np.stack([np.convolve(self.root[:, axis], window, "valid") for axis in range(2)], -1)

    def cut(self, first: int, last: int) -> Clip:
        """Return frames ``first`` to ``last - 1``."""
        return replace(
            self,
            root=self.root[first:last],
            joints=self.joints[first:last],
            contacts=self.contacts[first:last],
        )

    def mirrored(self) -> Clip:
        """Return the motion seen in a mirror: left and right change places."""
        root = self.root * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
        joints = self.joints[:, MIRROR_JOINTS] * MIRROR_SIGNS
        tags = self.tags | {"parent": self.name, "augmentation": "mirror"}
        return replace(
            self,
            name=f"{self.name}_mirror",
            root=root,
            joints=joints,
            contacts=self.contacts[:, ::-1],
            tags=tags,
        )

    def centred(self) -> Clip:
        """Return the clip starting above the origin, its heading along +x."""
        turn = about(2, -self.heading()[:1])
        root = self.root.copy()
        root[:, :2] -= root[0, :2]
        root[:, :3] = turn.apply(root[:, :3])
        root[:, 3:] = (turn * Rotation.from_quat(root[:, 3:], scalar_first=True)).as_quat(scalar_first=True)
        return replace(self, root=root)
