"""Worlds, masks, sampling, observations and rewards of the tracker, against MuJoCo and invariances."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from footfall.models.body import BODY_INDEX, describe, forward_kinematics, shape_for
from footfall.models.motion.library import MotionLibrary
from footfall.models.motion.walk_cycle import walk_cycle
from footfall.models.pacer.batch_world import BatchWorld, BatchWorldError, Physics
from footfall.models.pacer.body_masks import LEFT_ARM, UPPER_BODY, sample_masks
from footfall.models.pacer.clip_sampler import ClipSampler
from footfall.models.pacer.config import TrackerConfig
from footfall.models.pacer.mathops import heading, rotate, rotate_back, to_heading, turn_between, two_axes
from footfall.models.pacer.tracker_env import TrackerEnv
from footfall.models.pacer.tracker_evaluation import evaluate
from footfall.models.pacer.tracker_training import TrackerTraining

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

PEOPLE = [describe(shape_for(1.75, 75.0)), describe(shape_for(1.6, 60.0))]
SMALL = TrackerConfig(
    worlds=6, physics=Physics(threads=1), hidden=(16,), horizon=4, minibatch=16, narrow_start=2
)


@pytest.fixture(scope="module")
def library():
    clips = [walk_cycle(PEOPLE[0], speed, duration=2.0) for speed in (1.0, 1.3, 1.8)]
    return MotionLibrary(clips, PEOPLE)


def put(world, library, frame):
    ids = np.arange(len(world))
    body = world.body_index
    world.reset(
        ids,
        library.root[body, frame],
        library.joints[body, frame],
        library.root_velocity[body, frame],
        library.joint_velocities[body, frame],
    )


def test_rotations_agree_with_scipy():
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(rng.normal(size=(50, 3)))
    quaternion, vector = turns.as_quat(scalar_first=True), rng.normal(size=(50, 3))
    np.testing.assert_allclose(rotate(quaternion, vector), turns.apply(vector), atol=1e-12)
    np.testing.assert_allclose(rotate_back(quaternion, vector), turns.inv().apply(vector), atol=1e-12)
    axes = turns.as_matrix()
    np.testing.assert_allclose(
        two_axes(quaternion), np.concatenate([axes[..., 0], axes[..., 2]], 1), atol=1e-12
    )
    yaw = np.arctan2(axes[:, 1, 0], axes[:, 0, 0])
    way = heading(quaternion)
    np.testing.assert_allclose(np.arctan2(way[:, 1], way[:, 0]), yaw, atol=1e-9)
    back = Rotation.from_rotvec(np.stack([0 * yaw, 0 * yaw, -yaw], -1))
    np.testing.assert_allclose(to_heading(way, vector), back.apply(vector), atol=1e-9)
    others = Rotation.from_rotvec(rng.normal(size=(50, 3)))
    angle = (turns.inv() * others).magnitude()
    np.testing.assert_allclose(turn_between(quaternion, others.as_quat(scalar_first=True)), angle, atol=1e-6)


def test_worlds_hold_their_own_bodies_where_they_were_put(library):
    world = BatchWorld(PEOPLE, 4, Physics(threads=1))
    put(world, library, 20)
    for i in range(4):
        body = PEOPLE[i % 2]
        places, rotations = forward_kinematics(
            body.offsets, library.root[i % 2, 20], library.joints[i % 2, 20]
        )
        np.testing.assert_allclose(world.positions[i], places, atol=1e-9)
        turns = Rotation.from_quat(world.quaternions[i], scalar_first=True).as_matrix()
        np.testing.assert_allclose(turns, rotations, atol=1e-9)
    np.testing.assert_allclose(world.positions[0], world.positions[2])
    linear, angular = world.velocities()
    reference = library.states[world.body_index, 20]
    np.testing.assert_allclose(linear, reference[..., 7:10], atol=0.12)
    np.testing.assert_allclose(angular[:, 0], reference[:, 0, 10:], atol=0.12)


def test_stepping_is_mujocos(library):
    """One world stepped in a batch is the same model stepped by hand."""
    world = BatchWorld(PEOPLE[:1], 3, Physics(threads=2))
    put(world, library, 10)
    model = world._batch.model
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = world.qpos[1], world.qvel[1]
    targets = library.joints[np.zeros(3, int), 14][:, world.hinges]
    for _ in range(3):
        world.step(targets)
        for _ in range(world.physics.substeps):
            data.ctrl[:] = targets[1]
            mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(world.qpos[1], data.qpos, atol=1e-9)
    np.testing.assert_allclose(world.positions[1], data.xpos[1:], atol=1e-9)
    velocity = np.zeros(6)
    linear, angular = world.velocities()
    for name in ("Pelvis", "L_Ankle", "Head"):
        body = BODY_INDEX[name]
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body + 1, velocity, 0)
        np.testing.assert_allclose(angular[1, body], velocity[:3], atol=1e-9)
        np.testing.assert_allclose(linear[1, body], velocity[3:], atol=1e-9)


def test_impossible_batches_are_refused():
    with pytest.raises(BatchWorldError, match="at least one"):
        BatchWorld([], 4)
    with pytest.raises(BatchWorldError, match="positive"):
        BatchWorld(PEOPLE, 4, Physics(timestep=0.0))


def test_masks_keep_the_pelvis_and_the_numbers_of_the_paper():
    assert UPPER_BODY.sum() == 16
    assert LEFT_ARM.sum() == 6
    masks = sample_masks(4000, 0.5, np.random.default_rng(0))
    assert masks[:, 0].all()
    assert masks.all(1).mean() == pytest.approx(0.5 + 0.25 / 12, abs=0.03)
    subsets = masks[(~masks.all(1)) & (masks.sum(1) > 16)]
    assert subsets.sum(1).min() >= 13


def test_the_sampler_starts_narrow_widens_and_seeks_failures(library):
    sampler = ClipSampler(library, narrow_start=1, widen_below=0.3)
    rng = np.random.default_rng(0)
    clips, frames = sampler.sample(500, rng)
    assert (clips == 1).all()  # 1.3 m/s is nearest to ordinary
    assert frames.max() < library.lengths[1] - 4
    for _ in range(60):
        sampler.report(clips, frames, np.zeros(500, bool))
    assert sampler.active == 3
    clips, frames = sampler.sample(3000, rng)
    assert set(clips) == {0, 1, 2}
    for _ in range(40):
        clips, frames = sampler.sample(500, rng)
        sampler.report(clips, frames, (clips == 2) & (frames < 30))
    clips, frames = sampler.sample(4000, rng)
    hard = (clips == 2) & (frames < 30)
    assert hard.mean() > 0.6
    again = ClipSampler(library, narrow_start=1)
    again.load_state(sampler.state())
    np.testing.assert_array_equal(
        again.sample(50, np.random.default_rng(5)), sampler.sample(50, np.random.default_rng(5))
    )


def test_standing_on_the_reference_earns_the_full_reward(library):
    env = TrackerEnv(SMALL, library)
    env.place(np.arange(6), np.array([0, 1, 2, 0, 1, 2]), np.array([3, 30, 11, 40, 8, 22]))
    errors = env.errors()
    assert errors.places.max() < 1e-5
    rewards, terms = env.rewards(errors)
    assert not env.lost(errors).any()
    np.testing.assert_allclose(
        [terms[k] for k in ("places", "joints", "root", "root_velocity")], 1.0, atol=1e-4
    )
    assert (rewards > 0.95).all()  # soles of a gait do not touch to the millimetre
    weights = [w for w, _ in vars(SMALL.rewards).values()]
    assert sum(weights) == pytest.approx(1.0)
    env.world.qpos[:, 2] -= 0.6
    env.world._batch.forward()
    assert env.lost(env.errors()).all()


def test_what_is_seen_does_not_depend_on_where_one_walks(library):
    """Turn and shift person and reference together: observations and rewards must not change."""
    turn, shift = 1.1, np.array([3.0, -2.0, 0.0])
    about = Rotation.from_euler("z", turn)
    moved = [
        replace(
            clip,
            root=np.concatenate(
                [
                    about.apply(clip.root[:, :3]) + shift,
                    (about * Rotation.from_quat(clip.root[:, 3:], scalar_first=True)).as_quat(
                        scalar_first=True
                    ),
                ],
                axis=1,
            ),
        )
        for clip in library.clips
    ]
    seen, earned = [], []
    for clips in (library.clips, moved):
        env = TrackerEnv(SMALL, MotionLibrary(clips, PEOPLE[:1]))
        env.place(np.arange(6), np.array([0, 1, 2, 0, 1, 2]), np.array([3, 30, 11, 40, 8, 22]))
        env._frame += 4  # the person lags; physics would differ: pyramidal friction cones have directions
        seen.append(env.observe())
        earned.append(env.rewards(env.errors())[0])
    assert np.abs(seen[0]).max() > 0.5
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-4)
    np.testing.assert_allclose(earned[1], earned[0], atol=1e-4)
    assert earned[0].max() < 0.95


def test_what_is_masked_is_not_seen(library):
    env = TrackerEnv(SMALL, library)
    ids, clips = np.arange(6), np.zeros(6, dtype=int)
    masks = np.tile(LEFT_ARM, (6, 1))
    env.place(ids, clips, np.full(6, 10), masks=masks)
    before, targets = env.observe(), env.targets(np.zeros((6, 28), dtype=np.float32))
    hidden = 1 + env.world.hinges // 3 == BODY_INDEX["R_Knee"]
    changed = library.joints[:, :, env.world.hinges[hidden]].copy()
    try:
        env.observation._joints[:, :, hidden] += 1.0
        env._targets[:, :, hidden] += 1.0
        np.testing.assert_array_equal(env.observe(), before)
        np.testing.assert_array_equal(env.targets(np.zeros((6, 28), dtype=np.float32)), targets)
        env.place(ids, clips, np.full(6, 10))
        assert np.abs(env.observe() - before).max() > 1.0
    finally:
        np.testing.assert_array_equal(library.joints[:, :, env.world.hinges[hidden]], changed)


def test_episodes_end_and_begin_again(library):
    env = TrackerEnv(replace(SMALL, episode=12), library, seed=3)
    env.reset()
    ends, failures = 0, 0
    rng = np.random.default_rng(0)
    for k in range(40):
        wild = 4.0 * rng.normal(size=(6, 28)) if k > 20 else np.zeros((6, 28))
        step = env.step(wild.astype(np.float32))
        assert step.observations.shape == (6, env.observation.size)
        assert np.isfinite(step.observations).all()
        assert ((step.rewards >= 0) & (step.rewards <= 1.0)).all()
        assert not (step.failed & step.cut).any()
        assert len(step.cut_observations) == step.cut.sum()
        assert not env.lost(env.errors())[step.failed | step.cut].any()
        ends, failures = ends + step.cut.sum(), failures + step.failed.sum()
    assert ends > 6
    assert failures > 3


def test_the_same_seed_gives_the_same_worlds(library):
    seen = []
    for _ in range(2):
        env = TrackerEnv(SMALL, library, seed=7)
        env.reset()
        seen.append([env.step(np.full((6, 28), 0.05, dtype=np.float32)).observations for _ in range(10)])
    np.testing.assert_array_equal(seen[0], seen[1])


def test_leading_targets_make_up_for_damped_joints(library):
    """Without a policy, targets that lead by kd / kp follow the reference far more closely."""
    errors = {}
    for lead in (0.0, 1.0):
        env = TrackerEnv(replace(SMALL, lead=lead), library, 12)
        env.place(np.arange(12), np.arange(12) % 3, np.arange(12) * 3)
        gaps = []
        for _ in range(5):
            env.advance(np.zeros((12, 28), dtype=np.float32))
            gaps.append(np.abs(env.world.joints - env._joints[env.world.body_index, env._frame]).mean())
        errors[lead] = np.mean(gaps)
    assert errors[1.0] < 0.7 * errors[0.0]


def test_training_resumes_where_it_stopped(library):
    training = TrackerTraining(TrackerEnv(SMALL, library), SMALL)
    assert training.update()["kl"] >= 0
    training.update()
    assert training.samples == 2 * 4 * 6
    tensors, facts = training.state()
    again = TrackerTraining(TrackerEnv(SMALL, library), replace(SMALL, seed=9))
    again.load_state({k: v.clone() for k, v in tensors.items()}, facts)
    assert again.samples == training.samples
    assert again.ppo.rate == training.ppo.rate
    seen = torch.randn(5, training.env.observation.size)
    torch.testing.assert_close(again.model.act(seen), training.model.act(seen))
    theirs, _ = again.state()
    for name, value in tensors.items():
        torch.testing.assert_close(theirs[name], value)
    again.update()


def test_evaluation_follows_every_clip_from_its_beginning(library):
    training = TrackerTraining(TrackerEnv(SMALL, library), SMALL)
    one = MotionLibrary(library.clips, PEOPLE[:1])
    result = evaluate(training.model, one, SMALL, worlds=2)
    assert result.tracked.shape == result.fell.shape == (3,)
    assert not (result.fell & result.tracked).any()
    assert (result.seconds > 0.1).all()
    assert (result.seconds <= one.lengths / 30).all()
    figures = result.summary()
    assert 0.0 <= figures["share of clips tracked to end"] <= figures["share of clips without a fall"] <= 1.0
    assert 1.0 < figures["mean joint error mm"] < 500.0
    assert figures["mean joint error in the world mm"] < 500.0
