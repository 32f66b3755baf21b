"""Retargeting, on synthetic recordings of a known person: what comes out must be what went in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from footfall.models.body import (
    BODY_INDEX,
    JOINT_INDEX,
    JOINT_LIMITS,
    LITE_JOINTS,
    describe,
    forward_kinematics,
    shape_for,
)
from footfall.models.motion.augment import bend, fit_to
from footfall.models.motion.feet import FootMotion, aligning, find_contacts
from footfall.models.motion.joint_maps import JOINT_MAPS
from footfall.models.motion.quality import measure
from footfall.models.motion.recording import MotionFormatError, Recording
from footfall.models.motion.retarget import retarget
from footfall.models.motion.walk_cycle import walk_cycle

NAMES = tuple(JOINT_MAPS["smpl"])


@pytest.fixture(scope="module")
def person():
    return describe(shape_for(1.8, 80.0))


@pytest.fixture(scope="module")
def walk(person):
    return walk_cycle(person, 1.3, duration=3.0, rate_hz=60.0)


def recorded(clip, body, twist=None):
    """A clip as a motion-capture system would give it: joint rotations in frames of its own.

    `twist` turns the frames of some joints by a constant, as skeletons of other zero poses do.
    """
    index = [BODY_INDEX[name] for name in NAMES]
    _, rotations = forward_kinematics(body.offsets, clip.root, clip.joints)
    parents, offsets = [], []
    for name in NAMES:
        above = {"Pelvis": None, "Chest": "Pelvis", "Neck": "Chest", "Head": "Neck"}.get(name)
        if "_" in name:
            chain = ["Hip", "Knee", "Ankle", "Toe"] if name[2:] in ("Hip", "Knee", "Ankle", "Toe") else None
            chain = chain or ["Thorax", "Shoulder", "Elbow", "Wrist"]
            k = chain.index(name[2:])
            above = name[:2] + chain[k - 1] if k else ("Pelvis" if chain[0] == "Hip" else "Chest")
        parents.append(-1 if above is None else NAMES.index(above))
    zero = body.zero_positions[index]
    for i, parent in enumerate(parents):
        offsets.append(np.zeros(3) if parent < 0 else zero[i] - zero[parent])
    turned = rotations[:, index].copy()
    for name, turn in (twist or {}).items():
        turned[:, NAMES.index(name)] = turned[:, NAMES.index(name)] @ turn
    return Recording(
        "synthetic", "smpl", NAMES, tuple(parents), np.array(offsets), clip.root[:, :3], turned, clip.rate_hz
    )


def test_retargeting_to_the_same_person_changes_next_to_nothing(person, walk):
    clip = retarget(recorded(walk, person), person, "lite", rate_hz=60.0)
    original = walk.cut(2, len(walk) - 2).centred()
    assert len(clip) == len(original)
    ours, _ = forward_kinematics(person.offsets, clip.root, clip.joints)
    theirs, _ = forward_kinematics(person.offsets, original.root, original.joints)
    gap = np.linalg.norm(ours - theirs, axis=-1)
    legs = [BODY_INDEX[n] for n in ("L_Knee", "L_Ankle", "R_Knee", "R_Ankle")]
    assert np.median(gap[:, legs]) < 0.012
    assert gap.max() < 0.06
    assert not clip.joints[:, ~LITE_JOINTS].any()


@pytest.mark.parametrize("roll_deg", [22.0, -15.0])
def test_feet_whose_frames_are_rolled_are_levelled(person, walk, roll_deg):
    """CMU's rest pose rolls the feet with its splayed legs: soles must come out level all the same."""
    roll = Rotation.from_euler("x", roll_deg, degrees=True).as_matrix()
    tilted = recorded(walk, person, {"L_Ankle": roll, "R_Ankle": roll.T})
    clip = retarget(tilted, person, "lite")
    _, rotations = forward_kinematics(person.offsets, clip.root, clip.joints)
    for foot, name in enumerate(("L_Ankle", "R_Ankle")):
        flat = clip.contacts[:, foot].all(-1)
        assert flat.sum() > 8
        sideways = rotations[flat, BODY_INDEX[name]][:, 2, 1]
        assert np.degrees(np.abs(sideways)).max() < 2.0
    assert measure(clip, person).roll_p95_deg < 1.5


@pytest.mark.parametrize("stature", [1.55, 1.95])
def test_feet_stand_still_and_on_the_ground_on_other_bodies(person, walk, stature):
    other = describe(shape_for(stature, 70.0))
    clip = retarget(recorded(walk, person), other, "lite")
    quality = measure(clip, other)
    assert quality.skate_median < 0.005
    assert quality.skate_p95 < 0.08
    assert quality.sink_max < 0.003
    assert quality.hover_max < 0.03
    assert quality.stance_share > 0.95
    assert clip.speed == pytest.approx(
        1.3 * (other.thigh + other.shank) / (person.thigh + person.shank), rel=0.02
    )


