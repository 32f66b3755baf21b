"""Bodies in motion: what they are made of, where their joints are, what drives them."""

from typing import Annotated

import msgspec
import numpy as np

from .array import Array

JOINTS = 24
"""Bodies of the humanoid, in SMPL's order and names (`footfall.models.body.BODY_NAMES`)."""
HINGES = 69
"""Joint angles of the humanoid: x, y, z of every body but the root."""


class Bodies(msgspec.Struct, frozen=True):
    """How the pedestrians are built; latched."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    shapes: Annotated[np.ndarray, Array("f4", ("N", 10))]
    """Shape vectors, unit normal (`footfall.models.body`)."""
    masses: Annotated[np.ndarray, Array("f4", ("N",), "kg")]
    statures: Annotated[np.ndarray, Array("f4", ("N",), "m")]
    radii: Annotated[np.ndarray, Array("f4", ("N",), "m")]
    """Radius of the disk a planner keeps free of others."""
    offsets: Annotated[np.ndarray, Array("f4", ("N", JOINTS, 3), "m", "parent joint")]
    """Limb vectors: each joint seen from its parent in the zero pose."""


class BodyStates(msgspec.Struct, frozen=True):
    """The motion of all joints of everybody in the scene."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    joints: Annotated[np.ndarray, Array("f4", ("N", JOINTS, 13), "", "world")]
    """Position [m], rotation (w, x, y, z), linear velocity [m/s], angular velocity [rad/s]."""

    @property
    def positions(self) -> np.ndarray:
        """Joint positions (N, 24, 3) [m]."""
        return self.joints[..., 0:3]

    @property
    def rotations(self) -> np.ndarray:
        """Joint rotations (N, 24, 4), unit quaternions wxyz."""
        return self.joints[..., 3:7]

    @property
    def linear_velocities(self) -> np.ndarray:
        """Joint velocities (N, 24, 3) [m/s]."""
        return self.joints[..., 7:10]

    @property
    def angular_velocities(self) -> np.ndarray:
        """Joint angular velocities (N, 24, 3) [rad/s]."""
        return self.joints[..., 10:13]


class BodyActions(msgspec.Struct, frozen=True):
    """What drives the bodies until the next action."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    joint_targets: Annotated[np.ndarray, Array("f4", ("N", HINGES), "rad")]
    """Targets of the joints' PD drives; the pose itself when the simulator is kinematic."""
    roots: Annotated[np.ndarray | None, Array("f4", ("N", 7), "", "world")] = None
    """Root pose x, y, z [m], w, x, y, z, obeyed by a kinematic simulator only."""


class Contacts(msgspec.Struct, frozen=True):
    """Touches between people, or of people with obstacles and (except with the feet) the ground."""

    agents: Annotated[np.ndarray, Array("i4", ("C", 2))]
    """Ids of the two who touch; -1 for the second where it is the ground or an obstacle."""
    bodies: Annotated[np.ndarray, Array("i4", ("C", 2))]
    """Body index of each; for an obstacle its index in the map; -1 for the ground."""
    positions: Annotated[np.ndarray, Array("f4", ("C", 3), "m", "world")]
    normals: Annotated[np.ndarray, Array("f4", ("C", 3), "", "world")]
    """Unit vectors from the first to the second."""
    forces: Annotated[np.ndarray, Array("f4", ("C",), "N")]
    """Normal force; zero in a kinematic simulator."""


class Falls(msgspec.Struct, frozen=True):
    """Pedestrians who have just fallen, and how the fall is handled."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    positions: Annotated[np.ndarray, Array("f4", ("N", 3), "m", "world")]
    handling: str
    """`report`, `respawn` or `remove`, as configured in the simulator."""
