"""Leg inverse kinematics against forward kinematics."""

import itertools

import numpy as np
import pytest

from footfall.models.body import (
    BODY_INDEX,
    JOINT_LIMITS,
    N_JOINTS,
    describe,
    forward_kinematics,
    sample_shapes,
)
from footfall.models.gait.leg_ik import Legs, angle_within

LEFT = [BODY_INDEX[name] for name in ("L_Hip", "L_Knee", "L_Ankle")]
RIGHT = [BODY_INDEX[name] for name in ("R_Hip", "R_Knee", "R_Ankle")]


@pytest.fixture(scope="module", params=range(3))
def body(request):
    return describe(sample_shapes(3, seed=11)[request.param])


def pose(body, chain, legs):
    """Positions and rotations with leg angles (n, 3, 3) and the pelvis at the origin."""
    joints = np.zeros((len(legs), N_JOINTS // 3, 3))
    for k, index in enumerate(chain):
        joints[:, index - 1] = legs[:, k]
    root = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(legs), 1))
    return forward_kinematics(body.offsets, root, joints.reshape(len(legs), -1))


def grid():
    hip = itertools.product((-0.3, 0.0, 0.4), (-2.0, -1.4, -0.6, 0.0, 0.4), (-0.5, 0.0, 0.5))
    knee = (0.02, 0.3, 1.0, 2.2)
    ankle = ((0.0, 0.0, 0.0), (0.2, -0.4, 0.1), (-0.3, 0.7, -0.2))
    rows = [[h, (0.0, k, 0.0), a] for h, k, a in itertools.product(hip, knee, ankle)]
    return np.array(rows)


@pytest.mark.parametrize("chain", [LEFT, RIGHT], ids=["left", "right"])
def test_angles_come_back_from_the_pose_they_make(body, chain):
    legs = grid()
    where, turned = pose(body, chain, legs)
    hip, knee, ankle = chain
    solver = Legs(body.offsets[knee], body.offsets[ankle])
    solved = solver.solve(where[:, ankle] - where[:, hip], turned[:, hip, :, 1], turned[:, ankle])
    np.testing.assert_allclose(solved, legs, atol=2e-6)


def test_bent_segments_are_solved_too():
    """Segments that are not straight along z, as a scanned skeleton has them."""
    rng = np.random.default_rng(2)
    thigh, shank = np.array([-0.01, 0.04, -0.38]), np.array([-0.04, -0.02, -0.40])
    solver = Legs(thigh, shank)
    target = rng.uniform([-0.3, -0.2, -0.75], [0.4, 0.3, -0.3], (200, 3))
    target *= np.minimum(1.0, 0.99 * solver.reach() / np.linalg.norm(target, axis=1))[:, None]
    angles = solver.solve(target, np.array([0.0, 1.0, 0.0]), np.broadcast_to(np.eye(3), (200, 3, 3)))

    def turn(axis, a):
        c, s, o, z = np.cos(a), np.sin(a), np.ones_like(a), np.zeros_like(a)
        rows = {
            0: [[o, z, z], [z, c, -s], [z, s, c]],
            1: [[c, z, s], [z, o, z], [-s, z, c]],
            2: [[c, -s, z], [s, c, z], [z, z, o]],
        }[axis]
        return np.moveaxis(np.array(rows), -1, 0)

    rotation, point = np.eye(3), np.zeros(3)
    for joint, offset in enumerate((thigh, shank)):
        for axis in range(3):
            rotation = rotation @ turn(axis, angles[:, joint, axis])
        point = point + rotation @ offset
    np.testing.assert_allclose(point, target, atol=1e-9)


def test_a_target_out_of_reach_is_pointed_at_with_a_straight_leg(body):
    hip, knee, ankle = LEFT
    solver = Legs(body.offsets[knee], body.offsets[ankle])
    direction = np.array([0.6, 0.0, -0.8])
    angles = solver.solve(2.0 * direction, np.array([0.0, 1.0, 0.0]), np.eye(3))
    where, _ = pose(body, LEFT, angles[None])
    leg = where[0, ankle] - where[0, hip]
    np.testing.assert_allclose(leg, solver.reach() * direction, atol=1e-6)


def test_reach_is_the_distance_at_that_knee_angle(body):
    solver = Legs(body.offsets[LEFT[1]], body.offsets[LEFT[2]])
    knee = np.linspace(0.0, 2.5, 9)
    np.testing.assert_allclose(solver.knee_angle(solver.reach(knee)), knee, atol=1e-6)
    a, b = body.thigh, body.shank  # law of cosines
    np.testing.assert_allclose(solver.reach(knee) ** 2, a * a + b * b + 2 * a * b * np.cos(knee), atol=1e-12)


def test_angle_within_is_the_first_crossing():
    rng = np.random.default_rng(3)
    cosine, sine, bound = rng.normal(size=(3, 500))
    found = angle_within(cosine, sine, bound)
    sweep = np.linspace(0.0, 2.0 * np.pi, 20001)
    value = cosine[:, None] * np.cos(sweep) + sine[:, None] * np.sin(sweep)
    within = value <= bound[:, None]
    reachable = within.any(1)
    np.testing.assert_allclose(found[reachable], sweep[within.argmax(1)][reachable], atol=4e-4)
    lowest = sweep[value.argmin(1)]
    np.testing.assert_allclose(found[~reachable], lowest[~reachable], atol=4e-4)


def test_a_thigh_above_the_horizontal_keeps_small_side_angles(body):
    hip, knee, ankle = LEFT
    legs = np.array([[(0.05, -1.9, 0.1), (0.0, 1.5, 0.0), (0.0, 0.0, 0.0)]])
    where, turned = pose(body, LEFT, legs)
    solver = Legs(body.offsets[knee], body.offsets[ankle])
    solved = solver.solve(where[:, ankle] - where[:, hip], turned[:, hip, :, 1], turned[:, ankle])
    low, high = JOINT_LIMITS[3 * (hip - 1) : 3 * hip].T
    assert ((solved[0, 0] >= low) & (solved[0, 0] <= high)).all()
