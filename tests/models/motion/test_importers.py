"""Importers against forward kinematics written out by hand, scipy rotations, and each other."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from footfall.models.body import BODY_INDEX, describe, forward_kinematics, shape_for
from footfall.models.motion.amass import SMPL_JOINTS, read_amass
from footfall.models.motion.asf_amc import read_asf_amc
from footfall.models.motion.bvh import read_bvh
from footfall.models.motion.deepmimic import read_deepmimic
from footfall.models.motion.recording import MotionFormatError

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Knee
  {
    OFFSET 0 -4 0
    CHANNELS 2 Xrotation Zrotation
    End Site
    {
      OFFSET 0 -3 1
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.25
1 10 2 0 0 0 0 0
1 10 2 20 30 40 50 60
"""

ASF = """:version 1.10
:units
  mass 1.0
  length 0.5
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    name femur
    direction 0.6 -0.8 0
    length 4
    axis 0 0 20 XYZ
    dof rx ry rz
  end
  begin
    name tibia
    direction 0 -1 0
    length 3
    axis 0 0 20 XYZ
    dof rx
  end
:hierarchy
  begin
    root femur
    femur tibia
  end
"""


@pytest.fixture
def data():
    folder = os.environ.get("FOOTFALL_DATA")
    if not folder:
        pytest.skip("FOOTFALL_DATA is not set: recorded motions are not tested")
    return Path(folder)


def ours(vector):
    """Y up, facing +Z, to x forward, y left, z up."""
    x, y, z = vector
    return np.array([z, x, y])


def test_bvh_places_joints_as_its_channels_say(tmp_path):
    path = tmp_path / "leg.bvh"
    path.write_text(BVH)
    recording = read_bvh(path, unit_to_m=0.5)
    assert recording.joints == ("Hips", "Knee", "Knee_end")
    assert recording.rate_hz == pytest.approx(4.0)
    hips = Rotation.from_euler("ZYX", [20, 30, 40], degrees=True)  # intrinsic, in the order of the channels
    knee = hips * Rotation.from_euler("XZ", [50, 60], degrees=True)
    expected = np.array([1.0, 10, 2]) + hips.apply([0, -4, 0])
    tip = expected + knee.apply([0, -3, 1])
    positions = recording.positions()
    np.testing.assert_allclose(positions[1, 1], 0.5 * ours(expected), atol=1e-12)
    np.testing.assert_allclose(positions[1, 2], 0.5 * ours(tip), atol=1e-12)
    np.testing.assert_allclose(positions[0, 2], 0.5 * ours([1, 3, 3]), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("MOTION", "MOTEN"), "is not BVH"),
        (("20 30 40 50 60", "20 30 40 50"), "line 20 has 7 numbers; the skeleton has 8"),
        (("Frames: 2", "Frames: 3"), "promises 3 frames and holds 2"),
        (("20 30 40 50 60", "20 30 forty 50 60"), "expected numbers"),
        (("OFFSET 0 -4 0", "OFFSET 0 down 0"), "line 8"),
    ],
)
def test_broken_bvh_is_refused_by_line(tmp_path, change, message):
    path = tmp_path / "broken.bvh"
    path.write_text(BVH.replace(*change))
    with pytest.raises(MotionFormatError, match=message):
        read_bvh(path)


def test_asf_amc_turns_bones_about_their_own_axes(tmp_path):
    (tmp_path / "leg.asf").write_text(ASF)
    (tmp_path / "leg.amc").write_text(
        ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 1 2 3 10 20 30\nfemur 40 5 6\ntibia 70\n"
    )
    recording = read_asf_amc(tmp_path / "leg.asf", tmp_path / "leg.amc")
    root = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    axis = Rotation.from_euler("z", 20, degrees=True)
    femur = root * axis * Rotation.from_euler("xyz", [40, 5, 6], degrees=True) * axis.inv()
    knee = np.array([1.0, 2, 3]) + femur.apply([2.4, -3.2, 0])
    tibia = femur * axis * Rotation.from_euler("x", 70, degrees=True) * axis.inv()
    unit = 0.0254 / 0.5
    assert recording.joints == ("root", "femur", "tibia")
    np.testing.assert_allclose(recording.positions()[0, 2], unit * ours(knee), atol=1e-12)
    seen = recording.rotations[0, 2] @ ours([0, -1, 0])
    np.testing.assert_allclose(seen, ours(tibia.apply([0, -1, 0])), atol=1e-12)


