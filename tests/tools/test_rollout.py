"""Motions and rollouts to look at: joint angles, logs of rollouts, files of motion, the window."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from footfall.messages.custom_topics import resolve_topics
from footfall.messages.log import LogError, LogReader
from footfall.messages.rollout import REFERENCE_BODY_STATES, REWARD_TERMS
from footfall.models.body import BODY_NAMES, JOINT_INDEX, describe, forward_kinematics, shape_for
from footfall.models.motion.library import MotionLibrary, body_states
from footfall.models.motion.recording import MotionFormatError
from footfall.models.motion.walk_cycle import walk_cycle
from footfall.nodes.viewer_server import Window
from footfall.tools.cli import main
from footfall.tools.motion_take import Take, joint_angles, read_takes
from footfall.tools.rollout_log import is_rollout, read_rollout, write_rollout
from footfall.tools.view_motion import FEET, LANE, REWARD, MotionViewer, curves_of

BODY = describe(shape_for(1.75, 75.0))
REST = (
    ("Hips", "LeftUpLeg", (1, 0, 0)),
    ("LeftUpLeg", "LeftLeg", (0, -7, 0)),
    ("LeftLeg", "LeftFoot", (0, -7, 0)),
    ("LeftFoot", "LeftToeBase", (0, -1, 2)),
    ("Hips", "Spine", (0, 1, 0)),
    ("Spine", "Spine1", (0, 3, 0)),
    ("Spine1", "Neck", (0, 4, 0)),
    ("Neck", "Head", (0, 2, 0)),
    ("Spine1", "LeftShoulder", (0.5, 3.5, 0)),
    ("LeftShoulder", "LeftArm", (2, 0, 0)),
    ("LeftArm", "LeftForeArm", (5, 0, 0)),
    ("LeftForeArm", "LeftHand", (4, 0, 0)),
)


def walking(number: int, frames: int = 40) -> Take:
    clip = walk_cycle(BODY, 1.0 + 0.2 * number, duration=3.0)
    states = body_states(clip, BODY)[:frames]
    late = states.copy()
    late[..., 0] -= 0.01
    feet = clip.contacts[:frames]
    terms = {"reward": np.linspace(0, 1, frames), "places": np.full(frames, 0.25 * (1 + number))}
    terms = {name: values.astype(np.float32) for name, values in terms.items()}
    return Take(
        f"walk {number}", 30.0, BODY.shape, late, states, contacts=feet, reference_contacts=~feet, terms=terms
    )


def bvh_of(scale: float) -> str:
    """A CMU skeleton who raises the left thigh by 30 degrees in 40 frames, in units of 1 / `scale`."""
    sides = [(a, b, o) for a, b, o in REST] + [
        (a.replace("Left", "Right"), b.replace("Left", "Right"), (-o[0], o[1], o[2]))
        for a, b, o in REST
        if "Left" in b
    ]

    def joint(name: str, offset: tuple, deep: int) -> str:
        x, y, z = (scale * v for v in offset)
        channels = "6 Xposition Yposition Zposition" if not deep else "3"
        head = "ROOT" if not deep else "JOINT"
        inner = "".join(joint(b, o, deep + 1) for a, b, o in sides if a == name)
        end = "" if inner else "End Site { OFFSET 0 0 0 }".replace("{", "\n{\n").replace("}", "\n}\n")
        return (
            f"{head} {name}\n{{\nOFFSET {x} {y} {z}\n"
            f"CHANNELS {channels} Zrotation Yrotation Xrotation\n{inner}{end}}}\n"
        )

    count = 1 + len(sides)
    rows = []
    for k in range(40):
        row = np.zeros(3 + 3 * count)
        row[:3] = 0, 15 * scale, 0.1 * k * scale
        row[3 + 3 + 2] = -30 * k / 39  # LeftUpLeg, X
        rows.append(" ".join(f"{v:g}" for v in row))
    motion = "\n".join(rows)
    return f"HIERARCHY\n{joint('Hips', (0, 0, 0), 0)}MOTION\nFrames: 40\nFrame Time: 0.0333333\n{motion}\n"


def test_joint_angles_undo_forward_kinematics():
    rng = np.random.default_rng(3)
    joints = rng.uniform(-1.2, 1.2, (6, 69))
    root = np.zeros((6, 7))
    root[:, 3:] = Rotation.from_rotvec(rng.normal(size=(6, 3))).as_quat(scalar_first=True)
    _, turns = forward_kinematics(BODY.offsets, root, joints)
    states = np.zeros((6, 24, 7))
    states[..., 3:] = (
        Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(6, 24, 4)
    )
    for name in BODY_NAMES[1:]:
        first = JOINT_INDEX[f"{name}_x"]
        for frame in range(6):
            found = joint_angles(states[frame : frame + 1], name)[0]
            assert found == pytest.approx(joints[frame, first : first + 3], abs=1e-6)


def test_a_rollout_is_read_as_it_was_written(tmp_path):
    takes = [walking(0), walking(1, frames=25)]
    path = write_rollout(tmp_path / "rollout.mcap", takes)
    reader = LogReader(path)
    assert is_rollout(reader) and reader.graph is not None
    assert resolve_topics(reader.graph)["reward_terms"] is REWARD_TERMS
    assert {"bodies", "body_states", REFERENCE_BODY_STATES.name} <= set(reader.topics)
    for take, read in zip(takes, read_rollout(path), strict=True):
        assert (read.name, len(read), read.rate_hz) == (take.name, len(take), pytest.approx(30.0))
        assert read.shape == pytest.approx(take.shape, abs=1e-6)
        for name in ("states", "reference", "contacts", "reference_contacts"):
            assert np.array_equal(getattr(read, name), getattr(take, name)), name
        assert read.terms.keys() == take.terms.keys()
        assert all(np.array_equal(read.terms[name], take.terms[name]) for name in take.terms)
    with pytest.raises(LogError, match="exists"):
        write_rollout(path, takes)
    with pytest.raises(ValueError, match="at least one"):
        write_rollout(tmp_path / "none.mcap", [])


def test_a_log_of_a_run_is_no_rollout(tmp_path, capsys):
    from footfall.messages.log import LogWriter

    with LogWriter(tmp_path / "empty.mcap"):
        pass
    assert not is_rollout(LogReader(tmp_path / "empty.mcap"))
    with pytest.raises(LogError, match="no bodies and no body_states"):
        read_rollout(tmp_path / "empty.mcap")


@pytest.mark.parametrize("scale", [1.0, 6.0])
def test_a_recording_stands_beside_what_our_body_makes_of_it(tmp_path, scale):
    """Whatever the unit of length: it is found out by the size."""
    path = tmp_path / "lift.bvh"
    path.write_text(bvh_of(scale))
    (take,) = read_takes(path)
    assert take.skeleton is not None and take.contacts is not None and len(take) == len(take.skeleton)
    tall = np.ptp(take.skeleton[0, :, 2])
    assert 1.2 < tall < 2.3
    hip, knee = take.parents.index(0), take.parents.index(1)
    thigh = take.skeleton[:, knee] - take.skeleton[:, hip]
    lifted = np.degrees(np.arctan2(thigh[:, 0], -thigh[:, 2]))
    assert lifted[-1] - lifted[0] == pytest.approx(30 * (len(take) - 1) / 39, abs=1.0)
    own = np.degrees(joint_angles(take.states, "L_Hip"))[:, 1]
    assert 15 < own[0] - own[-1] < 30  # planting the feet changes it a little


def test_what_is_no_motion_is_said(tmp_path, capsys):
    strange = bvh_of(1.0).replace("LeftUpLeg", "Thing")
    (tmp_path / "strange.bvh").write_text(strange)
    with pytest.raises(MotionFormatError, match="no skeleton known: cmu, asf"):
        read_takes(tmp_path / "strange.bvh")
    (tmp_path / "huge.bvh").write_text(bvh_of(1000.0))
    with pytest.raises(MotionFormatError, match="units high"):
        read_takes(tmp_path / "huge.bvh")
    (tmp_path / "1_2.amc").write_text("")
    with pytest.raises(MotionFormatError, match="0 skeletons"):
        read_takes(tmp_path / "1_2.amc")
    (tmp_path / "a.npz").write_bytes(b"nothing")
    assert main(["view", str(tmp_path / "a.npz"), "--port", "0"]) == 2
    assert "no AMASS motion" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "a.npz"), str(tmp_path / "b.bvh")]) == 2
    assert "one motion is shown at a time" in capsys.readouterr().err


def test_a_library_is_looked_at_clip_by_clip(tmp_path):
    clips = [walk_cycle(BODY, speed, duration=2.0) for speed in (1.0, 1.5)]
    MotionLibrary(clips, [BODY]).save(tmp_path / "motions.npz")
    takes = read_takes(tmp_path / "motions.npz")
    assert [take.name for take in takes] == [clip.name for clip in clips]
    assert takes[1].states == pytest.approx(body_states(clips[1], BODY), abs=1e-5)


def test_the_window_shows_body_reference_feet_and_curves():
    takes = [walking(0), walking(1)]
    window = Window("127.0.0.1", 0, "test")
    try:
        viewer = MotionViewer(window.server, takes, "walk 1")
        viewer.time_line.seek(0.5)
        viewer.refresh()
        take, scene = takes[1], viewer._scene
        assert scene is not None
        for part, handle in scene._parts:
            assert handle.batched_positions[0] == pytest.approx(take.states[15, part.body, :3], abs=1e-5)
        shown = window.server.scene.get_handle_by_name("/reference")
        assert shown is not None and shown.position == pytest.approx([0.0, LANE, 0.0])
        assert take.contacts is not None
        sizes = viewer._drawn["feet"].batched_scales[:, 0] > 0.01
        assert sizes.tolist() == take.contacts[15].reshape(-1).tolist()
        x, *curves, now = viewer._plot.data
        assert len(curves) == len(take.terms)
        assert x[now.argmax()] == pytest.approx(0.5) and (np.diff(x) >= 0).all()
        assert curves[0][now.argmax()] == pytest.approx(15 / 39, abs=0.02)
        assert "10 mm" in viewer._text.content  # how far the reference is away
        viewer._overlay.value = True
        viewer._move()
        assert shown.position[1] == 0.0
        viewer._show(takes[0])
        assert viewer.time_line.time == 0.0 and "feet" not in viewer._drawn
        viewer.refresh()
        assert viewer._plot.data[1].shape == viewer._plot.data[0].shape
    finally:
        window.close()
    labels = [label for label, *_ in curves_of(takes[0], FEET)]
    assert labels == ["left heel", "left ball", "right heel", "right ball"]
    assert {label for label, *_ in curves_of(takes[0], REWARD)} == {"reward", "places"}
    knee = curves_of(takes[0], "L_Knee")
    assert len(knee) == 6 and knee[1][1] == pytest.approx(knee[4][1])
    with pytest.raises(ValueError, match="walk 1"):
        MotionViewer(window.server, takes, "walk 2")
