"""From ten unit-normal numbers to a person's measurements, by published tables.

Sources, cited at each table: ANSUR II (Gordon et al. 2014, NATICK/TR-15/007), the U.S. Army's survey of 4082
men and 1986 women; Drillis & Contini (1966) as printed by Winter, "Biomechanics and Motor Control of Human
Movement" (2009), fig. 4.1; de Leva, J. Biomech. 29(9) (1996), tables 1 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

SHAPE_NAMES: tuple[str, ...] = (
    "sex",
    "stature",
    "mass",
    "leg_length",
    "shank_share",
    "arm_length",
    "shoulder_width",
    "hip_width",
    "trunk_mass",
    "foot_length",
)
"""The ten components of a shape vector, each in standard deviations from the mean."""
N_SHAPE = len(SHAPE_NAMES)
STATURE_RANGE = (1.5, 2.0)  # m
MASS_RANGE = (50.0, 110.0)  # kg

# (female, male). Stature (m) and weight over stature squared (kg/m^2, log-normal): ANSUR II.
_STATURE_MEAN = (1.628, 1.756)
_STATURE_SD = (0.064, 0.069)
_BMI_MEDIAN = (25.3, 27.3)
_BMI_LOG_SD = 0.14
_SEX_STEEPNESS = 3.0  # male fraction = Phi(3 z): most people are near one end

# Fractions of stature (female, male) unless one number serves both, and their spreads.
_HIP_HEIGHT, _HIP_HEIGHT_SD = 0.530, 0.012  # Winter fig. 4.1; spread: ANSUR II crotch height given stature
_SHANK_SHARE, _SHANK_SHARE_SD = 0.501, 0.012  # of hip to ankle; Winter fig. 4.1 (0.246 of 0.491)
_ANKLE_HEIGHT = 0.039  # Winter fig. 4.1
_NECK_HEIGHT = 0.848  # C7/T1 joint, below the cervicale (0.863, ANSUR II)
_HEAD_HEIGHT = 0.905  # atlanto-occipital joint, below the tragion (0.923, ANSUR II)
_UPPER_ARM = (0.1586, 0.1618)  # shoulder to elbow joint centre; de Leva table 1
_FOREARM = (0.1523, 0.1545)  # elbow to wrist joint centre; de Leva table 1
_ARM_SD = 0.032  # relative; ANSUR II span given stature
_HAND = 0.108  # wrist to finger tip; Winter fig. 4.1
_PALM = (0.0450, 0.0495)  # wrist to third knuckle; de Leva table 1
_BIACROMIAL, _BIACROMIAL_SD = (0.2242, 0.2368), 0.0105  # ANSUR II biacromial breadth
_HIP_JOINTS, _HIP_JOINTS_SD = (
    (0.102, 0.097),
    0.006,
)  # 0.72 pelvis widths (Bell et al. 1990)
_FOOT_LENGTH, _FOOT_LENGTH_SD = (0.1511, 0.1543), 0.0055  # ANSUR II foot length
_FOOT_BREADTH = (0.0570, 0.0580)  # ANSUR II foot breadth, horizontal

SEGMENT_MASS: dict[str, tuple[float, float]] = {
    "Head": (0.0668, 0.0694),
    "UpperTrunk": (0.1545, 0.1596),
    "MiddleTrunk": (0.1465, 0.1633),
    "LowerTrunk": (0.1247, 0.1117),
    "UpperArm": (0.0255, 0.0271),
    "Forearm": (0.0138, 0.0162),
    "Hand": (0.0056, 0.0061),
    "Thigh": (0.1478, 0.1416),
    "Shank": (0.0481, 0.0433),
    "Foot": (0.0129, 0.0137),
}
"""Share of body mass (female, male) of each segment; limbs count per side (de Leva, table 4)."""
_TRUNK_SEGMENTS = ("UpperTrunk", "MiddleTrunk", "LowerTrunk")
_TRUNK_MASS_SD = 0.05  # relative


class ShapeError(ValueError):
    """A body shape that is malformed or outside the range of people the model supports."""


@dataclass(frozen=True, slots=True)
class Measurements:
    """One person's size: lengths in m (heights above the sole), masses in kg."""

    stature: float
    mass: float
    male_fraction: float
    hip_height: float
    knee_height: float
    ankle_height: float
    neck_height: float
    head_height: float
    hip_half_width: float
    """From the midline to the hip joint's centre."""
    biacromial: float
    upper_arm: float
    forearm: float
    palm: float
    hand: float
    foot_length: float
    foot_breadth: float
    segment_mass: dict[str, float]
    """kg of each de Leva segment; limbs per side."""


def blend(pair: tuple[float, float], male_fraction: float) -> float:
    """Interpolate a (female, male) table entry."""
    return pair[0] + (pair[1] - pair[0]) * male_fraction


