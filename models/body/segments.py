"""Masses, centres of mass, inertias and contact solids of the 24 bodies of a person.

Limbs take their centre of mass and radii of gyration from de Leva (1996), table 4; bodies that are only a
part of one of his segments (trunk, hand, foot, neck) take those of an elliptic cylinder, box or ellipsoid of
the same mass. Widths follow from mass, length and density, so a heavy person is a thick one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .anthropometry import Measurements, blend
from .skeleton import BODY_INDEX, N_BODIES

# kg/m^3; Winter (2009), table 4.1.
_TRUNK_DENSITY = 1030.0
_LIMB_DENSITY = {"Hip": 1050.0, "Knee": 1090.0, "Shoulder": 1070.0, "Elbow": 1130.0}

# (female, male), shares of the length from joint to joint: centre of mass, then radii of gyration about the
# sagittal, transverse and longitudinal axis; de Leva (1996), table 4 (shank: between the joint centres).
_LIMBS = {
    "Hip": ("Thigh", "Knee", (0.3612, 0.4095), ((0.369, 0.329), (0.364, 0.329), (0.162, 0.149))),
    "Knee": ("Shank", "Ankle", (0.4352, 0.4395), ((0.267, 0.251), (0.263, 0.246), (0.092, 0.102))),
    "Shoulder": ("UpperArm", "Elbow", (0.5754, 0.5772), ((0.278, 0.285), (0.260, 0.269), (0.148, 0.158))),
    "Elbow": ("Forearm", "Wrist", (0.4559, 0.4574), ((0.261, 0.276), (0.257, 0.265), (0.094, 0.121))),
}
_FOOT_CENTRE = (0.4014, 0.4415)  # of the foot's length from the heel; de Leva, table 4
_HEEL = 0.25  # of the foot's length lies behind the ankle joint
_TOE_MASS, _FINGER_MASS, _NECK_MASS, _COLLAR_MASS = 0.15, 0.30, 0.18, 0.10  # of foot, hand, head, upper trunk


@dataclass(frozen=True, slots=True)
class Solid:
    """A sphere-swept segment fixed to a body; a sphere when both ends agree. m, body frame."""

    body: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """The 24 bodies' mass and shape; read-only arrays in kg, m and the body frames."""

    masses: NDArray[np.float64]
    """(24,) kg."""
    centres: NDArray[np.float64]
    """(24, 3) m: centres of mass."""
    inertias: NDArray[np.float64]
    """(24, 3) kg m^2: moments about the centre of mass and the body's x, y, z axis (its principal axes)."""
    thickness: NDArray[np.float64]
    """(24,) m: radius of each body's solid."""
    sole: NDArray[np.float64]
    """(2, 5, 3) m: lowest points of the feet, from the ankle joint in the zero pose."""
    solids: tuple[Solid, ...]
    """What touches the world; the feet touch it with spheres."""


def build_segments(m: Measurements, offsets: NDArray[np.float64]) -> Segments:
    """Return the segments of measurements `m` whose joints are `offsets` (24, 3) m apart."""
    return _Builder(m, offsets).build()


def _cylinder(a: float, b: float, length: float) -> NDArray[np.float64]:
    """Inertia per mass of an upright elliptic cylinder, half axes b along x and a along y."""
    height = length**2 / 12
    return np.array([a**2 / 4 + height, b**2 / 4 + height, (a**2 + b**2) / 4])


def _box(size: ArrayLike) -> NDArray[np.float64]:
    x, y, z = np.square(size)
    return np.array([y + z, x + z, x + y]) / 12


def _ellipsoid(half_axes: ArrayLike) -> NDArray[np.float64]:
    x, y, z = np.square(half_axes)
    return np.array([y + z, x + z, x + y]) / 5


