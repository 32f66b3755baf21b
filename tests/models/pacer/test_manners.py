"""Manners: followers keep clear of obstacles and each other, and tell people so."""

import numpy as np
import pytest

from footfall.models.gait import flat_ground
from footfall.models.pacer.courses import SHARES, CourseSettings, make_course, scatter_obstacles
from footfall.models.pacer.manners import Manners
from footfall.models.pacer.path_follower import FollowerLimits, PathFollower
from footfall.models.pacer.surface import seen_heights
from footfall.models.scene import Obstacle
from footfall.models.scene.layers import signed_distance

BOX = Obstacle("box", np.array([[2.0, -0.5], [3.0, -0.5], [3.0, 0.5], [2.0, 0.5]]), 2.0)


def follow(follower, velocities, seconds):
    """Walk after points that move straight on; returns where the followers were (T, N, 2)."""
    starts, places = follower.position.copy(), []
    for k in range(round(30 * seconds)):
        aims = starts + velocities * (k / 30 + follower.limits.preview)
        follower.advance(aims, follower.position, 1 / 30)
        places.append(follower.position.copy())
    return np.array(places)


def test_two_who_meet_give_way():
    follower = PathFollower(2, FollowerLimits(), Manners(1))
    follower.radius[:] = 0.25
    ways = np.array([[1.3, 0.0], [-1.3, 0.0]])
    follower.place(
        np.arange(2), np.array([[-3.0, 0.0], [3.0, 0.05]]), np.array([0.0, np.pi]), np.full(2, 1.3)
    )
    places = follow(follower, ways, 5.0)
    apart = np.linalg.norm(places[:, 0] - places[:, 1], axis=1)
    assert apart.min() > 0.7
    assert places[-1, 0, 0] > 2.5 and places[-1, 1, 0] < -2.5


def test_people_of_other_scenes_do_not_count():
    ways, start = np.array([[1.3, 0.0], [-1.3, 0.0]]), np.array([[-3.0, 0.0], [3.0, 0.0]])
    walks = []
    for manners in (Manners(2), None):
        follower = PathFollower(2, FollowerLimits(), manners)
        follower.place(np.arange(2), start, np.array([0.0, np.pi]), np.full(2, 1.3))
        walks.append(follow(follower, ways, 3.0))
    np.testing.assert_allclose(*walks, atol=1e-9)


def test_a_path_through_an_obstacle_is_walked_round_it():
    follower = PathFollower(1, FollowerLimits(), Manners(1, [BOX]))
    follower.radius[:] = 0.25
    follower.place(np.arange(1), np.array([[0.0, 0.1]]), np.zeros(1), np.full(1, 1.2))
    places = follow(follower, np.array([[1.2, 0.0]]), 8.0)[:, 0]
    assert signed_distance([BOX.polygon], places).min() > 0.3
    assert places[-1, 0] > 4.0


def test_who_is_not_held_up_is_told_the_path_as_it_is():
    follower = PathFollower(1)
    follower.place(np.arange(1), np.zeros((1, 2)), np.zeros(1), np.ones(1))
    now, ahead = np.array([[0.1, 0.0]]), np.array([[[0.6, 0.0], [1.1, 0.2]]])
    np.testing.assert_allclose(follower.near(now), now)
    np.testing.assert_allclose(follower.told(now, ahead), ahead)


def test_who_is_held_up_is_told_a_slower_way_from_near_the_follower():
    follower = PathFollower(1, FollowerLimits(pull=0.2))
    follower.place(np.arange(1), np.zeros((1, 2)), np.zeros(1), np.ones(1))
    follower.bend[:] = 0.5j  # a quarter turn to the left at half the speed
    now, ahead = np.array([[1.0, 0.0]]), np.array([[[2.0, 0.0]]])
    np.testing.assert_allclose(follower.near(now), [[0.2, 0.0]])
    np.testing.assert_allclose(follower.told(now, ahead), [[[0.2, 0.5]]])


def test_obstacles_are_seen_on_the_ground_but_not_stood_on():
    seen = seen_heights(lambda points: 0.1 * points[:, 0], [BOX])
    np.testing.assert_allclose(seen(np.array([[2.5, 0.0]])), [0.25 + 2.0])
    np.testing.assert_allclose(seen(np.array([[1.5, 0.0], [50.0, 0.0], [-9.0, 3.0]])), [0.15, 5.0, -0.9])
    assert seen_heights(flat_ground, []) is flat_ground


@pytest.mark.parametrize("seed", range(3))
def test_scattered_boxes_leave_room_between_them_and_in_the_middle(seed):
    boxes = scatter_obstacles((10.0, -4.0), 12.0, 8, np.random.default_rng(seed))
    assert 3 <= len(boxes) <= 8
    outlines = [box.polygon for box in boxes]
    assert signed_distance(outlines, np.array([[10.0, -4.0]]))[0] > 1.0
    for k, outline in enumerate(outlines):
        assert signed_distance(outlines[:k] + outlines[k + 1 :], outline).min() > 1.1
        assert (np.abs(outline - [10.0, -4.0]) <= 6.0).all()


def test_a_course_has_its_kinds_of_ground_and_nothing_else():
    course = make_course(CourseSettings(levels=2, columns=4, tile=10.0, kinds=("flat", "obstacles")))
    assert not course.uneven
    assert set(course.kinds[0]) == {"flat", "obstacles"}
    places = np.array([box.polygon.mean(0) for box in course.obstacles])
    assert set(course.kinds_at(places)) == {"obstacles"}
    assert course.kinds_at(np.array([[-1.0, 5.0]])) == ["border"]
    assert set(SHARES) == set(CourseSettings().kinds)
