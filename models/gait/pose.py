"""From the state of a walker's feet and stride to pelvis, ankles, trunk and arms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..body.body import BODY_INDEX
from ..body.skeleton import JOINT_INDEX, JOINT_LIMITS, matrix_from_triplet
from . import footsteps, norms
from .leg_ik import Legs, angle_within
from .norms import smoothstep
from .state import State

Array = NDArray[np.float64]

_SIDES = np.array([1.0, -1.0])
_STANDING_KNEE = 0.12  # rad: bend of the knees when standing
_LEAST_KNEE = 0.06  # rad: the straightest a leg may get
_MAX_ROLL = np.radians(75.0)  # of a standing foot on its toes
_TOE_BEND = np.radians(50.0)
_ANKLE_RANGE = JOINT_LIMITS[JOINT_INDEX["L_Ankle_y"]] + np.radians([1.0, -1.0])
_RISE_RATE = 0.5  # m/s: fastest recovery of the pelvis from a long step
_BENT_UP, _BENT_DOWN = 0.25, 0.5  # share of a step's rise by which the pelvis is lower, uphill and downhill
_DOWNHILL = 0.1  # fall over run from which it is the latter
_BENT_ASIDE = 0.15  # m/rad: how much lower it is where the soles tilt sideways, so that no leg jams
_SOFT = 0.006  # m: rounding of the pelvis' path where a leg's reach begins to bind


def pelvis_motion(s: State) -> tuple[Array, Array, Array]:
    """Pelvis turn (n, 3) about x, y, z in rad; sway (n,) to the left and height (n,) above the ground, m."""
    cycle, vigour, speed = 2.0 * np.pi * s["phase"], s["vigour"], s["speed"]
    duration, support = footsteps.stride(s)
    run = norms.running(speed)
    roll = norms.PELVIS_ROLL * vigour * np.sin(cycle + 0.2 * np.pi)
    yaw = -norms.PELVIS_YAW * vigour * np.cos(cycle)
    turn = np.stack([roll, 0.02 * vigour + 0.10 * run, yaw], -1)

    idle = 1.0 - np.minimum(vigour, 1.0)
    slow = 2.0 * np.pi * (0.08 * s["time"] + s["id"] * 0.6180339887498949)
    sway = norms.PELVIS_SWAY * np.minimum(1.3 * vigour, 1.0) * np.sin(cycle - 0.1 * np.pi)
    sway += 0.006 * idle * (np.sin(slow) + 0.5 * np.sin(2.7 * slow))

    leg = Legs(s["thigh"][:, 0], s["shank"][:, 0])
    stand = s["pelvis_height"] - (leg.reach(0.0) - leg.reach(_STANDING_KNEE))
    rise = norms.vertical_excursion(speed, 0.5 * speed * duration, leg.reach())
    rise *= np.minimum(vigour, 1.0)
    wave = np.cos(2.0 * (cycle - 2.0 * np.pi * norms.CROSSING * support))
    height = stand - 0.012 * vigour - 0.055 * run + 0.5 * rise * (wave - 1.0)
    # Legs bend on slopes, for one foot is a step's rise below the other: more so on the way down, where the
    # body would dive at every step.
    down = smoothstep(-s["climb"] / _DOWNHILL)
    height -= (_BENT_UP + (_BENT_DOWN - _BENT_UP) * down) * s["grade"] * 0.5 * speed * duration
    height -= _BENT_ASIDE * np.abs(s["place"][..., 5]).max(-1)
    return turn, sway, height


def lean(s: State) -> Array:
    """Roll and pitch (n, 2), rad, that bring the body's weight in line with its acceleration.

    Who turns left leans to the left, who speeds up leans ahead; feet are put down accordingly.
    """
    sideways = footsteps.centripetal(s)
    ahead = np.clip(s["acceleration"], -footsteps.HARDEST_LEAN, footsteps.HARDEST_LEAN)
    return np.stack([-np.arctan(sideways / norms.GRAVITY), 0.5 * np.arctan(ahead / norms.GRAVITY)], -1)


def sole_rotation(place: Array) -> Array:
    """World rotations (..., 3, 3) of flat feet at places (..., 6): yaw about z, then pitch, then roll."""
    (cy, cp, cr), (sy, sp, sr) = (np.moveaxis(f(place[..., 3:6]), -1, 0) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def ankle_positions(s: State, sole: Array) -> Array:
    """Ankles (n, 2, 3) in m, world.

    The foot rolls over the heel's edge, the ball and the tip of the toes, one after the other (the "rockers"
    of Perry): whichever touches the ground keeps its place.
    """
    roll = s["roll"]
    soft = 0.8 * (s["swing"] * (1.0 - s["swing"]))  # in the air one pivot passes smoothly into the other
    rise = 0.5 * (roll + np.sqrt(roll * roll + soft * soft) - soft)
    toes = rise + toe_bend(s)  # pitch of the toes themselves
    ball = s["toe"]
    local = _pivot_shift(s["heel"], roll - rise) + _pivot_shift(s["tip"], toes)
    local += _pivot_shift(ball, rise) - _pivot_shift(ball, toes)
    local[..., 2] -= s["heel"][..., 2]  # the ankle's height over the sole
    return s["place"][..., :3] + (sole @ local[..., None])[..., 0]


def _pivot_shift(pivot: Array, angle: Array) -> Array:
    """Displacement (..., 3) of a frame's origin when the frame pitches about a point given in it."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, z = pivot[..., 0], pivot[..., 2]
    shift = np.zeros(pivot.shape)
    shift[..., 0] = x - cos * x - sin * z
    shift[..., 2] = z + sin * x - cos * z
    return shift


