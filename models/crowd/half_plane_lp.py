"""Two- and three-dimensional linear programs over half-planes and a disc, solved for a whole crowd at once.

The incremental algorithm of van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance"
(2011), section 5.3. A constraint is a unit normal `n` and an offset `h`; a velocity `x` obeys it when `n . x
>= h`. Every program also obeys `|x| <= max_speed`. A constraint with `n = 0`, `h = -1` always holds and
serves as padding.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE = 1e-9  # m/s by which a constraint may be missed
PARALLEL = 1e-9  # sine below which two boundary lines count as parallel


def dot(a: Array, b: Array) -> Array:
    """Scalar product over a last axis of 2."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def perpendicular(a: Array) -> Array:
    """Rotate by 90 degrees counter-clockwise over a last axis of 2."""
    turned = np.empty_like(a)
    np.negative(a[..., 1], out=turned[..., 0])
    turned[..., 1] = a[..., 0]
    return turned


def closest_point(
    normal: Array, offset: Array, max_speed: Array, target: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Find the velocity nearest to a target that obeys all constraints.

    Args:
        normal: (M, K, 2) unit normals of the permitted half-planes.
        offset: (M, K) offsets, m/s.
        max_speed: (M,) radius of the disc, m/s.
        target: (M, 2) wanted velocity, m/s.

    Returns:
        (M, 2) velocity, and (M,) index of the first constraint that could not be met (K when all are met);
        the velocity then obeys every constraint before that one.
    """
    speed = np.sqrt(dot(target, target))
    shrink = np.minimum(1.0, max_speed / np.maximum(speed, 1e-12))
    return _incremental(normal, offset, max_speed, target, target * shrink[:, None], linear=False)


def farthest_point(
    normal: Array, offset: Array, max_speed: Array, along: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Find the velocity farthest along a unit direction (M, 2); otherwise as `closest_point`."""
    return _incremental(normal, offset, max_speed, along, along * max_speed[:, None], linear=True)


def least_violation(
    normal: Array, offset: Array, hard: int, max_speed: Array, start: Array, failed: NDArray[np.intp]
) -> Array:
    """Minimise the largest violation of the soft constraints while the hard ones hold (the 3-D program).

    Args:
        normal: (M, K, 2) unit normals.
        offset: (M, K) offsets, m/s.
        hard: number of leading constraints that may not be violated.
        max_speed: (M,) radius of the disc, m/s.
        start: (M, 2) velocity that obeys the constraints before `failed`, m/s.
        failed: (M,) index of the first unmet constraint, at least `hard`.

    Returns:
        (M, 2) velocity, m/s.
    """
    x, violation = start.copy(), np.zeros(len(start))
    column = np.arange(offset.shape[1])
    rows, reached = np.arange(len(start)), failed - 1
    while rows.size:
        excess = offset[rows] - dot(normal[rows], x[rows, None]) - violation[rows, None] > TOLERANCE
        excess &= column > np.maximum(reached, hard - 1)[:, None]
        keep = excess.any(axis=1)
        rows, worst = rows[keep], excess.argmax(axis=1)[keep]
        if not rows.size:
            break
        n, h = normal[rows], offset[rows]  # (m, K, 2), (m, K)
        n_worst, h_worst = normal[rows, worst], offset[rows, worst]
        # Where constraint j is violated no more than `worst`: (n_j - n_worst) . x >= h_j - h_worst.
        level, gap = n - n_worst[:, None], h - h_worst[:, None]
        length = np.sqrt(dot(level, level))
        usable = (length > PARALLEL) & (column < worst[:, None])
        length = np.where(usable, length, 1.0)
        level = np.where(usable[..., None], level / length[..., None], 0.0)
        gap = np.where(usable, gap / length, -1.0)
        level[:, :hard], gap[:, :hard] = n[:, :hard], h[:, :hard]
        found, unmet = farthest_point(level, gap, max_speed[rows], n_worst)
        x[rows] = np.where((unmet == len(column))[:, None], found, x[rows])
        violation[rows] = h_worst - dot(n_worst, x[rows])
        reached = worst
    return x


def _incremental(
    normal: Array, offset: Array, max_speed: Array, goal: Array, start: Array, linear: bool
) -> tuple[Array, NDArray[np.intp]]:
    """Add constraints one by one; whenever one is violated the optimum moves onto its boundary line.

    Each problem keeps its own position in its list, so the loop runs as often as the hardest problem moves.
    """
    count = offset.shape[1]
    x, failed = start.copy(), np.full(len(start), count)
    if count == 0:
        return x, failed
    column = np.arange(count)
    rows, reached = np.arange(len(start)), np.full(len(start), -1)
    n, h, point = normal, offset, x
    while True:
        violated = (dot(n, point[:, None]) < h - TOLERANCE) & (column > reached[:, None])
        index = violated.argmax(axis=1)
        keep = np.flatnonzero(violated[np.arange(len(index)), index])
        if not keep.size:
            return x, failed
        rows, reached, n, h = rows[keep], index[keep], n[keep], h[keep]
        point, solved = _on_line(n, h, reached, max_speed[rows], goal[rows], linear)
        failed[rows[~solved]] = reached[~solved]
        rows, reached, n, h, point = rows[solved], reached[solved], n[solved], h[solved], point[solved]
        x[rows] = point


def _on_line(
    normal: Array, offset: Array, index: NDArray[np.intp], max_speed: Array, goal: Array, linear: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Optimum on the boundary line of constraint `index` under the constraints before it and the disc."""
    row = np.arange(len(index))
    n, h = normal[row, index], offset[row, index]  # (m, 2), (m,)
    along = perpendicular(n)
    reach = np.sqrt(np.maximum(max_speed**2 - h**2, 0.0))
    # On the line x = h n + t along, constraint j reads slope t >= bound.
    slope = dot(normal, along[:, None])  # (m, K)
    bound = offset - h[:, None] * dot(normal, n[:, None])
    earlier = np.arange(offset.shape[1]) < index[:, None]
    crossing = np.abs(slope) > PARALLEL
    t = bound / np.where(crossing, slope, 1.0)
    low = np.maximum(-reach, np.where(earlier & (slope > PARALLEL), t, -np.inf).max(axis=1))
    high = np.minimum(reach, np.where(earlier & (slope < -PARALLEL), t, np.inf).min(axis=1))
    blocked = earlier & ~crossing & (bound > TOLERANCE)
    solved = (h <= max_speed) & (low <= high) & ~blocked.any(axis=1)
    best = dot(along, goal)
    if linear:
        best = np.copysign(np.inf, best)
    best = np.minimum(np.maximum(best, low), high)
    return h[:, None] * n + best[:, None] * along, solved