def test_amc_of_another_skeleton_is_refused(tmp_path):
    (tmp_path / "leg.asf").write_text(ASF)
    (tmp_path / "leg.amc").write_text("1\nroot 1 2 3 10 20 30\nhumerus 40 5 6\n")
    with pytest.raises(MotionFormatError, match="line 3: the skeleton has no bone 'humerus'"):
        read_asf_amc(tmp_path / "leg.asf", tmp_path / "leg.amc")
    (tmp_path / "leg.amc").write_text("1\nroot 1 2 3 10 20 30\nfemur 40 5\ntibia 1\n")
    with pytest.raises(MotionFormatError, match="femur needs 3 numbers"):
        read_asf_amc(tmp_path / "leg.asf", tmp_path / "leg.amc")


def test_asf_amc_and_bvh_of_one_trial_agree(data):
    folder = data / "cmu_locomotion"
    asf = read_asf_amc(folder / "asf_amc/39.asf", folder / "asf_amc/39_01.amc")
    bvh = read_bvh(folder / "bvh/39_01.bvh", "cmu", 0.0254 / 0.45).cut(1, len(asf) + 1)  # frame 0: a T-pose
    pairs = [("lfoot", "LeftFoot"), ("rtoes", "RightToeBase"), ("lradius", "LeftForeArm"), ("root", "Hips")]
    a, b = asf.positions(), bvh.positions()
    for ours_, theirs in pairs:
        gap = a[:, asf.joints.index(ours_)] - a[:, 0] - b[:, bvh.joints.index(theirs)] + b[:, 0]
        limit = 0.15 if "radius" in ours_ else 1e-3  # that BVH lacks the thorax bone's length
        assert np.abs(gap).max() < limit, ours_


def deepmimic_frame(duration, **turns):
    """A row with the identity everywhere but the joints given."""
    order = [
        "root",
        "chest",
        "neck",
        "right_hip",
        "right_knee",
        "right_ankle",
        "right_shoulder",
        "right_elbow",
    ]
    order += ["left_hip", "left_knee", "left_ankle", "left_shoulder", "left_elbow"]
    row = [duration, 0.0, 0.9, 0.0]
    for name in order:
        hinge = name.endswith(("knee", "elbow"))
        row += turns.get(name, [0.0] if hinge else [1.0, 0.0, 0.0, 0.0])
    return row


def test_deepmimic_faces_x_and_bends_knees_backwards(tmp_path):
    path = tmp_path / "humanoid3d_bend.txt"
    frames = [deepmimic_frame(0.1), deepmimic_frame(0.0, left_knee=[-1.0])]
    path.write_text(json.dumps({"Loop": "none", "Frames": frames}))
    recording = read_deepmimic(path, rate_hz=20.0)
    assert recording.name == "bend"
    assert len(recording) == 3
    positions = recording.positions()
    left, right = (recording.joints.index(f"{side}_ankle") for side in ("left", "right"))
    assert positions[0, left, 1] > 0 > positions[0, right, 1]
    shank = positions[2, left] - positions[2, recording.joints.index("left_knee")]
    np.testing.assert_allclose(shank, 0.40987 * np.array([-np.sin(1.0), 0, -np.cos(1.0)]), atol=1e-9)
    half = recording.rotations[1, left]  # half-way in time: half the angle
    np.testing.assert_allclose(Rotation.from_matrix(half).magnitude(), 0.5, atol=1e-9)


