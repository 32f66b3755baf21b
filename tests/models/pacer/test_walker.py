"""The walker's parts against kinematics, MuJoCo, mirror images and sums written out."""

from dataclasses import replace

import numpy as np
import pytest

from footfall.models.body import (
    BODY_INDEX,
    JOINT_INDEX,
    N_BODIES,
    describe,
    forward_kinematics,
    sample_shapes,
)
from footfall.models.body.anthropometry import shape_for
from footfall.models.motion.clip import MIRROR_BODIES, MIRROR_JOINTS, MIRROR_SIGNS
from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.courses import CourseSettings
from footfall.models.pacer.gait_reference import GaitReference
from footfall.models.pacer.hinges import hinges_from_states
from footfall.models.pacer.path_follower import FollowerLimits, PathFollower
from footfall.models.pacer.paths import Paths, PathSettings, sample_paths, with_stops
from footfall.models.pacer.swing_dynamics import HINGES
from footfall.models.pacer.walker_config import CONFIGS
from footfall.models.pacer.walker_env import WalkerEnv
from footfall.models.pacer.walker_observation import Mirror, Motion, People, clearance, observe
from footfall.models.pacer.walker_rewards import slip_speed

SMALL = replace(
    CONFIGS["compact"],
    company=1,
    course=None,
    worlds=6,
    people=3,
    physics=Physics(threads=1),
    push_interval=0.0,
)


def straight(count, speed, duration=16.0):
    vertices = np.zeros((count, 161, 2))
    vertices[..., 0] = speed * np.linspace(0.0, duration, 161)
    return Paths(vertices, duration)


def test_hinges_are_those_that_made_the_pose():
    rng = np.random.default_rng(0)
    body = describe(sample_shapes(1, 0)[0])
    joints, rates = rng.uniform(-1.2, 1.2, (5, 69)), rng.normal(0.0, 2.0, (5, 69))
    root = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (5, 1))
    step = 1e-6
    _, before = forward_kinematics(body.offsets, root, joints)
    _, after = forward_kinematics(body.offsets, root, joints + step * rates)
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(before.reshape(-1, 3, 3))
    spin = (Rotation.from_matrix(after.reshape(-1, 3, 3)) * turned.inv()).as_rotvec() / step
    states = np.zeros((5, N_BODIES, 13))
    states[..., 3:7] = turned.as_quat(scalar_first=True).reshape(5, N_BODIES, 4)
    states[..., 10:] = spin.reshape(5, N_BODIES, 3)
    angles, speeds = hinges_from_states(states)
    np.testing.assert_allclose(angles, joints, atol=1e-9)
    np.testing.assert_allclose(speeds, rates, atol=1e-3)


def test_a_follower_stays_on_a_straight_path_and_near_a_winding_one():
    follower = PathFollower(1)
    follower.place(np.array([0]), np.zeros((1, 2)), np.zeros(1), np.array([1.3]))
    path = straight(1, 1.3)
    for k in range(200):
        follower.advance(path.at(np.array([k / 30 + 0.5])), follower.position, 1 / 30)
    np.testing.assert_allclose(follower.position, path.at(np.array([200 / 30])), atol=1e-9)

    rng = np.random.default_rng(0)
    paths = sample_paths(np.zeros((200, 2)), np.zeros(200), rng, PathSettings(speed_range=(0.0, 2.0)))
    follower = PathFollower(200)
    speed = np.linalg.norm(paths.vertices[:, 1] - paths.vertices[:, 0], axis=1) / paths.spacing
    follower.place(np.arange(200), np.zeros((200, 2)), np.zeros(200), speed)
    errors, before = [], follower.velocity
    for k in range(300):
        follower.advance(paths.at(np.full(200, k / 30 + 0.5)), follower.position, 1 / 30)
        errors.append(np.linalg.norm(follower.position - paths.at(np.full(200, (k + 1) / 30)), axis=1))
        gained = np.linalg.norm(follower.velocity - before, axis=1)
        assert gained.max() <= FollowerLimits().acceleration / 30 + 1e-9
        before = follower.velocity
    assert np.mean(errors) < 0.06


