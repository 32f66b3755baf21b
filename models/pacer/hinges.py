"""Hinge angles and their rates from the poses and angular velocities of the bodies they join."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body import N_JOINTS, PARENTS
from .mathops import rotate_back

Array = NDArray[np.float64]

_PARENTS = np.array(PARENTS[1:])
_FLAT = 1e-3  # least cosine of the middle angle: at a quarter turn x and z hinges are one axis


def hinges_from_states(states: ArrayLike) -> tuple[Array, Array]:
    """Angles (N, 69), rad, and rates (N, 69), rad/s, of the hinges.

    A body is turned against its parent by ``Rx(a) Ry(b) Rz(c)``, with b between -pi/2 and pi/2; its angular
    velocity against the parent, in the parent's frame, is ``a' x + b' Rx y + c' Rx Ry z``.

    Args:
        states: (N, 24, 13) position, rotation wxyz, velocity and angular velocity of all bodies, world.
    """
    states = np.asarray(states, dtype=float)
    turned, spin = states[..., 3:7], states[..., 10:13]
    parent = turned[:, _PARENTS]
    w, x, y, z = np.moveaxis(_conjugate_product(parent, turned[:, 1:]), -1, 0)
    a = np.arctan2(2 * (w * x - y * z), 1 - 2 * (x * x + y * y))
    sine = np.clip(2 * (x * z + w * y), -1.0, 1.0)
    c = np.arctan2(2 * (w * z - x * y), 1 - 2 * (y * y + z * z))
    angles = np.stack([a, np.arcsin(sine), c], -1)

    p, q, r = np.moveaxis(rotate_back(parent, spin[:, 1:] - spin[:, _PARENTS]), -1, 0)
    cos, sin = np.cos(a), np.sin(a)
    third = (cos * r - sin * q) / np.maximum(np.sqrt(1 - sine * sine), _FLAT)
    rates = np.stack([p - sine * third, cos * q + sin * r, third], -1)
    return angles.reshape(-1, N_JOINTS), rates.reshape(-1, N_JOINTS)


def _conjugate_product(a: Array, b: Array) -> Array:
    """Quaternions (..., 4) of ``inverse(a) b``."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw + ax * bx + ay * by + az * bz,
            aw * bx - ax * bw - ay * bz + az * by,
            aw * by + ax * bz - ay * bw - az * bx,
            aw * bz - ax * by + ay * bx - az * bw,
        ],
        -1,
    )