def test_angles_stay_within_the_joints_ranges(person, walk):
    clip = retarget(recorded(walk, person), person, "full")
    assert (clip.joints >= JOINT_LIMITS[:, 0] - 1e-12).all()
    assert (clip.joints <= JOINT_LIMITS[:, 1] + 1e-12).all()
    assert clip.joints[:, JOINT_INDEX["L_Toe_y"]].min() < -0.2  # toes stay on the ground while heels rise


def test_elbows_bend_forwards_about_their_hinge(person, walk):
    bent = walk.joints.copy()
    bent[:, JOINT_INDEX["L_Elbow_z"]], bent[:, JOINT_INDEX["R_Elbow_z"]] = -1.2, 0.9
    clip = retarget(recorded(replace(walk, joints=bent), person), person, "lite")
    np.testing.assert_allclose(clip.joints[:, JOINT_INDEX["L_Elbow_z"]], -1.2, atol=1e-6)
    np.testing.assert_allclose(clip.joints[:, JOINT_INDEX["R_Elbow_z"]], 0.9, atol=1e-6)


def test_a_skeleton_without_its_joints_is_refused(person, walk):
    recording = recorded(walk, person)
    with pytest.raises(MotionFormatError, match="have a joint 'Hips'"):
        retarget(replace(recording, skeleton="cmu"), person)
    with pytest.raises(MotionFormatError, match=r"needs 0\.2 s"):
        retarget(recording.cut(0, 5), person)


def test_contacts_are_where_the_gait_plants_its_feet(person):
    clip = walk_cycle(person, 1.2, duration=3.0)
    heel_or_ball = np.any(clip.contacts, axis=-1)
    assert 0.5 < heel_or_ball.mean() < 0.75  # of the stride a foot stands 60 %
    assert np.any(heel_or_ball, axis=1).all()  # walking: one foot always stands


def test_no_contact_is_found_in_the_air_or_in_motion():
    soles = np.zeros((30, 2, 5, 3))
    soles[:, 0, :, 2] = 0.1
    soles[:, 1, :, 0] = np.linspace(0, 1, 30)[:, None]
    assert not find_contacts(soles, 30.0).any()
    assert find_contacts(soles[:, :, :, [1, 1, 1]], 30.0).all()


def test_soles_of_a_posed_foot():
    body = describe(shape_for(1.7, 60.0))
    turn = Rotation.from_euler("ZYX", [0.4, 0.3, 0.2]).as_matrix()
    feet = FootMotion(np.full((1, 2, 3), 0.5), np.tile(turn, (1, 2, 1, 1)))
    np.testing.assert_allclose(feet.soles(body)[0, 1, 3], 0.5 + turn @ body.sole[1, 3], atol=1e-12)


def test_aligning_takes_the_shortest_turn():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.normal(size=(2, 3))
        turn = aligning(a, b)
        np.testing.assert_allclose(turn @ (a / np.linalg.norm(a)), b / np.linalg.norm(b), atol=1e-12)
        angle = np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
        assert Rotation.from_matrix(turn).magnitude() == pytest.approx(angle)


@pytest.mark.parametrize("rate_deg", [-40.0, 25.0])
def test_bent_walks_turn_as_asked_and_do_not_skate(person, rate_deg):
    clip = walk_cycle(person, 1.3, duration=3.0)
    bent = bend(clip, np.radians(rate_deg), person)
    assert np.degrees(bent.turn_rate) == pytest.approx(rate_deg, rel=0.1)
    assert bent.speed == pytest.approx(clip.speed, rel=0.03)
    quality = measure(bent, person)
    assert quality.skate_p95 < 0.08
    assert quality.sink_max < 0.004
    up = Rotation.from_quat(bent.root[:, 3:], scalar_first=True).as_matrix()[:, :, 2]
    heading = bent.heading()
    left = np.mean(up[:, 1] * np.cos(heading) - up[:, 0] * np.sin(heading))
    assert left == pytest.approx(0.8 * 1.3 * np.radians(rate_deg) / 9.81, rel=0.3)


def test_another_body_walks_the_same_walk(person):
    clip = walk_cycle(person, 1.3, duration=2.0)
    small = describe(shape_for(1.55, 55.0))
    fitted = fit_to(clip, person, small)
    assert len(fitted) == len(clip)
    upper = [i for i in range(69) if i >= 24]
    np.testing.assert_array_equal(fitted.joints[:, upper], clip.joints[:, upper])
    assert measure(fitted, small).skate_p95 < 0.08
    assert fitted.root[:, 2].mean() < clip.root[:, 2].mean() - 0.08