def test_a_follower_takes_care_on_slopes():
    turned, gained = [], []
    for rise in (0.0, 0.4, 5.0):  # a step beside a drop counts like one to one
        follower = PathFollower(1)
        follower.height_at = lambda points, rise=rise: rise * points[:, 1]
        follower.place(np.array([0]), np.zeros((1, 2)), np.zeros(1), np.ones(1))
        follower.advance(np.array([[-1.0, 0.1]]), follower.position, 1 / 30)
        gained.append(np.linalg.norm(follower.velocity - [[1.0, 0.0]]))
        for _ in range(20):
            follower.advance(follower.position + np.array([[-1.0, 0.1]]), follower.position, 1 / 30)
            turned.append(follower.turn_rate[0])
    fastest = np.reshape(turned, (3, 20)).max(1)
    shares = np.exp(-1.5 * np.array([0.0, 0.4, 1.0]))
    np.testing.assert_allclose(np.array(gained) * 30, FollowerLimits().acceleration * shares)
    np.testing.assert_allclose(fastest, FollowerLimits().turn_rate * shares, rtol=0.02)


def test_a_follower_waits_for_the_person():
    follower = PathFollower(1)
    held = np.zeros((1, 2))
    for k in range(300):
        follower.advance(straight(1, 1.0).at(np.array([k / 30 + 0.5])), held, 1 / 30)
    assert np.linalg.norm(follower.position) < 1.3  # without the leash it would be 10 m away


def test_stops_stand_still_and_keep_to_the_way():
    rng = np.random.default_rng(3)
    paths = sample_paths(np.zeros((4, 2)), np.zeros(4), rng, PathSettings(speed_range=(1.0, 1.5)))
    stopped = with_stops(paths, [2.0, 2.0, -10.0, 1e3], [5.0, np.inf, 3.0, 1e3])
    times = np.array([3.0, 4.0, 4.9])
    rows = stopped.at(np.tile(times, (4, 1)))
    assert np.ptp(rows[:2], axis=1).max() < 1e-9
    np.testing.assert_allclose(stopped.at(np.full(4, 9.9))[1], rows[1, 0])
    np.testing.assert_allclose(stopped.at(np.full(4, 2.9))[2], paths.vertices[2, 0])
    np.testing.assert_allclose(stopped.vertices[3], paths.vertices[3])


def mirrored_motion(motion, hinges):
    flip = np.array([1.0, -1.0, 1.0])
    turn = np.array([1.0, -1.0, 1.0, -1.0])
    place = np.full(69, -1)
    place[hinges] = np.arange(len(hinges))
    other = place[MIRROR_JOINTS[hinges]]
    return Motion(
        motion.positions[:, MIRROR_BODIES] * flip,
        motion.quaternions[:, MIRROR_BODIES] * turn,
        motion.velocity * flip,
        motion.spin * -flip,
        motion.joints[:, other] * MIRROR_SIGNS[hinges],
        motion.rates[:, other] * MIRROR_SIGNS[hinges],
    )


def test_who_does_not_know_their_body_walks_as_the_average_would():
    tall, average = describe(shape_for(1.95, 95.0)), describe(np.zeros(10))
    aware, unaware, other = (
        GaitReference([body], 1 / 30, body_aware=known)
        for body, known in ((tall, True), (tall, False), (average, True))
    )
    one, zero = np.array([0]), np.zeros(1)
    begun = [gait.place(one, np.zeros((1, 2)), zero, zero, zero)[0] for gait in (aware, unaware, other)]
    np.testing.assert_array_equal(begun[0], begun[1])  # bodies begin as they are
    for _ in range(30):
        for gait in (aware, unaware, other):
            people = gait.root[:, :2].copy()
            gait.advance(np.zeros((1, 2)), people, np.zeros((1, 2, 3)), np.ones((1, 2), bool))
    height = [float(gait.root[0, 2]) for gait in (aware, unaware, other)]
    assert height[0] - height[2] > 0.08 and abs(height[1] - height[2]) < 0.01


