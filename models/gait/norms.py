"""How people walk, as functions of speed: stride time, stance, pelvis motion, foot roll, arm swing.

Walking follows Boulic, Thalmann & Thalmann, "A global human walking model with real-time kinematic
personification" (1990), whose stride and support times restate Inman, Ralston & Todd, "Human Walking" (1981);
angles at a free pace are those of Perry, "Gait Analysis" (1992), chs. 3-6, and Murray et al. (1964, 1967).
Above `RUN_ONSET` the stance shortens until both feet are off the ground for a while (a jog).

Speeds are m/s, ``leg`` is hip to ankle in m, phases are shares of a stride from this foot's heel strike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREE_SPEED = 1.4
"""Free walking speed of adults, m/s (Bohannon 1997)."""
RUN_ONSET = (2.1, 2.7)
"""Speeds between which walking turns into a jog, m/s (transition about 2.1: Hreljac 1993)."""
MAX_STRIDE_DURATION = 1.9
"""Slower than this people shorten their step rather than step less often, s."""
GRAVITY = 9.81
"""m/s^2."""

CROSSING = 0.40
"""Share of the stance at which the hip passes over the ankle."""
TOE_OUT = np.radians(6.0)
"""Outward turn of the foot (Murray et al. 1964)."""
FLAT_PHASE = 0.09
"""Phase by which the fore-foot has come down after heel strike (Perry: loading response ends at 0.1-0.12)."""
HEEL_OFF = 0.55
"""Share of the stance after which the heel rises (Perry: 0.31-0.35 of the stride)."""


def smoothstep(x: Array) -> Array:
    """Cubic step from 0 to 1 on [0, 1], flat at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def running(speed: Array) -> Array:
    """Blend (...) of walk (0) and jog (1)."""
    low, high = RUN_ONSET
    return smoothstep((speed - low) / (high - low))


def stride_duration(speed: Array, leg: Array) -> Array:
    """Time (...) of two steps, s: ``1.346 / sqrt(speed / leg)`` (Boulic et al. 1990)."""
    relative = np.maximum(speed / leg, 1e-3)
    return np.minimum(1.346 / np.sqrt(relative), MAX_STRIDE_DURATION)


def stance_share(speed: Array, duration: Array) -> Array:
    """Share (...) of the stride a foot stands: ``0.752 T - 0.143 s`` (Boulic et al. 1990), less when fast."""
    walk = 0.752 - 0.143 / duration - 0.03 * np.clip((speed - 1.2) / 0.8, 0.0, 1.0)
    return walk + running(speed) * (0.40 - walk)


def vigour(speed: Array) -> Array:
    """How far the foot rolls and the limbs swing, 1 at the free speed."""
    return np.clip(speed / FREE_SPEED, 0.0, 1.3) ** 0.6


def vertical_excursion(speed: Array, step: Array, leg: Array) -> Array:
    """Rise of the pelvis (...) from double support to mid-stance, m; negative in a jog.

    Walking: an inverted pendulum of length ``leg`` on rockers (McGeer 1990, Gard & Childress 2001).
    """
    walk = np.minimum(0.7 * step * step / (8.0 * leg), 0.05)
    return walk + running(speed) * (-0.06 - walk)


TOE_OFF_PITCH = np.radians(62.0)
"""Pitch of the foot at toe-off at `FREE_SPEED`, heel up (Perry)."""
HEEL_STRIKE_PITCH = np.radians(-18.0)
"""Pitch of the foot at heel strike at `FREE_SPEED`, toes up (Perry: 20-25 deg)."""
PELVIS_YAW = np.radians(5.0)
"""Amplitude of pelvic rotation (Perry; Murray et al. 1964)."""
PELVIS_ROLL = np.radians(3.5)
"""Amplitude of pelvic drop on the swing side (Perry: 4 deg)."""
PELVIS_SWAY = 0.018
"""Amplitude of the pelvis' lateral path, m (Murray et al. 1964: 0.022; Orendurff et al. 2004)."""
SHOULDER_FLEXION = np.radians(8.0)
SHOULDER_EXTENSION = np.radians(24.0)
"""Range of the upper arm about hanging at `FREE_SPEED` (Murray et al. 1967)."""
ELBOW_FLEXION = np.radians((15.0, 20.0))
"""Elbow angle at the back of the swing and what the forward swing adds (Murray et al. 1967)."""
