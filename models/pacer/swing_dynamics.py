"""What it takes to swing a leg: torques at hip and knee for the motion a leg should make through the air.

A drive that is told only where a leg should be lets it lag behind by its inertia over the drive's stiffness, a
quarter of a metre at the foot of a quick step, which is enough to catch the edge of a stair. Told the torque as
well (computed torque, Luh, Walker & Paul 1980), it need not wait for an error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..body import BODY_INDEX, JOINT_GAINS, JOINT_INDEX, Body
from ..body.skeleton import GAIN_REFERENCE_MASS
from ..gait.norms import GRAVITY

Array = NDArray[np.float64]

HINGES: NDArray[np.intp] = np.array([JOINT_INDEX[f"{s}_{j}_y"] for s in "LR" for j in ("Hip", "Knee")])
"""(4,) hinges that swing the legs: left hip and knee, right hip and knee."""
_THIGHS = [BODY_INDEX["L_Hip"], BODY_INDEX["R_Hip"]]
_KNEES = [BODY_INDEX["L_Knee"], BODY_INDEX["R_Knee"]]
_ANKLES = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
_TOES = [BODY_INDEX["L_Toe"], BODY_INDEX["R_Toe"]]
_MOST = 0.5  # rad: farthest shift of a target


class SwingLegs:
    """Two links a leg in the sagittal plane, thigh and shank with foot, hung from a hip that does not accelerate.

    Args:
        bodies: the N people.
    """

    def __init__(self, bodies: Sequence[Body]):
        whole = [_links(body) for body in bodies]
        self._links: Array = np.array(whole).reshape(-1, 2, 7)
        scale = np.array([body.mass / GAIN_REFERENCE_MASS for body in bodies])
        self._stiffness = JOINT_GAINS[HINGES, 0].reshape(2, 2) * scale[:, None, None]

    def shifts(self, angles: Array, rates: Array, accelerations: Array) -> Array:
        """Shifts (N, 2, 2), rad, of the PD targets of hips and knees that add the torques of a free swing.

        Args:
            angles: (N, 2, 2) rad: of thigh and shank from the vertical, positive when the lower end is ahead.
            rates: (N, 2, 2) rad/s.
            accelerations: (N, 2, 2) rad/s^2.
        """
        thigh_mass, thigh_centre, thigh_inertia, thigh_length, mass, centre, inertia = np.moveaxis(
            self._links, -1, 0
        )
        across = np.stack([np.cos(angles), np.sin(angles)], -1)  # direction in which the lower end turns
        along = np.stack([np.sin(angles), -np.cos(angles)], -1)
        turning = across * accelerations[..., None] - along * np.square(rates)[..., None]
        weight = np.array([0.0, GRAVITY])
        upper = thigh_centre[..., None] * turning[..., 0, :] + weight
        lower = thigh_length[..., None] * turning[..., 0, :] + centre[..., None] * turning[..., 1, :] + weight
        knee = inertia * accelerations[..., 1] + mass * centre * _dot(across[..., 1, :], lower)
        hip = (
            knee
            + thigh_inertia * accelerations[..., 0]
            + thigh_mass * thigh_centre * _dot(across[..., 0, :], upper)
            + mass * thigh_length * _dot(across[..., 0, :], lower)
        )
        # The hinges turn about y, to the left: positive turns the lower end back.
        return np.clip(-np.stack([hip, knee], -1) / self._stiffness, -_MOST, _MOST)

    def keep(self, rows: NDArray[np.intp]) -> None:
        """Keep people (n,), in that order."""
        self._links, self._stiffness = self._links[rows], self._stiffness[rows]

    def join(self, other: SwingLegs) -> None:
        """Put other people behind these."""
        self._links = np.concatenate([self._links, other._links])
        self._stiffness = np.concatenate([self._stiffness, other._stiffness])


def leg_angles(root: Array, joints: Array) -> Array:
    """Angles (N, 2, 2), rad, of thighs and shanks from the vertical, positive when the lower end is ahead.

    Args:
        root: (N, 7) pelvis poses.
        joints: (N, 69) rad.
    """
    w, x, y, z = np.moveaxis(root[:, 3:], -1, 0)
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    hinges = joints[:, HINGES].reshape(-1, 2, 2)
    return -(pitch[:, None, None] + np.cumsum(hinges, -1))


def _links(body: Body) -> Array:
    """(2, 7) a leg: mass, centre, inertia and length of the thigh; mass, centre and inertia of shank and foot."""
    segments = body.segments
    out = np.zeros((2, 7))
    for side in range(2):
        thigh, knee, ankle, toe = _THIGHS[side], _KNEES[side], _ANKLES[side], _TOES[side]
        lower = np.array([knee, ankle, toe])
        foot = body.offsets[ankle]
        places = segments.centres[lower] + np.array([np.zeros(3), foot, foot + body.offsets[toe]])
        masses = segments.masses[lower]
        centre = masses @ places / masses.sum()
        spread = np.square(places - centre)[:, [0, 2]].sum(1)
        inertia = float(segments.inertias[lower, 1].sum() + masses @ spread)
        out[side] = (
            segments.masses[thigh],
            -segments.centres[thigh, 2],
            segments.inertias[thigh, 1],
            -body.offsets[knee, 2],
            masses.sum(),
            -centre[2],
            inertia,
        )
    return out


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...k,...k->...", a, b)