def test_the_mirror_is_that_of_a_person_who_walks_mirrored():
    """Left foot leads along a path; right foot leads along the mirrored path: the same but for the mirror."""
    body = describe(np.zeros(10))
    left, right = (GaitReference([body], 1 / 30) for _ in range(2))
    one = np.array([0])
    heading, speed = np.array([0.4]), np.array([1.2])
    for gait, sign, phase in ((left, 1.0, 0.1), (right, -1.0, 0.6)):
        gait.place(one, np.array([[0.5, 0.2 * sign]]), heading * sign, speed, np.array([phase]))
    hinges = np.arange(69)
    rng = np.random.default_rng(0)
    joints = rng.normal(0.0, 0.2, (1, 69))
    positions, _ = forward_kinematics(body.offsets, left.root, joints)
    quaternions = rng.normal(size=(1, N_BODIES, 4))
    quaternions[:, 0] = left.root[:, 3:]
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    motion = Motion(
        positions,
        quaternions,
        rng.normal(size=(1, 3)),
        rng.normal(size=(1, 3)),
        joints,
        rng.normal(size=(1, 69)),
    )
    waypoints = rng.normal(size=(1, 10, 2))
    people = People.of([body])
    seen = []
    maps = rng.normal(size=(1, 4, 4, 3)).astype(np.float32)
    other = maps[:, :, ::-1] * np.array([1.0, 1.0, -1.0], np.float32)
    for m, gait, sign in ((motion, left, 1.0), (mirrored_motion(motion, hinges), right, -1.0)):
        clear = clearance(m.sole_points(people.soles), lambda xy: np.zeros(len(xy)))
        seen.append(observe(m, people, gait, waypoints * [1.0, sign], clear, hinges, True, maps))
        maps = other
    mirror = Mirror(hinges, cells=4)
    np.testing.assert_allclose(
        mirror.observations(seen[1]), seen[0], atol=3e-3
    )  # the gait lowers left before right
    np.testing.assert_allclose(mirror.observations(mirror.observations(seen[0])), seen[0])


def test_body_states_tell_what_the_batch_world_does():
    env = WalkerEnv(SMALL, seed=1)
    for _ in range(5):
        env.step(np.zeros((6, env.n_actions), np.float32))
    world = env.world
    linear, spin = world.velocities()
    states = np.concatenate([world.positions, world.quaternions, linear, spin], -1)
    motion = Motion.of_states(states, world.hinges)
    for name in ("velocity", "spin", "joints", "rates"):
        np.testing.assert_allclose(getattr(motion, name), getattr(env.motion, name), atol=1e-8, err_msg=name)


def test_without_a_policy_the_gait_nearly_walks_and_the_reward_is_bounded():
    env = WalkerEnv(SMALL, seed=0)
    env.difficulty = 0.0
    env.reset()
    rewards = []
    for _ in range(15):
        step = env.step(np.zeros((6, env.n_actions), np.float32))
        rewards.append(step.rewards)
        assert step.rewards.min() >= 0.0 and step.rewards.max() <= 1.0
        assert np.isfinite(step.observations).all()
    assert np.mean(rewards) > 0.6


def test_lying_down_and_straying_end_an_episode():
    env = WalkerEnv(SMALL, seed=0)
    env.paths.vertices[2] += [30.0, 0.0]
    lying = np.array([[0.0, 0.0, 0.2, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]])
    env.world.reset([4], lying, np.zeros((1, 69)), np.zeros((1, 6)), np.zeros((1, 69)))
    step = env.step(np.zeros((6, env.n_actions), np.float32))
    assert step.failed[2] and step.failed[4] and not step.failed[[0, 1, 3, 5]].any()
    assert step.terms["strayed"] == 1.0 and step.terms["fell"] == 1.0
    assert env.age[2] == env.age[4] == 0