def toe_bend(s: State) -> Array:
    """Toe joints' y angle (n, 2) in rad: flat as the heel rises, as far as toes bend; straight in the air."""
    rise = np.maximum(s["roll"], 0.0)
    return -_TOE_BEND * np.tanh(rise / _TOE_BEND) * (1.0 - s["swing"]) ** 1.3


def fit_legs(s: State, pelvis: Array, hip: Array, sole: Array, legs: Legs, dt: float) -> None:
    """Raise heels, then lower pelvises (n, 3), until every leg reaches its foot.

    Args:
        s: walkers; their feet's ``roll`` is raised in place.
        pelvis: wanted positions, world, m; the height is lowered in place.
        hip: pelvis to hips (n, 2, 3), world, m.
        sole: `sole_rotation` of the feet.
        legs: the walkers' legs.
        dt: time since the last pose, s.
    """
    length = legs.reach(_LEAST_KNEE)
    wanted = pelvis[:, 2].copy()
    pelvis[:, 2] -= np.maximum(s["crouch"] - _RISE_RATE * dt, 0.0)
    _stoop(s, pelvis, hip, length)
    ankle = ankle_positions(s, sole)
    ahead = np.sum((pelvis[:, None, :2] + hip[..., :2] - ankle[..., :2]) * sole[..., :2, 0], -1)
    leading = ahead <= 0.0
    _lower(pelvis, hip, ankle, np.where(leading, length, 9.0))

    # The squared distance from hip to ankle, the foot pitched by p about its toe joint, is
    # |q|^2 + |t|^2 + 2 q . Ry(p) t, with q from toe joint to hip and t from ankle to toe joint.
    t = s["toe"]
    flat = s["toe"].copy()
    flat[..., 2] -= s["heel"][..., 2]
    joint = s["place"][..., :3] + (sole @ flat[..., None])[..., 0]
    q = (np.swapaxes(sole, -1, -2) @ (pelvis[:, None] + hip - joint)[..., None])[..., 0]
    bound = length**2 - np.sum(q * q + t * t, -1) - 2.0 * q[..., 1] * t[..., 1]
    needed = angle_within(
        2.0 * (q[..., 0] * t[..., 0] + q[..., 2] * t[..., 2]),
        2.0 * (q[..., 0] * t[..., 2] - q[..., 2] * t[..., 0]),
        bound,
    )
    rising = s["planted"] & ~leading
    s["roll"] = np.where(rising, np.maximum(s["roll"], np.minimum(needed, _MAX_ROLL)), s["roll"])
    _lower(pelvis, hip, ankle_positions(s, sole), length)
    s["crouch"] = wanted - pelvis[:, 2]


def _stoop(s: State, pelvis: Array, hip: Array, length: Array) -> None:
    """Lower pelvises (n, 3) in place towards a landing that will ask for it, and rise after it."""
    duration, support = footsteps.stride(s)
    ahead = norms.CROSSING * support * duration * np.linalg.norm(s["velocity"], axis=-1)
    heel = s["heel"]
    lifted = np.hypot(heel[..., 0], heel[..., 2]) * np.sin(
        np.arctan2(-heel[..., 2], -heel[..., 0]) + np.maximum(-s["landing"], 0.0)
    )  # the ankle's height when the heel's edge touches down
    across = np.minimum(ahead[:, None], 0.8 * length)
    top = s["target"][..., 2] + lifted - hip[..., 2] + np.sqrt(length**2 - across**2)
    since = smoothstep(footsteps.foot_phases(s) / 0.12)
    share = np.where(s["planted"], 1.0 - since, smoothstep((s["swing"] - 0.1) / 0.9))
    pelvis[:, 2] -= (np.maximum(pelvis[:, 2:] - top, 0.0) * share).max(1)


