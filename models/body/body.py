"""One person's body: joint offsets, masses, inertias and contact solids of a ten-number shape vector.

>>> from footfall.models.body import describe, shape_for
>>> body = describe(shape_for(stature=1.8, mass=80.0))
>>> round(body.stature, 3), round(float(body.masses.sum()), 3)
(1.8, 80.0)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .anthropometry import Measurements, measure
from .segments import Segments, build_segments
from .skeleton import (
    BODY_INDEX,
    BODY_NAMES,
    N_BODIES,
    PARENTS,
)

FOOT_BODIES: tuple[int, ...] = tuple(BODY_INDEX[name] for name in ("L_Ankle", "L_Toe", "R_Ankle", "R_Toe"))
"""Bodies that may touch the ground while the person is on their feet."""
LOWER_LEG_BODIES: tuple[int, ...] = (*FOOT_BODIES, BODY_INDEX["L_Knee"], BODY_INDEX["R_Knee"])
"""Feet and shanks: who presses on the ground with anything else has fallen."""
SOLE_POINTS: tuple[str, ...] = ("heel_inner", "heel_outer", "ball_inner", "ball_outer", "toe")
"""Points of a sole, in the order of `Body.sole`; the last moves with the toes, the others with the ankle."""

SHOULDER_SHARE = 0.45
"""Of the biacromial breadth: from the midline to the shoulder joint's centre."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A person's body in the zero pose (see `skeleton`); its arrays are read-only."""

    shape: NDArray[np.float64]
    """(10,) standard deviations, in the order of `anthropometry.SHAPE_NAMES`."""
    measurements: Measurements
    offsets: NDArray[np.float64]
    """(24, 3) m: each joint's place in its parent's frame; the pelvis' row is zero."""
    segments: Segments
    """Masses, centres of mass, inertias and contact solids of the 24 bodies."""

    @property
    def stature(self) -> float:
        """Height of the standing person, m."""
        return self.measurements.stature

    @property
    def mass(self) -> float:
        """Body mass, kg."""
        return self.measurements.mass

    @property
    def male_fraction(self) -> float:
        """Blend of sex-typical proportions: 0 female, 1 male."""
        return self.measurements.male_fraction

    @property
    def masses(self) -> NDArray[np.float64]:
        """(24,) kg: mass of each body."""
        return self.segments.masses

    @property
    def radius(self) -> float:
        """Half the width over the shoulders with the arms hanging, m."""
        half = self.zero_positions[BODY_INDEX["L_Shoulder"], 1]
        return float(half + self.segments.thickness[BODY_INDEX["L_Shoulder"]])

    @property
    def ankle_height(self) -> float:
        """Height of the ankle joint above a flat sole, m."""
        return self.measurements.ankle_height

    @property
    def foot_length(self) -> float:
        """Heel to toe tip, m."""
        return self.measurements.foot_length

    @property
    def thigh(self) -> float:
        """Hip to knee joint, m."""
        return self.measurements.hip_height - self.measurements.knee_height

    @property
    def shank(self) -> float:
        """Knee to ankle joint, m."""
        return self.measurements.knee_height - self.measurements.ankle_height

    @property
    def pelvis_height(self) -> float:
        """Height of the pelvis' origin above the sole in the zero pose, m."""
        return float(self.measurements.hip_height - self.offsets[BODY_INDEX["L_Hip"], 2])

    @property
    def sole(self) -> NDArray[np.float64]:
        """(2, 5, 3) m: `SOLE_POINTS` of the left and the right foot, from the ankle joint, zero pose."""
        return self.segments.sole

    @property
    def zero_positions(self) -> NDArray[np.float64]:
        """(24, 3) m: joint positions in the zero pose with the soles on the ground plane z = 0."""
        positions = np.array([[0.0, 0.0, self.pelvis_height]]).repeat(N_BODIES, axis=0)
        for i in range(1, N_BODIES):
            positions[i] = positions[PARENTS[i]] + self.offsets[i]
        return positions


def describe(shape: ArrayLike) -> Body:
    """Return the body of a shape vector (10,).

    Raises:
        ShapeError: the vector is malformed or describes nobody in the supported range.
    """
    m = measure(shape)
    offsets = _offsets(m)
    vector = np.array(shape, dtype=float)
    for array in (offsets, vector):
        array.flags.writeable = False
    return Body(vector, m, offsets, build_segments(m, offsets))


def _offsets(m: Measurements) -> NDArray[np.float64]:
    """Joint offsets (24, 3); heights of the trunk's joints share out the span from hip to neck."""
    trunk = m.neck_height - m.hip_height

    def up(share: float) -> float:
        return m.hip_height + share * trunk

    # Joint centres in the zero pose, midline first; x follows the spine's natural curve.
    places = {
        "Pelvis": (0.0, 0.0, up(0.14)),
        "Torso": (-0.012 * m.stature, 0.0, up(0.22)),  # L5/S1
        "Spine": (-0.009 * m.stature, 0.0, up(0.44)),  # L2/L3
        "Chest": (-0.013 * m.stature, 0.0, up(0.62)),  # T10
        "Neck": (-0.014 * m.stature, 0.0, m.neck_height),
        "Head": (-0.002 * m.stature, 0.0, m.head_height),
    }
    shoulder_height = up(0.885)
    left = {
        "Hip": (0.0, m.hip_half_width, m.hip_height),
        "Knee": (0.0, m.hip_half_width, m.knee_height),
        "Ankle": (0.0, m.hip_half_width, m.ankle_height),
        "Toe": (0.47 * m.foot_length, m.hip_half_width, 0.35 * m.ankle_height),
        "Thorax": (-0.004 * m.stature, 0.10 * m.biacromial, shoulder_height),  # sternoclavicular
        "Shoulder": (
            -0.012 * m.stature,
            SHOULDER_SHARE * m.biacromial,
            shoulder_height,
        ),  # centre of the humeral head
    }
    x, y, z = left["Shoulder"]
    for name, reach in (
        ("Elbow", m.upper_arm),
        ("Wrist", m.upper_arm + m.forearm),
        ("Hand", m.upper_arm + m.forearm + m.palm),
    ):
        left[name] = (x, y + reach, z)
    for name, (x, y, z) in left.items():
        places[f"L_{name}"] = (x, y, z)
        places[f"R_{name}"] = (x, -y, z)

    positions = np.array([places[name] for name in BODY_NAMES])
    offsets = positions - positions[list(PARENTS)]
    offsets[0] = 0.0
    return offsets