def test_a_push_gives_its_impulse():
    """A force for 0.2 s on people in free fall changes their momentum by force times duration."""
    env = WalkerEnv(SMALL, seed=0)
    everyone = np.arange(6)
    root = np.tile([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0], (6, 1))
    env.world.reset(everyone, root, np.zeros((6, 69)), np.zeros((6, 6)), np.zeros((6, 69)))
    env.push(everyone, np.full(6, 150.0), np.full(6, np.pi / 2), 0.2)
    masses = np.array([b.masses for b in env.world.bodies])[env.world.body_index]
    centres = np.array([b.segments.centres for b in env.world.bodies])[env.world.body_index]

    def momentum():
        from footfall.models.pacer.mathops import cross, rotate

        linear, spin = env.world.velocities()
        arms = rotate(env.world.quaternions, centres)
        return np.einsum("nb,nbk->nk", masses, linear + cross(spin, arms))

    before = momentum()
    for _ in range(8):
        env._push()
        env.world.step(np.zeros((6, len(env.world.hinges))))
    gained = momentum() - before
    np.testing.assert_allclose(gained[:, 1], 150.0 * 0.2, rtol=0.02)
    np.testing.assert_allclose(gained[:, 0], 0.0, atol=0.5)
    assert not env.world.forces.any()


def test_slip_is_the_speed_of_points_that_touch():
    points = np.zeros((1, 2, 5, 3))
    moved = points.copy()
    moved[0, 0, :2, 0] = [0.01, 0.03]
    moved[0, 1, :, 0] = 0.5
    clear = np.full((1, 2, 5), 0.05)
    clear[0, 0, :2] = 0.0
    assert slip_speed(moved, points, clear, clear, 0.1) == pytest.approx([0.2])
    assert slip_speed(moved, points, clear + 1.0, clear, 0.1) == pytest.approx([0.0])


def test_every_body_has_its_place_in_the_fall_test():
    assert {"L_Hand", "R_Hand", "L_Knee", "R_Knee", "Head"} <= set(BODY_INDEX)


def test_training_with_style_learns_both_and_resumes_where_it_was():
    import torch

    from footfall.models.motion.library import MotionLibrary
    from footfall.models.motion.walk_cycle import walk_cycle
    from footfall.models.pacer.style import DemoWindows
    from footfall.models.pacer.walker_training import WalkerTraining

    style = replace(SMALL.style, weight=0.5, window=4, hidden=(8,), batch=16, steps=1)
    config = replace(SMALL, style=style, hidden=(16,), horizon=6, minibatch=12, epochs=2, bfloat16=False)

    def fresh():
        env = WalkerEnv(config, seed=0)
        library = MotionLibrary([walk_cycle(env.world.bodies[0], 1.2, 1.0)], env.world.bodies[:1])
        return WalkerTraining(env, config, DemoWindows(library, env.world.hinges, 4))

    training, figures = fresh(), {}
    for _ in range(2):
        figures = training.update()
    assert figures["kl"] > 0 and 0 < figures["style_reward"] <= 1 and figures["disc_loss"] > 0
    assert training.samples == 72
    tensors, facts = training.state()
    other = fresh()
    other.load_state({name: value.clone() for name, value in tensors.items()}, facts)
    again, _ = other.state()
    assert again.keys() == tensors.keys() and other.samples == 72
    for name, value in tensors.items():
        torch.testing.assert_close(again[name], value, msg=name)


def test_a_grown_walker_does_the_same_until_it_learns():
    import torch

    from footfall.models.pacer.policy import ActorCritic
    from footfall.models.pacer.walker_weights import grown

    small, large = ActorCritic(10, 3, (8,), 0.1), ActorCritic(16, 3, (8,), 0.1)
    small.normalizer.observe(torch.randn(50, 10) * 2 + 1)
    large.load_state_dict(grown(small.state_dict(), 16, 6))
    seen = torch.randn(5, 10)
    wide = torch.cat([seen[:, :6], torch.randn(5, 6), seen[:, 6:]], 1)
    torch.testing.assert_close(large.act(wide), small.act(seen))
    torch.testing.assert_close(large.values(large.normalizer(wide)), small.values(small.normalizer(seen)))


