"""Convex hulls of small sets of points in space, without further dependencies."""

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


def convex_hull(points: Points) -> NDArray[np.intp]:
    """Triangles of the convex hull, by adding one point after the other.

    Args:
        points: (K, 3), not all in one plane.

    Returns:
        (F, 3) indices into `points`, counter-clockwise seen from outside. Points inside are not used; of
        points in one plane the triangulation is any.

    Raises:
        ValueError: fewer than four points, or all in one plane.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"a hull needs at least 4 points (K, 3), got {points.shape}")
    size = float(np.ptp(points, axis=0).max())
    # Nothing is decided by points that happen to lie in one plane if none do.
    if not size > 0:
        raise ValueError("the points of a hull must not all be one")
    moved = points + 1e-7 * size * np.random.default_rng(0).standard_normal(points.shape)
    start = _tetrahedron(moved, 1e-5 * size)
    faces = np.array([[start[i] for i in face] for face in ((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2))])
    inside = moved[start].mean(axis=0)
    faces = _turned_outwards(moved, faces, inside)
    for index in np.setdiff1d(np.arange(len(points)), start):
        corners = moved[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        seen = np.einsum("fi,fi->f", normals, moved[index] - corners[:, 0]) > 0
        if not seen.any():
            continue
        edges = faces[seen][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        known = {(int(a), int(b)) for a, b in edges}
        horizon = [(a, b) for a, b in known if (b, a) not in known]
        faces = np.concatenate([faces[~seen], [(a, b, index) for a, b in sorted(horizon)]])
    return faces


def _tetrahedron(points: Points, flat: float) -> list[int]:
    """Four points that span space."""
    first = int(points[:, 0].argmin())
    arms = points - points[first]
    second = int(np.linalg.norm(arms, axis=1).argmax())
    axis = arms[second] / np.linalg.norm(arms[second])
    third = int(np.linalg.norm(arms - np.outer(arms @ axis, axis), axis=1).argmax())
    normal = np.cross(axis, arms[third])
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    away = np.abs(arms @ normal)
    fourth = int(away.argmax())
    if not away[fourth] > flat:
        raise ValueError("the points of a hull must not all lie in one plane")
    return [first, second, third, fourth]


def _turned_outwards(points: Points, faces: NDArray[np.intp], inside: Points) -> NDArray[np.intp]:
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = np.einsum("fi,fi->f", normals, corners[:, 0] - inside) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return faces
