"""Which parts of the feet stand on the ground, and feet that stand still there.

The legs' part of retargeting: proportions differ from person to person, so feet carried over by joint angles
alone slide, sink and tilt. Here each stance gets one place and one direction, soles lie flat, and analytic
inverse kinematics (`leg_ik`) bends the legs to fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_opening, gaussian_filter1d, maximum_filter1d

from ..body import BODY_INDEX, JOINT_INDEX, JOINT_LIMITS, Body
from ..body.skeleton import matrix_from_triplet
from ..gait.leg_ik import Legs

Array = NDArray[np.float64]

_LOW, _SLOW = 0.04, 0.4  # m above the floor and m/s: below both a part of the sole stands
_SHORT = 0.07  # s: contacts and gaps shorter than this are noise
_LEAST_KNEE = 0.04  # rad: the straightest a leg is made
_SOFT = 0.05  # s: width of smoothing
_SIDES = ("L_", "R_")
_DORSIFLEXION = 0.95 * JOINT_LIMITS[JOINT_INDEX["L_Ankle_y"], 0]  # rad; beyond it the heel leaves the ground
_HEEL_RAISES = 4  # rounds of raising heels and bending legs anew


@dataclass
class FootMotion:
    """World poses of both feet over T frames."""

    ankle: Array
    """(T, 2, 3) m, world: ankle joints, left first."""
    rotation: Array
    """(T, 2, 3, 3), world."""

    def soles(self, body: Body) -> Array:
        """World places (T, 2, 5, 3) of `body.SOLE_POINTS`, toes straight, m."""
        return self.ankle[:, :, None] + np.einsum("tfij,fpj->tfpi", self.rotation, body.sole)


def speed(points: Array, rate_hz: float) -> Array:
    """Speed (T, ...) of points (T, ..., 3), m/s."""
    return np.linalg.norm(np.gradient(points, 1 / rate_hz, axis=0), axis=-1)


def heel_and_ball(soles: Array) -> Array:
    """Middles (T, 2, 2, 3) of heel and ball of soles (T, 2, 5, 3)."""
    return np.stack([soles[:, :, :2].mean(2), soles[:, :, 2:4].mean(2)], axis=2)


def find_contacts(soles: Array, rate_hz: float, floor: float = 0.0) -> NDArray[np.bool_]:
    """Whether heel and ball of each foot stand (T, 2, 2), by height and speed of sole points (T, 2, 5, 3)."""
    points = heel_and_ball(soles)
    standing = (points[..., 2] < floor + _LOW) & (speed(points, rate_hz) < _SLOW)
    structure = np.ones((max(round(_SHORT * rate_hz), 1), 1, 1), dtype=bool)
    closed = binary_closing(np.pad(standing, ((3, 3), (0, 0), (0, 0)), mode="edge"), structure)
    return np.asarray(binary_opening(closed, structure)[3:-3], dtype=bool)


def find_floor(soles: Array, rate_hz: float) -> float:
    """Height of the ground, m: where the lower foot's lowest point is while it hardly moves."""
    points = heel_and_ball(soles).reshape(len(soles), 4, 3)
    height = points[..., 2]
    lowest = np.arange(len(soles)), height.argmin(1)
    pace = speed(points, rate_hz)[lowest]
    still = pace <= max(float(np.median(pace)), 0.2)
    return float(np.median(height[lowest][still]))


def level_soles(feet: FootMotion, toe: Array, rate_hz: float, most: float = 0.7) -> FootMotion:
    """Turn each foot by a constant so that its sole is level, on average, while it stands flat.

    Recorded skeletons place the foot's frame by their own markers: in CMU's rest pose, say, legs are
    splayed by 20 degrees and the feet rolled with them. What a sole does in the middle of its stance tells
    the true frame.

    Args:
        feet: feet as carried over.
        toe: (T, 2, 3) m, world: the toes' joints.
        rate_hz: frames per second.
        most: largest correction made, rad; a larger one would be no flat stance.
    """
    still = (speed(feet.ankle, rate_hz) < 0.3) & (speed(toe, rate_hz) < 0.3)
    rotation = feet.rotation.copy()
    for foot in range(2):
        flat = still[:, foot] & (toe[:, foot, 2] < np.quantile(toe[:, foot, 2], 0.5) + 0.02)
        if flat.sum() < max(3, 0.06 * rate_hz):
            continue
        up = np.median(rotation[flat, foot, 2], axis=0)  # world up in the foot's frame
        up /= np.linalg.norm(up)
        if np.arccos(up[2]) < most:
            rotation[:, foot] = rotation[:, foot] @ aligning(np.array([0.0, 0.0, 1.0]), up)
    return FootMotion(feet.ankle, rotation)


