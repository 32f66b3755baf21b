"""Rotations in batches: quaternions wxyz, matrices, rotation vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def matrix_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4), wxyz."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=float), -1, 0)
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0] = 1 - 2 * (y * y + z * z)
    matrix[..., 0, 1] = 2 * (x * y - w * z)
    matrix[..., 0, 2] = 2 * (x * z + w * y)
    matrix[..., 1, 0] = 2 * (x * y + w * z)
    matrix[..., 1, 1] = 1 - 2 * (x * x + z * z)
    matrix[..., 1, 2] = 2 * (y * z - w * x)
    matrix[..., 2, 0] = 2 * (x * z - w * y)
    matrix[..., 2, 1] = 2 * (y * z + w * x)
    matrix[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return matrix


def rotation_vector(after: ArrayLike, before: ArrayLike) -> NDArray[np.float64]:
    """Rotation vectors (..., 3), rad, world frame, that turn `before` into `after` (..., 4) the short way."""
    a = np.moveaxis(np.asarray(after, dtype=float), -1, 0)
    b = np.moveaxis(np.asarray(before, dtype=float), -1, 0)
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]  # after * conjugate(before)
    x = a[1] * b[0] - a[0] * b[1] - a[2] * b[3] + a[3] * b[2]
    y = a[2] * b[0] - a[0] * b[2] - a[3] * b[1] + a[1] * b[3]
    z = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    axis = np.stack([x, y, z], axis=-1) * np.where(w < 0, -1.0, 1.0)[..., None]
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = np.arctan2(sine, abs(w)[..., None])
    return axis * np.where(sine > 1e-12, 2 * half / np.maximum(sine, 1e-12), 2.0)


def yaw(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Turn (...,) about the vertical, rad, of rotations (..., 4), wxyz: the direction their x axes point in."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions, dtype=float), -1, 0)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