def test_on_a_course_people_start_on_their_feet_and_see_the_ground():
    from footfall.models.pacer.courses import CourseSettings
    from footfall.models.pacer.local_map import MapSettings

    course = CourseSettings(levels=2, columns=3, tile=8.0, border=4.0)
    env = WalkerEnv(replace(SMALL, course=course, map=MapSettings(cells=4, side=2.0)), seed=0)
    assert env.size == WalkerEnv(SMALL, seed=0).size + 48
    feet = np.sort(env.clear.min(-1), axis=1)
    assert (feet[:, 0] < 0.05).all() and (feet[:, 0] > -0.05).all()
    ground = env.height_at(env.motion.positions[:, 0, :2])
    assert np.ptp(ground) > 0.1
    step = env.step(np.zeros((6, env.n_actions), np.float32))
    assert not step.failed.any() and np.isfinite(step.observations).all()


def test_most_begin_where_some_fall_and_some_do_not():
    course = CourseSettings(levels=4, columns=2, tile=10.0, kinds=("flat", "slope"))
    env = WalkerEnv(replace(SMALL, course=course), seed=1)
    starts, ids = env.starts, np.arange(len(env))
    begun = lambda: np.unique(np.floor(starts.anywhere(4000) / 10.0), axis=0, return_counts=True)[1]  # noqa: E731
    starts.learning = True
    assert np.ptp(begun()) < 150  # nothing is known yet

    starts._tile[ids] = [1, 0]  # column and level
    for _ in range(300):
        starts.remember(ids, np.zeros(len(env), dtype=bool))
    starts._tile[ids] = [1, 3]
    for _ in range(300):
        starts.remember(ids, np.ones(len(env), dtype=bool))
    assert starts.falls[0, 1] < 0.01 < 0.99 < starts.falls[3, 1]
    assert starts.level == pytest.approx((4 * 0.5 + 1.0 + 0.5 + 0.5 + 0.0) / 2, abs=0.02)
    counts = begun()  # column by column
    assert counts[[4, 7]].max() < 0.3 * counts[[0, 1, 2, 3, 5, 6]].min()


def test_knees_are_stretched_uphill_only_and_by_what_the_load_bends():
    slope = {}
    for rise in (-0.3, 0.0, 0.3):
        both_stand = [shifts for shifts, planted in climb(rise) if planted.all()]
        slope[rise] = np.array(both_stand)
    assert not slope[0.0].any() and not slope[-0.3].any()
    assert -1.0 < slope[0.3].min() < -0.1 and slope[0.3].max() <= 0.0
    assert set(np.flatnonzero(slope[0.3].any(0))) <= {JOINT_INDEX["L_Knee_y"], JOINT_INDEX["R_Knee_y"]}


def climb(rise):
    """Shifts (69,) of targets from the gait's pose and feet that stand (2,), walking up a slope at 1 m/s."""
    bodies = [describe(shape_for(1.75, 75.0))]
    reference = GaitReference(bodies, 1 / 30, lambda xy: rise * xy[:, 0])
    one = np.zeros(1)
    reference.place(np.arange(1), np.zeros((1, 2)), one, one + 1.0, one)
    for k in range(74):
        aim = np.array([[(k + 1) / 30 + reference.preview, 0.0]])
        pelvis = aim - [[reference.preview, 0.0]]
        reference.advance(aim, pelvis, np.zeros((1, 2, 3)), np.zeros((1, 2), dtype=bool))
        if k >= 39:  # the walk is steady
            yield (reference.targets(np.arange(69), 0.0) - reference.joints)[0], reference.steps["planted"][0]


def test_a_leg_that_swings_is_helped_and_the_standing_hip_takes_most_of_the_torque():
    helped = []
    for shifts, planted in climb(0.0):
        shifts = shifts[HINGES].reshape(2, 2)
        assert not shifts[planted, 1].any()  # a standing knee
        if planted.sum() == 1:
            assert shifts[planted, 0] == pytest.approx(-0.6 * shifts[~planted, 0])
            helped.append(np.abs(shifts[~planted]).max())
    assert 0.1 < max(helped) <= 0.5