def solve_legs(s: State, pelvis: Array, rotation: Array, hip: Array, sole: Array, legs: Legs) -> Array:
    """Hip, knee and ankle angles (n, 2, 3, 3) in rad; heels rise or sink where an ankle cannot bend as far.

    Args:
        s: walkers; their feet's ``roll`` may be changed.
        pelvis: positions (n, 3), world, m; lowered if need be.
        rotation: pelvis rotations (n, 3, 3), world.
        hip: pelvis to hips (n, 2, 3), world, m.
        sole: `sole_rotation` of the feet.
        legs: the walkers' legs.
    """
    angles = _solve(s, pelvis, rotation, hip, sole, legs)
    for _ in range(4):
        excess = _ankle_excess(angles)
        rows = np.flatnonzero(excess.any(1))
        if not rows.size:
            break
        part, low, legs_part = s[rows], pelvis[rows], Legs(s["thigh"][rows], s["shank"][rows])
        part["roll"] += excess[rows]
        _lower(low, hip[rows], ankle_positions(part, sole[rows]), legs_part.reach(_LEAST_KNEE))
        angles[rows] = _solve(part, low, rotation[rows], hip[rows], sole[rows], legs_part)
        s["roll"][rows], pelvis[rows] = part["roll"], low
    return angles


def _solve(s: State, pelvis: Array, rotation: Array, hip: Array, sole: Array, legs: Legs) -> Array:
    into_pelvis = np.swapaxes(rotation, -1, -2)[:, None]
    # The knee looks where the foot points, a quarter towards where the pelvis does.
    hinge = 0.75 * (into_pelvis @ sole[..., 1:2])[..., 0] + 0.25 * np.array([0.0, 1.0, 0.0])
    ankle = into_pelvis @ (ankle_positions(s, sole) - pelvis[:, None] - hip)[..., None]
    pitch = np.zeros((*s["roll"].shape, 3))
    pitch[..., 1] = s["roll"]
    return legs.solve(ankle[..., 0], hinge, into_pelvis @ sole @ matrix_from_triplet(pitch))


def _ankle_excess(angles: Array) -> Array:
    """Pitch (n, 2) in rad by which feet must rise (or sink, < 0) to bring their ankles within range."""
    low, high = _ANKLE_RANGE
    bend = angles[..., 2, 1]
    return np.maximum(low - bend, 0.0) - np.maximum(bend - high, 0.0)


def _lower(pelvis: Array, hip: Array, ankle: Array, length: Array) -> None:
    """Lower pelvises (n, 3) in place, smoothly, until legs of that length (n, 2) reach."""
    across = np.sum((pelvis[:, None, :2] + hip[..., :2] - ankle[..., :2]) ** 2, -1)
    top = ankle[..., 2] - hip[..., 2] + np.sqrt(np.maximum(length**2 - across, (0.3 * length) ** 2))
    for foot in range(2):
        gap = np.maximum(pelvis[:, 2] - top[:, foot], -1.0)
        pelvis[:, 2] -= 0.5 * (gap + np.sqrt(gap * gap + _SOFT * _SOFT))


def upper_body(s: State, turn: Array, lean: Array, joints: Array) -> None:
    """Set trunk, head and arms in joints (n, 23, 3), given the pelvis' turn (n, 3) and the lean (n, 2)."""
    vigour, run = s["vigour"], norms.running(s["speed"])
    idle = 1.0 - np.minimum(vigour, 1.0)

    # The thorax turns against the pelvis by 0.6 of it and stays upright; the head looks ahead, into the turn.
    breath = 0.010 * np.sin(2.0 * np.pi * (0.25 * s["time"] + s["id"] * 0.7548776662466927))
    for body, share in (("Torso", 0.3), ("Spine", 0.3), ("Chest", 0.4)):
        joints[:, BODY_INDEX[body] - 1] = share * turn * np.array([-0.9, -0.3, -1.6])
    joints[:, BODY_INDEX["Chest"] - 1, 1] += breath * (0.4 + 0.6 * idle)
    gaze = np.clip(0.25 * s["turn_rate"], -0.5, 0.5) + 0.6 * turn[:, 2]
    for body in ("Neck", "Head"):
        joints[:, BODY_INDEX[body] - 1, 2] = 0.5 * gaze
        joints[:, BODY_INDEX[body] - 1, 1] = -0.35 * (turn[:, 1] + lean[:, 1]) - 0.3 * breath
        joints[:, BODY_INDEX[body] - 1, 0] = -0.35 * lean[:, 0]

    # Each arm swings with the other side's leg: left forward at the right heel strike.
    wave = -np.cos(2.0 * np.pi * s["phase"] - 0.2)[:, None] * _SIDES
    low, high = -norms.SHOULDER_EXTENSION, norms.SHOULDER_FLEXION
    swing = (0.5 * (low + high) + 0.5 * (high - low) * wave) * vigour[:, None] + 0.12 * idle[:, None]
    swing = swing + run[:, None] * (0.1 + 0.15 * wave)
    back, more = norms.ELBOW_FLEXION
    elbow = back + more * vigour[:, None] * (0.5 + 0.5 * wave) + 1.0 * run[:, None]
    for side, prefix in enumerate(("L_", "R_")):
        sign = _SIDES[side]
        shoulder, hinge = BODY_INDEX[prefix + "Shoulder"] - 1, BODY_INDEX[prefix + "Elbow"] - 1
        joints[:, shoulder, 0] = sign * (-0.5 * np.pi + 0.10 + 0.05 * run)
        joints[:, shoulder, 2] = -sign * swing[:, side]
        joints[:, hinge, 2] = -sign * elbow[:, side]
