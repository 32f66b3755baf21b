import numpy as np
import pytest
from scipy.stats import wasserstein_distance

from footfall.models.trace import metrics

SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def line(start, velocity, steps=51, dt=0.1):
    return np.asarray(start) + np.asarray(velocity) * dt * np.arange(steps)[:, None]


def test_histogram_distance_equals_scipy():
    rng = np.random.default_rng(0)
    bounds = (-1.0, 1.0)
    edges = np.linspace(*bounds, metrics.BINS + 1)
    centres = (edges[1:] + edges[:-1]) / 2
    for _ in range(5):
        a, b = rng.normal(0, 0.3, 500), rng.normal(0.2, 0.5, 700)
        weights = [np.histogram(np.clip(v, *bounds), edges)[0] / len(v) for v in (a, b)]
        expected = wasserstein_distance(centres, centres, *weights)
        assert metrics.histogram_distance(a, b, bounds) == pytest.approx(expected, abs=1e-9)


def test_histogram_distance_of_a_shift_is_the_shift():
    values = np.random.default_rng(0).uniform(0.2, 0.8, 10000)
    assert metrics.histogram_distance(values, values + 0.5, (0, 2)) == pytest.approx(0.5, abs=0.01)
    assert metrics.histogram_distance(values, values, (0, 2)) == 0


def test_obstacle_collisions_count_time_in_the_inflated_square():
    path = line([-2, 0.5], [1, 0], steps=41)[None]  # from x = -2 to 2, 0.1 m a step
    share = metrics.obstacle_collisions(path + 1e-4, 0.4, [SQUARE])
    assert share[0] == pytest.approx(18 / 41, abs=1.5 / 41)  # between x = -0.4 and 1.4
    assert metrics.obstacle_collisions(path, 0.4, [])[0] == 0
    assert metrics.obstacle_collisions(path + np.array([0, 1.0]), 0.4, [SQUARE])[0] == 0


def test_agent_collisions_name_those_involved():
    paths = np.stack([line([0, 0], [1, 0]), line([5, 0], [-1, 0]), line([0, 3], [1, 0])])
    assert metrics.agent_collisions(paths, 0.4).tolist() == [True, True, False]
    assert metrics.agent_collisions(paths[[0, 2]], 0.4).tolist() == [False, False]


def test_displacement_errors_of_a_constant_offset():
    truth = line([0, 0], [1, 0])[None]
    samples = np.stack([truth[0] + [0, 0.3], truth[0]])[None]
    ade, fde = metrics.displacement_errors(samples, truth)
    assert np.allclose(ade, [[0.3, 0]]) and np.allclose(fde, [[0.3, 0]])


def test_waypoint_error_is_the_distance_to_the_line():
    paths = line([0, 0], [1, 0])[None]
    assert metrics.waypoint_error(paths, np.array([[2.0, 0.7]]))[0] == pytest.approx(0.7)
    assert metrics.waypoint_error(paths, np.array([[8.0, 4.0]]))[0] == pytest.approx(5.0)


def test_social_distance_error():
    paths = np.stack([line([0, 0], [1, 0]), line([0, 1], [1, 0]), line([0, 4], [1, 0]), line([0, 9], [1, 0])])
    error = metrics.social_distance_error(paths, np.array([3, 3, 3, -1]), 1.5)
    assert np.allclose(error, [0.5, 0.5, 1.5])


def test_motion_of_a_circle_is_all_lateral():
    t = np.arange(0, 5.1, 0.1)
    radius, speed = 4.0, 1.2
    circle = radius * np.stack([np.cos(speed / radius * t), np.sin(speed / radius * t)], 1)
    motion = metrics.motion(circle, 0.1)
    assert np.allclose(motion.speed, speed, atol=0.01)
    assert np.allclose(motion.lateral, speed**2 / radius, atol=0.02)
    assert np.allclose(motion.longitudinal, 0, atol=0.05)
    rightwards = metrics.motion(circle * [1, -1], 0.1)
    assert np.allclose(rightwards.lateral, -motion.lateral)


def test_motion_of_an_acceleration_is_all_longitudinal():
    t = np.arange(0, 5.1, 0.1)[:, None]
    direction = np.array([0.6, 0.8])
    path = (0.5 * t + 0.5 * 0.3 * t**2) * direction
    motion = metrics.motion(path, 0.1)
    assert np.allclose(motion.longitudinal, 0.3) and np.allclose(motion.lateral, 0, atol=1e-9)
    compatible = metrics.motion(path, 0.1, compatible=True)
    assert np.allclose(compatible.longitudinal, 0.3 * 0.6) and np.allclose(compatible.lateral, 0.3 * 0.8)
    assert metrics.mean_accelerations(path, 0.1) == pytest.approx((0.3, 0.0), abs=1e-9)


def test_realism_is_zero_for_the_truth_itself():
    paths = np.cumsum(np.random.default_rng(0).normal(0, 0.1, (20, 51, 2)), 1)
    assert set(metrics.realism(paths, paths, 0.1).values()) == {0.0}
    assert metrics.realism(2 * paths, paths, 0.1)["speed"] > 0.05