class _Builder:
    """Fills the arrays segment by segment."""

    def __init__(self, m: Measurements, offsets: NDArray[np.float64]):
        self.m = m
        self.offsets = offsets
        self.masses = np.zeros(N_BODIES)
        self.centres = np.zeros((N_BODIES, 3))
        self.inertias = np.zeros((N_BODIES, 3))
        self.thickness = np.zeros(N_BODIES)
        self.solids: list[Solid] = []

    def build(self) -> Segments:
        self._trunk()
        self._head()
        sole = np.empty((2, 5, 3))
        for side, (prefix, sign) in enumerate((("L_", 1.0), ("R_", -1.0))):
            self._collar(prefix)
            for name in _LIMBS:
                self._limb(prefix, name)
            self._hand(prefix, sign)
            sole[side] = self._foot(prefix, sign)
        for array in (self.masses, self.centres, self.inertias, self.thickness, sole):
            array.flags.writeable = False
        return Segments(self.masses, self.centres, self.inertias, self.thickness, sole, tuple(self.solids))

    def _place(self, name: str, mass: float, centre: ArrayLike, inertia_per_mass: NDArray[np.float64]) -> int:
        body = BODY_INDEX[name]
        self.masses[body] = mass
        self.centres[body] = centre
        self.inertias[body] = mass * inertia_per_mass
        return body

    def _solid(self, body: int, start: ArrayLike, end: ArrayLike, radius: float) -> None:
        def point(p: ArrayLike) -> tuple[float, float, float]:
            x, y, z = np.asarray(p, dtype=float).tolist()
            return x, y, z

        self.thickness[body] = radius
        self.solids.append(Solid(body, point(start), point(end), radius))

    def _trunk(self) -> None:
        mass = self.m.segment_mass
        h = self.m.stature
        spine, chest, neck = (self.offsets[BODY_INDEX[n]] for n in ("Spine", "Chest", "Neck"))
        pelvis_low = self.offsets[BODY_INDEX["L_Hip"], 2] - 0.02 * h
        pelvis_high = self.offsets[BODY_INDEX["Torso"], 2]
        # body, mass, lowest and highest point above its joint, depth over width, x of its axis
        parts = (
            ("Pelvis", mass["LowerTrunk"], pelvis_low, pelvis_high, 0.66, -0.008 * h),
            ("Torso", 0.55 * mass["MiddleTrunk"], 0.0, spine[2], 0.72, 0.006 * h),
            ("Spine", 0.45 * mass["MiddleTrunk"], 0.0, chest[2], 0.72, 0.006 * h),
            ("Chest", (1 - 2 * _COLLAR_MASS) * mass["UpperTrunk"], 0.0, 0.92 * neck[2], 0.68, 0.006 * h),
        )
        for name, part_mass, low, high, aspect, x in parts:
            area = part_mass / (_TRUNK_DENSITY * (high - low))
            half_width = float(np.sqrt(area / (np.pi * aspect)))
            half_depth = aspect * half_width
            middle = 0.5 * (low + high)
            body = self._place(name, part_mass, (x, 0, middle), _cylinder(half_width, half_depth, high - low))
            reach = half_width - half_depth
            self._solid(body, (x, -reach, middle), (x, reach, middle), half_depth)

    def _head(self) -> None:
        mass, h = self.m.segment_mass["Head"], self.m.stature
        head = self.offsets[BODY_INDEX["Head"]]
        radius = 0.032 * h
        body = self._place("Neck", _NECK_MASS * mass, 0.5 * head, _cylinder(radius, radius, head[2]))
        self._solid(body, 0.1 * head, 0.9 * head, radius)

        # Half of ANSUR II head length, breadth and menton-to-top height over stature.
        half_axes = np.array([0.056, 0.044, 0.066]) * h
        above = h - self.m.head_height
        centre = np.array([0.010 * h, 0.0, above - half_axes[2]])
        body = self._place("Head", (1 - _NECK_MASS) * mass, centre, _ellipsoid(half_axes))
        radius = 0.5 * (half_axes[0] + half_axes[1])
        reach = np.array([0.0, 0.0, half_axes[2] - radius])
        self._solid(body, centre - reach, centre + reach, float(radius))

    def _collar(self, prefix: str) -> None:
        shoulder = self.offsets[BODY_INDEX[prefix + "Shoulder"]]
        length = float(np.linalg.norm(shoulder))
        half_axes = (0.03 * self.m.stature, 0.6 * length, 0.03 * self.m.stature)
        mass = _COLLAR_MASS * self.m.segment_mass["UpperTrunk"]
        body = self._place(prefix + "Thorax", mass, 0.5 * shoulder, _ellipsoid(half_axes))
        self._solid(body, 0.4 * shoulder, 0.8 * shoulder, half_axes[2])

    def _limb(self, prefix: str, name: str) -> None:
        segment, child, centre, gyration = _LIMBS[name]
        male, mass = self.m.male_fraction, self.m.segment_mass[segment]
        bone = self.offsets[BODY_INDEX[prefix + child]]
        length = float(np.linalg.norm(bone))
        sagittal, transverse, longitudinal = (blend(pair, male) * length for pair in gyration)
        upright = name in ("Hip", "Knee")  # legs hang along z, arms stretch along y in the zero pose
        radii = [sagittal, transverse, longitudinal] if upright else [sagittal, longitudinal, transverse]
        body = self._place(prefix + name, mass, blend(centre, male) * bone, np.square(radii))
        radius = 0.9 * float(np.sqrt(mass / (_LIMB_DENSITY[name] * np.pi * length)))
        self._solid(body, 0.12 * bone, 0.88 * bone, radius)

    def _hand(self, prefix: str, sign: float) -> None:
        m, mass = self.m, self.m.segment_mass["Hand"]
        breadth, thick = 0.048 * m.stature, 0.016 * m.stature
        fingers = m.hand - m.palm
        for name, part, length in (("Wrist", 1 - _FINGER_MASS, m.palm), ("Hand", _FINGER_MASS, fingers)):
            middle = (0.0, sign * 0.5 * length, 0.0)
            body = self._place(prefix + name, part * mass, middle, _box((breadth, length, thick)))
            radius = 0.4 * breadth if name == "Wrist" else 0.3 * breadth
            self._solid(body, middle, (0.0, sign * (length - radius), 0.0), radius)

    def _foot(self, prefix: str, sign: float) -> NDArray[np.float64]:
        """Place ankle and toe; return the sole's five points (5, 3) from the ankle joint."""
        m, mass = self.m, self.m.segment_mass["Foot"]
        toe = self.offsets[BODY_INDEX[prefix + "Toe"]]
        tip = (1 - _HEEL) * m.foot_length
        toe_centre = 0.5 * (tip - toe[0])
        whole = (blend(_FOOT_CENTRE, m.male_fraction) - _HEEL) * m.foot_length
        rear = (whole - _TOE_MASS * (toe[0] + toe_centre)) / (1 - _TOE_MASS)
        rear_size = (toe[0] + _HEEL * m.foot_length, m.foot_breadth, m.ankle_height)
        toe_size = (tip - toe[0], m.foot_breadth, 0.4 * m.ankle_height)
        ankle_body = self._place(
            prefix + "Ankle", (1 - _TOE_MASS) * mass, (rear, 0, -0.5 * m.ankle_height), _box(rear_size)
        )
        toe_body = self._place(prefix + "Toe", _TOE_MASS * mass, (toe_centre, 0, 0), _box(toe_size))

        radius = 0.010 * m.stature
        heel_x = -_HEEL * m.foot_length + radius
        inner, outer = -sign, sign
        heel_y, ball_y = 0.32 * m.foot_breadth - 0.5 * radius, 0.5 * m.foot_breadth - radius
        low = -m.ankle_height
        sole = np.array(
            [
                (heel_x, inner * heel_y, low),
                (heel_x, outer * heel_y, low),
                (toe[0], inner * ball_y, low),
                (toe[0] - 0.05 * m.foot_length, outer * ball_y, low),
                (tip - radius, 0.0, low),
            ]
        )
        spheres = sole + np.array([0.0, 0.0, radius])
        for sphere in spheres[:4]:
            self._solid(ankle_body, sphere, sphere, radius)
        self._solid(toe_body, spheres[4] - toe, spheres[4] - toe, radius)
        return sole