def aligning(a: Array, b: Array) -> Array:
    """Smallest rotation (3, 3) that turns direction `a` (3,) into `b` (3,)."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    v, c = np.cross(a, b), float(a @ b)
    if c < -1 + 1e-9:
        raise ValueError("Opposite directions have no smallest rotation between them.")
    skew = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1 + c)


def plant(
    feet: FootMotion, body: Body, rate_hz: float, rigid_toes: bool
) -> tuple[FootMotion, NDArray[np.bool_]]:
    """Let feet stand still and flat where they stand, and nowhere sink below z = 0.

    Toes that are not rigid give way: then only heel and ball stay above the ground.

    Returns:
        The feet and their contacts (T, 2, 2), see `find_contacts`.
    """
    contacts = find_contacts(feet.soles(body), rate_hz)
    ankle, rotation = feet.ankle.copy(), feet.rotation.copy()
    for foot in range(2):
        rotation[:, foot] = _flatten(rotation[:, foot], contacts[:, foot], rate_hz)
        stances = _intervals(np.any(contacts[:, foot], axis=-1))
        soles = ankle[:, foot, None] + np.einsum("tij,pj->tpi", rotation[:, foot], body.sole[foot])
        points = np.stack([soles[:, :2].mean(1), soles[:, 2:4].mean(1)], 1)
        shift = np.zeros((len(ankle), 3))
        shift[:, :2] = _hold(points[..., :2], contacts[:, foot], stances)
        shift[:, 2] = _ground(soles[:, : 5 if rigid_toes else 4, 2].min(1), stances, rate_hz)
        ankle[:, foot] += shift
    return FootMotion(ankle, rotation), contacts


def _intervals(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Runs of True as (first, last + 1)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _between(values: Array, stances: list[tuple[int, int]]) -> Array:
    """Ease values (T, ...) from one stance to the next; only those within stances are kept."""
    out = values.copy()
    if not stances:
        return np.zeros_like(values)
    out[: stances[0][0]] = values[stances[0][0]]
    out[stances[-1][1] :] = values[stances[-1][1] - 1]
    for (_, last), (first, _) in pairwise(stances):
        u = np.linspace(0.0, 1.0, first - last + 2)[1:-1]
        ease = (u * u * (3 - 2 * u)).reshape(-1, *[1] * (values.ndim - 1))
        out[last:first] = values[last - 1] + ease * (values[first] - values[last - 1])
    return out


def _flatten(rotation: Array, contacts: NDArray[np.bool_], rate_hz: float) -> Array:
    """One direction per stance; level while heel and ball stand; no roll while either does."""
    stances = _intervals(np.any(contacts, axis=-1))
    yaw = np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    offset = np.zeros(len(yaw))
    for first, last in stances:
        flat = contacts[first:last].all(-1)
        held = np.median(yaw[first:last][flat] if flat.any() else yaw[first:last])
        offset[first:last] = held - yaw[first:last]
    yaw += _between(offset, stances)
    pitch = np.arcsin(np.clip(-rotation[:, 2, 0], -1, 1))
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 2, 2])
    sigma = _SOFT * rate_hz
    level = gaussian_filter1d(contacts.all(-1).astype(float), 0.7 * sigma)
    steady = gaussian_filter1d(contacts.any(-1).astype(float), sigma)
    return _from_angles(yaw, pitch * (1 - level), roll * (1 - steady))


def _from_angles(yaw: Array, pitch: Array, roll: Array) -> Array:
    """Rotations (T, 3, 3) ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    zero = np.zeros_like(yaw)

    def about(axis: int, angle: Array) -> Array:
        angles = np.stack([zero] * 3, -1)
        angles[:, axis] = angle
        return matrix_from_triplet(angles)

    return about(2, yaw) @ about(1, pitch) @ about(0, roll)


def _hold(points: Array, contacts: NDArray[np.bool_], stances: list[tuple[int, int]]) -> Array:
    """Horizontal shift (T, 2) that keeps heel and ball (T, 2, 2) in place while they stand.

    The ball is the pivot whenever it stands, the heel before that.
    """
    shift = np.zeros((len(points), 2))
    for first, last in stances:
        ball = contacts[first + 1 : last, 1] & contacts[first : last - 1, 1]
        steps = np.diff(points[first:last], axis=0)
        slip = np.where(ball[:, None], steps[:, 1], steps[:, 0])
        path = np.concatenate([np.zeros((1, 2)), np.cumsum(slip, axis=0)])
        shift[first:last] = path.mean(0) - path
    return _between(shift, stances)