@pytest.mark.parametrize("text", ["{}", '{"Frames": [[1, 2]]}', "not json", '{"Frames": [["a"]]}'])
def test_broken_deepmimic_is_refused(tmp_path, text):
    path = tmp_path / "broken.txt"
    path.write_text(text)
    with pytest.raises(MotionFormatError, match="DeepMimic"):
        read_deepmimic(path)


def test_amass_pose_parameters_become_the_same_pose(tmp_path):
    body = describe(shape_for(1.7, 65.0))
    rng = np.random.default_rng(1)
    poses = rng.normal(0, 0.3, (3, 156))
    poses[:, :3] = Rotation.from_euler("x", 90, degrees=True).as_rotvec()  # upright, facing -y
    trans = rng.normal(0, 1, (3, 3))
    path = tmp_path / "motion_poses.npz"
    np.savez(path, poses=poses, trans=trans, mocap_framerate=60.0, betas=np.zeros(16))
    recording = read_amass(path, body)
    np.testing.assert_allclose(recording.rotations[0, 0] @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(recording.rotations[0, 0] @ [0, 0, 1], [0, 0, 1], atol=1e-12)

    # The same joint rotations through the skeleton's own kinematics.
    axes = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=float)
    joints = np.zeros((3, 23, 3))
    for i, name in enumerate(SMPL_JOINTS[1:], 1):
        local = axes @ Rotation.from_rotvec(poses[:, 3 * i : 3 * i + 3]).as_matrix() @ axes.T
        joints[:, BODY_INDEX[name] - 1] = Rotation.from_matrix(local).as_euler("XYZ")
    quaternion = Rotation.from_matrix(recording.rotations[:, 0]).as_quat(scalar_first=True)
    root = np.concatenate([trans, quaternion], 1)
    positions, _ = forward_kinematics(body.offsets, root, joints.reshape(3, 69))
    ours_ = recording.positions()
    for i, name in enumerate(SMPL_JOINTS):
        np.testing.assert_allclose(ours_[:, i], positions[:, BODY_INDEX[name]], atol=1e-9, err_msg=name)


def test_amass_without_poses_is_refused(tmp_path):
    path = tmp_path / "shape.npz"
    np.savez(path, betas=np.zeros(10), trans=np.zeros((2, 3)), mocap_framerate=30.0)
    with pytest.raises(MotionFormatError, match="poses"):
        read_amass(path, describe(shape_for(1.7, 65.0)))


def test_resampling_keeps_a_constant_turn_and_a_cubic_path(tmp_path):
    path = tmp_path / "leg.bvh"
    lines = BVH.split("Frames:")[0] + "Frames: 41\nFrame Time: 0.025\n"
    t = np.arange(41) * 0.025
    lines += "\n".join(f"{s**3} 0 0 0 {90 * s} 0 0 0" for s in t)
    path.write_text(lines)
    recording = read_bvh(path).resampled(30.0)
    t = np.arange(31) / 30
    np.testing.assert_allclose(recording.root[:, 1], t**3, atol=1e-9)
    turn = Rotation.from_matrix(recording.rotations[:, 0]).magnitude()
    np.testing.assert_allclose(turn, np.pi / 2 * t, atol=1e-9)


def test_a_glitch_of_one_frame_is_removed(tmp_path):
    path = tmp_path / "leg.bvh"
    t = np.arange(60) / 120
    rows = [f"0 {0.9 + 0.1 * s} 0 0 {90 * s} 0 0 0" for s in t]
    rows[30] = "5 0 0 170 10 90 40 0"
    path.write_text(BVH.split("Frames:")[0] + "Frames: 60\nFrame Time: 0.00833333\n" + "\n".join(rows))
    recording = read_bvh(path).without_glitches()
    assert np.abs(recording.root[30] - [0, 0, 0.9 + 0.1 * t[30]]).max() < 1e-3
    turn = Rotation.from_matrix(recording.rotations[:, 0]).magnitude()
    np.testing.assert_allclose(turn[4:-4], np.pi / 2 * t[4:-4], atol=0.02)
