"""Analytic inverse kinematics of the leg: three hinges at the hip, one at the knee, three at the ankle.

With thigh ``a``, shank ``b`` (zero pose) and knee angle ``k`` about y, the squared distance from hip to ankle
is ``|a|^2 + |b|^2 + 2 (a_y b_y + P cos k + Q sin k)``: closed form for any offsets, not only for straight
legs. The angle left over, the swivel about the line from hip to ankle (Tolani, Goswami & Badler 2000), is
fixed by the direction wanted for the knee's hinge axis.

All arrays broadcast over ``...``, which is usually (agents, 2), left leg first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body.skeleton import matrix_from_triplet, triplet_from_matrix

Array = NDArray[np.float64]


class Legs:
    """The legs of one or many bodies, ready to be solved."""

    def __init__(self, thigh: ArrayLike, shank: ArrayLike) -> None:
        """Take hip-to-knee and knee-to-ankle offsets (..., 3) in m, in the zero pose."""
        a, b = np.asarray(thigh, dtype=float), np.asarray(shank, dtype=float)
        self.thigh, self.shank = a, b
        cosine = 2.0 * (a[..., 0] * b[..., 0] + a[..., 2] * b[..., 2])
        sine = 2.0 * (a[..., 0] * b[..., 2] - a[..., 2] * b[..., 0])
        self._mean = np.sum(a * a + b * b, -1) + 2.0 * a[..., 1] * b[..., 1]
        self._amplitude = np.hypot(cosine, sine)
        self._straight = np.arctan2(sine, cosine)

    def reach(self, knee: ArrayLike = 0.0) -> Array:
        """Distance (...) in m from hip to ankle at knee angle (...) in rad beyond straight."""
        return np.sqrt(self._mean + self._amplitude * np.cos(knee))

    def lever(self, knee: ArrayLike) -> Array:
        """Torque (...) in Nm at the knee per N of load from hip to ankle, at knee angle (...) in rad."""
        return 0.5 * self._amplitude * np.sin(knee) / self.reach(knee)

    def knee_angle(self, distance: Array) -> Array:
        """Knee angle (...) in rad at a hip-to-ankle distance (...) in m; straight where out of reach."""
        cosine = (distance * distance - self._mean) / self._amplitude
        return self._straight + np.arccos(np.clip(cosine, -1.0, 1.0))

    def solve(self, ankle: Array, hinge: Array, foot: Array) -> Array:
        """Return the hinge angles that put the ankle in its place and turn the foot as asked.

        Args:
            ankle: hip to ankle (..., 3) in m, in the pelvis frame.
            hinge: direction (..., 3) the knee's axis (y of the thigh) should take as nearly as the ankle's
                place allows, in the pelvis frame; not parallel to ``ankle``.
            foot: rotation (..., 3, 3) of the foot in the pelvis frame.

        Returns:
            Angles (..., 3, 3) in rad: hip, knee and ankle, each x, y, z. A target out of reach is met by a
            straight leg pointing at it.
        """
        knee = self.knee_angle(np.linalg.norm(ankle, axis=-1))
        cos, sin = np.cos(knee), np.sin(knee)
        a, b = self.thigh, self.shank
        chain = np.stack(
            np.broadcast_arrays(
                a[..., 0] + cos * b[..., 0] + sin * b[..., 2],
                a[..., 1] + b[..., 1],
                a[..., 2] - sin * b[..., 0] + cos * b[..., 2],
            ),
            axis=-1,
        )  # hip to ankle in the thigh's frame
        thigh = _frame(ankle, hinge) @ np.swapaxes(_frame(chain, np.array([0.0, 1.0, 0.0])), -1, -2)
        angles = np.zeros((*knee.shape, 3, 3))
        angles[..., 0, :] = _beyond_quarter(triplet_from_matrix(thigh))
        angles[..., 1, 1] = knee
        shank = thigh @ matrix_from_triplet(angles[..., 1, :])
        angles[..., 2, :] = triplet_from_matrix(np.swapaxes(shank, -1, -2) @ foot)
        return angles


def _beyond_quarter(triplet: Array) -> Array:
    """The same rotations (..., 3) with |x| at most a quarter turn: a thigh may rise past the horizontal."""
    half = np.copysign(np.pi, triplet)
    turned = np.concatenate([triplet[..., :1], -triplet[..., 1:2], triplet[..., 2:]], -1)
    turned += np.concatenate([-half[..., :1], half[..., 1:2], -half[..., 2:]], -1)
    return np.where(np.abs(triplet[..., :1]) > 0.5 * np.pi, turned, triplet)


def _frame(along: Array, near: Array) -> Array:
    """Rotation (..., 3, 3) whose first column is ``along``, the second as close to ``near`` as can be."""
    first = along / np.linalg.norm(along, axis=-1, keepdims=True)
    second = near - np.sum(near * first, axis=-1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def angle_within(cosine: Array, sine: Array, bound: Array) -> Array:
    """Smallest angle p >= 0 (...) with ``cosine * cos p + sine * sin p <= bound``; the minimiser if none.

    Solves "how far must the heel rise until the leg is long enough": the squared distance from the hip to a
    point on a circle is of that form.
    """
    amplitude = np.hypot(cosine, sine)
    peak = np.arctan2(sine, cosine)
    # `cosine cos p + sine sin p = amplitude cos(p - peak)` falls on [peak, peak + pi].
    p = peak + np.arccos(np.clip(bound / np.maximum(amplitude, 1e-12), -1.0, 1.0))
    return np.where(cosine <= bound, 0.0, p)