def _ground(lowest: Array, stances: list[tuple[int, int]], rate_hz: float) -> Array:
    """Rise (T,) of a sole whose lowest point is to be on the ground in stances and not below it elsewhere."""
    rise = _between(-lowest, stances)
    sunk = np.maximum(-(lowest + rise), 0.0)
    if sunk.any():
        sunk = _eased(sunk, rate_hz)
    return rise + sunk


def reach_feet(
    root: Array, pelvis: Array, hinges: Array, feet: FootMotion, body: Body, rate_hz: float, rigid_toes: bool
) -> tuple[Array, Array]:
    """Bend the legs so that the feet are where they should be.

    The pelvis is lowered where legs are too short; heels rise where ankles would bend too far.

    Args:
        root: (T, 3) m, world.
        pelvis: (T, 3, 3), world.
        hinges: (T, 2, 3): direction of the knees' axes, world.
        feet: where the feet are to be.
        body: the person.
        rate_hz: frames per second.
        rigid_toes: whether a heel that rises turns the foot about the toes' tip, or about the ball.

    Returns:
        The root (T, 3) and hip, knee and ankle angles (T, 2, 3, 3) of the left and right leg, rad.
    """
    index = [[BODY_INDEX[side + part] for part in ("Hip", "Knee", "Ankle")] for side in _SIDES]
    hip, thigh, shank = np.moveaxis(body.offsets[np.array(index)], 1, 0)  # (2, 3) each
    legs = Legs(thigh, shank)
    hips = np.einsum("tij,fj->tfi", pelvis, hip)
    into = np.swapaxes(pelvis, -1, -2)[:, None]
    hinges = (into @ hinges[..., None])[..., 0]
    length = legs.reach(_LEAST_KNEE)
    pivot = body.sole[:, 4] if rigid_toes else body.sole[:, 2:4].mean(1)

    def solve(feet: FootMotion) -> tuple[Array, Array]:
        lowered = _lower(root, hips, feet.ankle, length, rate_hz)
        ankle = (into @ (feet.ankle - lowered[:, None] - hips)[..., None])[..., 0]
        return lowered, legs.solve(ankle, hinges, into @ feet.rotation)

    lowered, angles = solve(feet)
    for _ in range(_HEEL_RAISES):
        stiff = np.maximum(_DORSIFLEXION - angles[:, :, 2, 1], 0.0)
        if stiff.max() < np.radians(0.5):
            break
        feet = _raise_heels(feet, _eased(stiff, rate_hz), pivot)
        lowered, angles = solve(feet)
    return lowered, angles


def _lower(root: Array, hips: Array, ankle: Array, length: Array, rate_hz: float) -> Array:
    """Root (T, 3) lowered until legs of that length (2,) reach from hips (T, 2, 3), root frame, to ankles."""
    across = np.sum((root[:, None, :2] + hips[..., :2] - ankle[..., :2]) ** 2, -1)
    top = ankle[..., 2] - hips[..., 2] + np.sqrt(np.maximum(length**2 - across, (0.3 * length) ** 2))
    excess = _eased(np.maximum(root[:, 2] - top.min(1), 0.0), rate_hz)
    return root - np.stack([0 * excess, 0 * excess, excess], -1)


def _eased(peaks: Array, rate_hz: float) -> Array:
    """Smooth values (T, ...) that are nowhere below `peaks`."""
    width = 2 * round(_SOFT * rate_hz) + 1
    widened = maximum_filter1d(peaks, width, axis=0)
    return np.maximum(gaussian_filter1d(widened, _SOFT * rate_hz, axis=0), peaks)


def _raise_heels(feet: FootMotion, angle: Array, pivot: Array) -> FootMotion:
    """Pitch feet by angles (T, 2), rad, about points (2, 3) m of theirs."""
    still = feet.ankle + np.einsum("tfij,fj->tfi", feet.rotation, pivot)
    zero = np.zeros_like(angle)
    rotation = feet.rotation @ matrix_from_triplet(np.stack([zero, angle, zero], -1))
    return FootMotion(still - np.einsum("tfij,fj->tfi", rotation, pivot), rotation)