def measure(shape: ArrayLike) -> Measurements:
    """Return the measurements of a shape vector (10,).

    Raises:
        ShapeError: not ten finite numbers, or a stature or mass outside `STATURE_RANGE`, `MASS_RANGE`.
    """
    z: list[float] = _checked(shape).tolist()
    male = NormalDist().cdf(_SEX_STEEPNESS * z[0])
    stature = blend(_STATURE_MEAN, male) + z[1] * blend(_STATURE_SD, male)
    mass = blend(_BMI_MEDIAN, male) * float(np.exp(_BMI_LOG_SD * z[2])) * stature**2
    _require("stature", stature, STATURE_RANGE, " m")
    _require("mass", mass, MASS_RANGE, " kg")

    hip = (_HIP_HEIGHT + _HIP_HEIGHT_SD * z[3]) * stature
    ankle = _ANKLE_HEIGHT * stature
    shank = (_SHANK_SHARE + _SHANK_SHARE_SD * z[4]) * (hip - ankle)
    arm = float(np.exp(_ARM_SD * z[5])) * stature
    return Measurements(
        stature=stature,
        mass=mass,
        male_fraction=male,
        hip_height=hip,
        knee_height=ankle + shank,
        ankle_height=ankle,
        neck_height=_NECK_HEIGHT * stature,
        head_height=_HEAD_HEIGHT * stature,
        hip_half_width=0.5 * (blend(_HIP_JOINTS, male) + _HIP_JOINTS_SD * z[7]) * stature,
        biacromial=(blend(_BIACROMIAL, male) + _BIACROMIAL_SD * z[6]) * stature,
        upper_arm=blend(_UPPER_ARM, male) * arm,
        forearm=blend(_FOREARM, male) * arm,
        palm=blend(_PALM, male) * arm,
        hand=_HAND * arm,
        foot_length=(blend(_FOOT_LENGTH, male) + _FOOT_LENGTH_SD * z[9]) * stature,
        foot_breadth=blend(_FOOT_BREADTH, male) * stature,
        segment_mass=_segment_masses(mass, male, z[8]),
    )


def shape_for(stature: float, mass: float, male_fraction: float = 0.5) -> NDArray[np.float64]:
    """Return the most ordinary shape vector (10,) of a person of that stature (m), mass (kg) and sex blend.

    Raises:
        ShapeError: stature or mass outside the supported range, or a male fraction outside [0, 1].
    """
    _require("stature", stature, STATURE_RANGE, " m")
    _require("mass", mass, MASS_RANGE, " kg")
    _require("male fraction", male_fraction, (0.0, 1.0), "")
    male = min(max(male_fraction, 1e-6), 1 - 1e-6)
    shape = np.zeros(N_SHAPE)
    shape[0] = NormalDist().inv_cdf(male) / _SEX_STEEPNESS
    shape[1] = (stature - blend(_STATURE_MEAN, male)) / blend(_STATURE_SD, male)
    shape[2] = np.log(mass / stature**2 / blend(_BMI_MEDIAN, male)) / _BMI_LOG_SD
    return shape


def shape_like(
    stature: float,
    mass: float,
    male_fraction: float,
    *,
    hip_height: float,
    knee_height: float,
    arm: float,
    biacromial: float,
    hip_half_width: float,
    foot_length: float,
) -> NDArray[np.float64]:
    """Return the shape vector (10,) of somebody who was measured; the inverse of `measure`.

    Args:
        stature: m.
        mass: kg.
        male_fraction: 0 female, 1 male.
        hip_height: of the joint's centre above the sole, m.
        knee_height: of the joint's centre above the sole, m.
        arm: upper arm and forearm, joint to joint, m.
        biacromial: over the shoulders' bones, m.
        hip_half_width: from the midline to the hip joint's centre, m.
        foot_length: heel to toe tip, m.

    Raises:
        ShapeError: see `shape_for`.
    """
    shape = shape_for(stature, mass, male_fraction)
    male, ankle = male_fraction, _ANKLE_HEIGHT * stature
    shank = (knee_height - ankle) / (hip_height - ankle)
    usual_arm = (blend(_UPPER_ARM, male) + blend(_FOREARM, male)) * stature
    shape[3] = (hip_height / stature - _HIP_HEIGHT) / _HIP_HEIGHT_SD
    shape[4] = (shank - _SHANK_SHARE) / _SHANK_SHARE_SD
    shape[5] = np.log(arm / usual_arm) / _ARM_SD
    shape[6] = (biacromial / stature - blend(_BIACROMIAL, male)) / _BIACROMIAL_SD
    shape[7] = (2.0 * hip_half_width / stature - blend(_HIP_JOINTS, male)) / _HIP_JOINTS_SD
    shape[9] = (foot_length / stature - blend(_FOOT_LENGTH, male)) / _FOOT_LENGTH_SD
    return shape


def sample_shapes(count: int, seed: int) -> NDArray[np.float64]:
    """Draw (count, 10) shape vectors of a population; people outside the supported range are drawn again."""
    rng = np.random.default_rng(seed)
    people = []
    while len(people) < count:
        shape = rng.standard_normal(N_SHAPE).clip(-3.0, 3.0)
        try:
            measure(shape)
        except ShapeError:
            continue
        people.append(shape)
    return np.array(people).reshape(count, N_SHAPE)


def _segment_masses(mass: float, male: float, trunk_shift: float) -> dict[str, float]:
    share = {name: blend(pair, male) for name, pair in SEGMENT_MASS.items()}
    for name in _TRUNK_SEGMENTS:
        share[name] *= 1 + _TRUNK_MASS_SD * trunk_shift
    total = sum(value * (1 if name in ("Head", *_TRUNK_SEGMENTS) else 2) for name, value in share.items())
    return {name: mass * value / total for name, value in share.items()}


def _checked(shape: ArrayLike) -> NDArray[np.float64]:
    z = np.asarray(shape, dtype=float)
    if z.shape != (N_SHAPE,):
        names = ", ".join(SHAPE_NAMES)
        raise ShapeError(f"A body shape has {N_SHAPE} numbers ({names}), not an array of shape {z.shape}.")
    if not np.isfinite(z).all():
        name = SHAPE_NAMES[int(np.argmin(np.isfinite(z)))]
        raise ShapeError(f"A body shape must be finite, but its {name} is not.")
    return z


def _require(name: str, value: float, bounds: tuple[float, float], unit: str) -> None:
    low, high = bounds
    if not low - 1e-9 <= value <= high + 1e-9:
        raise ShapeError(f"A body's {name} must lie between {low:g} and {high:g}{unit}, not at {value:.4g}.")
