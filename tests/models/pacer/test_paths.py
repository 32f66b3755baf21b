"""Procedural paths: bounds, statistics, and look-ups against numpy's own interpolation."""

import numpy as np
import pytest

from footfall.models.pacer.paths import Paths, PathSettings, sample_paths


def test_paths_keep_to_the_bounds_of_speed_acceleration_and_turning():
    rng = np.random.default_rng(0)
    count = 300
    starts, headings = rng.normal(size=(count, 2)), rng.uniform(-np.pi, np.pi, count)
    paths = sample_paths(starts, headings, rng)
    assert paths.vertices.shape == (count, 101, 2)
    np.testing.assert_array_equal(paths.vertices[:, 0], starts)
    steps = np.diff(paths.vertices, axis=1) / 0.1
    speed = np.linalg.norm(steps, axis=-1)
    assert speed.max() <= 3.0 + 1e-9
    assert np.abs(np.diff(speed, axis=1)).max() <= 0.2 + 1e-9
    assert 1.3 < speed.mean() < 1.7
    first = np.arctan2(steps[:, 0, 1], steps[:, 0, 0])
    np.testing.assert_allclose(np.cos(first - headings), 1.0, atol=1e-9)
    moving = (speed[:, 1:] > 1e-3) & (speed[:, :-1] > 1e-3)
    cosine = (steps[:, 1:] * steps[:, :-1]).sum(-1)[moving] / (speed[:, 1:] * speed[:, :-1])[moving]
    sharp = np.arccos(np.clip(cosine, -1, 1)) > 0.2 + 1e-6
    expected = 0.02 * (1 - 0.2 / np.pi)
    assert sharp.mean() == pytest.approx(expected, abs=4 * np.sqrt(expected / sharp.size))


def test_look_ups_interpolate_and_stay_at_the_end():
    rng = np.random.default_rng(1)
    paths = sample_paths(np.zeros((3, 2)), np.zeros(3), rng, speeds=[1.0, 2.0, 0.5])
    times = rng.uniform(-1, 12, (3, 7))
    knots = np.linspace(0, 10, 101)
    for n in range(3):
        for axis in range(2):
            expected = np.interp(times[n], knots, paths.vertices[n, :, axis])
            np.testing.assert_allclose(paths.at(times)[n, :, axis], expected, atol=1e-12)
    assert np.linalg.norm(paths.vertices[1, 1]) == pytest.approx(0.2)


def test_waypoints_are_half_a_second_apart():
    straight = np.stack([np.linspace(0, 20, 101), np.zeros(101)], -1)[None]
    paths = Paths(straight, 10.0)
    waypoints = paths.waypoints([1.0])
    assert waypoints.shape == (1, 10, 2)
    np.testing.assert_allclose(waypoints[0, :, 0], 2.0 + np.arange(1, 11), atol=1e-12)
    paths.replace(np.array([0]), Paths(straight + 5.0, 10.0))
    np.testing.assert_allclose(paths.at([0.0]), [[5.0, 5.0]])


def test_other_settings_are_kept():
    settings = PathSettings(duration=4.0, vertices=41, sharp_turn=0.0, turn_rate=0.0, speed_range=(1.0, 1.5))
    paths = sample_paths(np.zeros((50, 2)), np.zeros(50), np.random.default_rng(2), settings)
    assert np.abs(paths.vertices[..., 1]).max() == 0.0
    assert 4.0 <= paths.vertices[:, -1, 0].min() <= paths.vertices[:, -1, 0].max() <= 6.0
