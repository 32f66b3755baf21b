"""Clips and libraries against analytic motion, MuJoCo's kinematics, and their own mirror images."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from footfall.models.body import BODY_INDEX, JOINT_INDEX, LITE_JOINTS, describe, forward_kinematics, shape_for
from footfall.models.motion.clip import MIRROR_BODIES, Clip
from footfall.models.motion.library import MotionLibrary, body_states, load_clips
from footfall.models.motion.recording import MotionFormatError
from footfall.models.motion.walk_cycle import walk_cycle
from footfall.models.world.humanoid import to_mjcf

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)


@pytest.fixture(scope="module")
def person():
    return describe(shape_for(1.75, 75.0))


@pytest.fixture(scope="module")
def library(person):
    walks = [walk_cycle(person, speed, duration=2.0) for speed in (0.9, 1.3, 1.7)]
    return MotionLibrary([*walks, walks[0].mirrored()], [person, describe(shape_for(1.6, 60.0))])


def swinging(duration=2.0, rate_hz=30.0):
    """A person who circles, turns and swings by sines, and the velocities of that."""
    t = np.arange(round(duration * rate_hz) + 1) / rate_hz
    yaw = 0.8 * t
    root = np.zeros((len(t), 7))
    root[:, :3] = np.stack([np.sin(t), 1 - np.cos(t), 0.9 + 0.02 * np.sin(3 * t)], -1)
    tilt = Rotation.from_euler("y", 0.2)
    turns = Rotation.from_rotvec(np.stack([0 * t, 0 * t, yaw], -1)) * tilt
    root[:, 3:] = turns.as_quat(scalar_first=True)
    joints = np.zeros((len(t), 69))
    joints[:, JOINT_INDEX["L_Hip_y"]] = 0.5 * np.sin(2 * t)
    clip = Clip("swing", rate_hz, root, joints, np.zeros((len(t), 2, 2), bool))
    linear = np.stack([np.cos(t), np.sin(t), 0.06 * np.cos(3 * t)], -1)
    return clip, linear, np.tile([0, 0, 0.8], (len(t), 1)), np.cos(2 * t)


def test_velocities_are_the_derivatives():
    clip, linear, angular, hip = swinging()
    root, joints = clip.velocities()
    np.testing.assert_allclose(root[:, :3], linear, atol=2e-3)
    np.testing.assert_allclose(root[:, 3:], angular, atol=1e-6)
    np.testing.assert_allclose(joints[:, JOINT_INDEX["L_Hip_y"]], hip, atol=2e-3)


def test_body_states_agree_with_mujoco(person):
    clip, *_ = swinging()
    states = body_states(clip, person)
    root, rates = clip.velocities()
    model = mujoco.MjModel.from_xml_string(to_mjcf(person))
    data = mujoco.MjData(model)
    for t in (5, 20, 41):
        data.qpos[:] = np.concatenate([clip.root[t], clip.joints[t]])
        spin = Rotation.from_quat(clip.root[t, 3:], scalar_first=True).inv().apply(root[t, 3:])
        data.qvel[:] = np.concatenate([root[t, :3], spin, rates[t]])
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(states[t, :, :3], data.xpos[1:], atol=1e-5)
        overlap = np.abs(np.sum(states[t, :, 3:7] * data.xquat[1:], -1))
        np.testing.assert_allclose(overlap, 1.0, atol=1e-5)
        velocity = np.zeros(6)
        for body in range(24):
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(model, data, kind, body + 1, velocity, 0)
            np.testing.assert_allclose(states[t, body, 10:], velocity[:3], atol=0.02)
            np.testing.assert_allclose(states[t, body, 7:10], velocity[3:], atol=0.02)


def test_a_mirror_image_is_the_reflected_body(person):
    clip, *_ = swinging()
    mirrored = clip.mirrored()
    ours, ours_turned = forward_kinematics(person.offsets, clip.root, clip.joints)
    theirs, theirs_turned = forward_kinematics(person.offsets, mirrored.root, mirrored.joints)
    flip = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(theirs, ours[:, MIRROR_BODIES] @ flip, atol=1e-12)
    np.testing.assert_allclose(theirs_turned, flip @ ours_turned[:, MIRROR_BODIES] @ flip, atol=1e-12)
    twice = mirrored.mirrored()
    np.testing.assert_array_equal(twice.root, clip.root)
    np.testing.assert_array_equal(twice.joints, clip.joints)


def test_speed_and_turn_rate_of_known_motion(person):
    clip, *_ = swinging()
    assert clip.speed == pytest.approx(1.0, rel=0.02)
    assert clip.turn_rate == pytest.approx(0.8)
    centred = clip.centred()
    np.testing.assert_allclose(centred.root[0, :2], 0.0, atol=1e-12)
    assert centred.heading()[0] == pytest.approx(0.0)
    assert centred.speed == pytest.approx(clip.speed)


def test_a_library_lays_clips_end_to_end_for_every_body(library, person):
    assert library.root.shape == (2, library.lengths.sum(), 7)
    clip = library.clips[2]
    rows = slice(library.starts[2], library.starts[2] + library.lengths[2])
    np.testing.assert_array_equal(library.joints[0, rows], clip.joints)
    np.testing.assert_allclose(library.states[0, rows], body_states(clip, person), atol=1e-6)
    for k, body in enumerate(library.bodies):
        frame = library.starts[1] + 11
        places, _ = forward_kinematics(body.offsets, library.root[k, frame], library.joints[k, frame])
        np.testing.assert_allclose(library.states[k, frame, :, :3], places, atol=1e-5)
        assert library.states[k, :, BODY_INDEX["Head"], 2].mean() == pytest.approx(
            0.885 * body.stature, rel=0.05
        )


def test_rare_speeds_are_lifted(library):
    plain, lifted = library.weights(0.0), library.weights(1.0)
    assert plain.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(plain, library.lengths / library.lengths.sum())
    assert lifted[0] + lifted[3] == pytest.approx(lifted[1], rel=1e-9)  # one cell of speed and turning each


def test_saving_and_loading(library, person, tmp_path):
    path = tmp_path / "motions.npz"
    library.save(path)
    clips, bodies = load_clips(path)
    assert [clip.name for clip in clips] == [clip.name for clip in library.clips]
    assert clips[3].tags["parent"] == library.clips[0].name
    np.testing.assert_allclose(clips[1].joints, library.clips[1].joints, atol=1e-6)
    np.testing.assert_array_equal(bodies[1].shape, library.bodies[1].shape)
    again = MotionLibrary.load(path, [describe(shape_for(1.9, 90.0))])
    assert again.root.shape[0] == 1
    assert again.root[0, :, 2].mean() > library.root[0, :, 2].mean() + 0.05


def test_broken_libraries_are_refused(tmp_path, person):
    path = tmp_path / "broken.npz"
    np.savez(path, lengths=np.array([3]))
    with pytest.raises(MotionFormatError, match="no motion library"):
        load_clips(path)
    path.write_bytes(b"no zip at all")
    with pytest.raises(MotionFormatError, match="no motion library"):
        load_clips(path)
    with pytest.raises(MotionFormatError, match="at least one clip"):
        MotionLibrary([], [person])
    walk = walk_cycle(person, 1.0, duration=1.0)
    with pytest.raises(MotionFormatError, match="share one rate"):
        MotionLibrary([walk, walk_cycle(person, 1.0, duration=1.0, rate_hz=60.0)], [person])


def test_the_synthetic_walk_uses_the_lite_hinges(person):
    clip = walk_cycle(person, 1.3)
    assert clip.joints[:, LITE_JOINTS].any()
    assert not clip.joints[:, ~LITE_JOINTS].any()
    assert clip.speed == pytest.approx(1.3, rel=0.03)
