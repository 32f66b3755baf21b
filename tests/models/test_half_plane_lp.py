"""Half-plane programs against exhaustive enumeration and scipy's linear-program solver."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog

from footfall.models.crowd.half_plane_lp import closest_point, farthest_point, least_violation


def random_programs(seed: int, problems: int, constraints: int, low: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, (problems, constraints))
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1), rng.uniform(low, 1.0, (problems, constraints))


def candidates(normal: np.ndarray, offset: np.ndarray, speed: float, target: np.ndarray) -> np.ndarray:
    """Every point that can be the nearest feasible one: projections, crossings of lines, lines and circle."""
    found = [target, target * min(1.0, speed / np.hypot(*target))]
    for n, h in zip(normal, offset, strict=True):
        found.append(target + (h - n @ target) * n)
        if abs(h) < speed:
            half = np.sqrt(speed**2 - h**2) * np.array([-n[1], n[0]])
            found += [h * n + half, h * n - half]
    for i, j in combinations(range(len(offset)), 2):
        pair = normal[[i, j]]
        if abs(np.linalg.det(pair)) > 1e-9:
            found.append(np.linalg.solve(pair, offset[[i, j]]))
    found = np.array(found)
    obeys = (found @ normal.T >= offset - 1e-7).all(axis=1)
    return found[obeys & (np.linalg.norm(found, axis=1) <= speed + 1e-7)]


@pytest.mark.parametrize("low", [-2.0, -1.0, -0.5])
def test_closest_point_is_the_best_of_all_candidates(low: float):
    normal, offset = random_programs(0, 300, 7, low)
    speed, target = np.full(300, 1.5), np.random.default_rng(1).normal(0, 1.5, (300, 2))
    found, failed = closest_point(normal, offset, speed, target)
    solvable = 0
    for k in range(300):
        points = candidates(normal[k], offset[k], 1.5, target[k])
        assert (failed[k] == 7) == (len(points) > 0)
        if len(points):
            solvable += 1
            best = np.linalg.norm(points - target[k], axis=1).min()
            assert np.linalg.norm(found[k] - target[k]) == pytest.approx(best, abs=1e-6)
            assert (normal[k] @ found[k] >= offset[k] - 1e-8).all()
    assert 10 < solvable < 300


def test_farthest_point_agrees_with_linprog():
    normal, offset = random_programs(2, 100, 6, -2.0)
    offset = np.minimum(offset, 0.0)  # zero stays feasible
    angle = np.random.default_rng(3).uniform(0, 2 * np.pi, 100)
    along = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    found, failed = farthest_point(normal, offset, np.full(100, 2.0), along)
    assert (failed == 6).all()
    for k in range(100):
        rows, limits = around_disc(normal[k], offset[k], 2.0)
        best = linprog(-along[k], A_ub=rows, b_ub=limits, bounds=[(None, None)] * 2)
        assert along[k] @ found[k] == pytest.approx(-best.fun, abs=1e-3)


def test_least_violation_agrees_with_linprog():
    hard, soft = 2, 8
    normal, offset = random_programs(4, 400, hard + soft, -0.5)
    offset[:, :hard] = np.minimum(offset[:, :hard], 0.0)
    speed, target = np.full(400, 1.5), np.random.default_rng(5).normal(0, 1.0, (400, 2))
    start, failed = closest_point(normal, offset, speed, target)
    rows = np.flatnonzero(failed < hard + soft)
    assert len(rows) > 100 and (failed[rows] >= hard).all()
    found = least_violation(normal[rows], offset[rows], hard, speed[rows], start[rows], failed[rows])
    for x, k in zip(found, rows, strict=True):
        assert (normal[k, :hard] @ x >= offset[k, :hard] - 1e-7).all() and np.hypot(*x) < 1.5 + 1e-9
        matrix, limits = around_disc(normal[k], offset[k], 1.5)
        slack = np.zeros((len(matrix), 1))
        slack[hard : hard + soft] = -1.0
        best = linprog([0, 0, 1], A_ub=np.hstack((matrix, slack)), b_ub=limits, bounds=[(None, None)] * 3)
        worst = (offset[k, hard:] - normal[k, hard:] @ x).max()
        assert worst == pytest.approx(best.fun, abs=1e-3)


def around_disc(normal: np.ndarray, offset: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Constraints as `A x <= b`, with the disc as a polygon of 360 sides."""
    angle = np.arange(360) * np.pi / 180
    sides = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.vstack((-normal, sides)), np.concatenate((-offset, np.full(360, speed)))


def test_padding_never_binds_and_no_constraints_clip_to_the_disc():
    target = np.array([[3.0, 4.0]])
    none, failed = closest_point(np.zeros((1, 0, 2)), np.zeros((1, 0)), np.array([1.0]), target)
    padded, unmet = closest_point(np.zeros((1, 3, 2)), -np.ones((1, 3)), np.array([1.0]), target)
    np.testing.assert_allclose(none, [[0.6, 0.8]])
    np.testing.assert_allclose(padded, [[0.6, 0.8]])
    assert failed[0] == 0 and unmet[0] == 3
