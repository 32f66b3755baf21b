"""Courses against their slopes and steps; maps of the surroundings against what stands there."""

import numpy as np
import pytest

from footfall.models.pacer.courses import SHARES, CourseError, CourseSettings, make_course, make_tile
from footfall.models.pacer.local_map import PERSON, MapSettings, draw_local_maps

TILES = CourseSettings(levels=2, columns=6, tile=10.0, border=2.0)


@pytest.mark.parametrize("difficulty", [0.2, 1.0])
def test_tiles_have_the_steepness_and_steps_of_their_difficulty(difficulty):
    rng = np.random.default_rng(0)
    slope = make_tile("slope", difficulty, TILES, rng)
    assert np.abs(np.diff(slope, axis=0)).max() / TILES.cell == pytest.approx(0.7 * difficulty)
    assert np.abs(slope[0]).max() < 0.7 * difficulty * TILES.cell
    for kind, sign in (("stairs_up", 1.0), ("stairs_down", -1.0)):
        stairs = make_tile(kind, difficulty, TILES, rng)
        jumps = np.diff(stairs, axis=0)
        assert np.abs(jumps[jumps != 0]) == pytest.approx(0.05 + 0.175 * difficulty)
        assert sign * stairs[50, 50] == stairs.max() * (sign > 0) - stairs.min() * (sign < 0) > 0
    blocks = make_tile("discrete", difficulty, TILES, rng)
    assert np.abs(blocks).max() == pytest.approx(0.025 + 0.15 * difficulty)
    assert not blocks[48:52, 48:52].any()
    assert not make_tile("flat", difficulty, TILES, rng).any()


def test_a_course_is_harder_row_by_row_and_flat_around():
    course = make_course(TILES, seed=3)
    assert set(course.kinds[0]) <= set(SHARES) and "slope" in course.kinds[0]
    terrain = course.terrain
    centres = course.centres()
    tops = np.abs(terrain.height_at(centres.reshape(-1, 2))).reshape(centres.shape[:2])
    column = course.kinds[0].index("slope")
    np.testing.assert_allclose(tops[:, column], 0.7 * np.array([0.0, 0.5]) * 3.5, rtol=0.02)
    assert terrain.height_at(np.array([[-1.5, 5.0], [61.5, 5.0], [30.0, 21.5]])) == pytest.approx(np.zeros(3))


def test_bad_courses_are_refused():
    with pytest.raises(CourseError, match="lava"):
        make_tile("lava", 0.5, TILES, np.random.default_rng(0))
    with pytest.raises(CourseError, match="at least one"):
        make_course(CourseSettings(levels=0))


def ramp(xy):
    return 0.2 * xy[:, 0]


def test_a_map_shows_the_ground_in_the_heading_frame():
    settings = MapSettings(cells=8, side=2.0)
    ways = np.array([[1.0, 0.0], [0.0, 1.0]])
    velocity = np.array([[1.0, 0.5], [1.0, 0.5]])
    apart = np.array([[3.0, 1.0], [30.0, 1.0]])
    maps = draw_local_maps(apart, ways, velocity, ramp, settings)
    points = settings.points()
    np.testing.assert_allclose(maps[0, ..., 0], -0.2 * points[..., 0], atol=1e-6)
    np.testing.assert_allclose(maps[1, ..., 0], 0.2 * points[..., 1], atol=1e-6)  # heading +y: left is -x
    np.testing.assert_allclose(maps[0, ..., 1:], np.broadcast_to([-1.0, -0.5], (8, 8, 2)), atol=1e-6)
    np.testing.assert_allclose(maps[1, ..., 1:], np.broadcast_to([-0.5, 1.0], (8, 8, 2)), atol=1e-6)


def test_people_are_moving_boxes_on_the_maps_of_their_group():
    settings = MapSettings()
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.2]])
    ways = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    velocity = np.array([[0.5, 0.0], [0.0, 1.0], [0.5, 0.0]])
    flat = draw_local_maps(positions, ways, velocity, lambda xy: np.zeros(len(xy)), settings)
    points = settings.points()
    one = (np.abs(points[..., 0] - 1.0) < 0.5 * PERSON[1]) & (np.abs(points[..., 1]) < 0.5 * PERSON[0])
    two = (np.abs(points[..., 0]) < 0.5 * PERSON[0]) & (np.abs(points[..., 1] + 1.2) < 0.5 * PERSON[1])
    np.testing.assert_allclose(flat[0, ..., 0], np.where(one | two, -1.7, 0.0), atol=1e-6)
    np.testing.assert_allclose(flat[0][one][:, 1:], np.tile([-0.5, 1.0], (one.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(flat[0][two][:, 1:], 0.0, atol=1e-6)
    groups = draw_local_maps(
        positions, ways, velocity, lambda xy: np.zeros(len(xy)), settings, np.array([0, 1, 0])
    )
    np.testing.assert_allclose(groups[0, ..., 0], np.where(two, -1.7, 0.0), atol=1e-6)
