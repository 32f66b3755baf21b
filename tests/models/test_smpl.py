"""SMPL files made by hand: a box of a person's size, the joints of a known body, and feet."""

import os
import pickle  # noqa: TID251  what is refused and what is not

import numpy as np
import pytest
from scipy import sparse

from footfall.models.body import BODY_INDEX, ShapeError, describe, sample_shapes
from footfall.models.body.anthropometry import SHAPE_NAMES
from footfall.models.body.smpl import Smpl, SmplError, volume
from footfall.models.motion.amass import SMPL_JOINTS

DENSITY = 1010.0
ORDER = [BODY_INDEX[name] for name in (*SMPL_JOINTS, "L_Hand", "R_Hand")]
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([face for a, b, c, d in SQUARES for face in ((a, b, c), (a, c, d))])


def fields(body):
    """What SMPL's file of that person would hold, in SMPL's frame: x left, y up, z forward."""
    depth = 0.12
    width = body.mass / DENSITY / (body.stature * depth)
    box = (CUBE - [0.5, 0.0, 0.5]) * [width, body.stature, depth]
    joints = body.zero_positions[ORDER][:, [1, 2, 0]]
    heel, hip = -0.25 * body.foot_length, body.measurements.hip_half_width
    feet = [[side * hip, 0.0, heel + far] for side in (1, -1) for far in (0.0, body.foot_length)]
    template = np.concatenate([box, joints, feet])
    regressor = np.zeros((24, len(template)))
    regressor[np.arange(24), len(box) + np.arange(24)] = 1.0
    directions = np.zeros((len(template), 3, 10))
    directions[..., 0] = 0.05 * template  # the first parameter makes everything larger
    return {"v_template": template, "shapedirs": directions, "J_regressor": regressor, "f": FACES}


@pytest.fixture
def person():
    shape = sample_shapes(3, seed=3)[1]
    shape[0], shape[SHAPE_NAMES.index("trunk_mass")] = 1.5, 0.0
    return describe(shape)


def test_a_person_is_measured_as_they_are(person, tmp_path):
    np.savez(tmp_path / "smpl.npz", **fields(person))
    shape = Smpl.read(tmp_path / "smpl.npz", "male").shape()
    twin = describe(shape)
    assert np.allclose(shape[1:], person.shape[1:], atol=0.02)
    assert np.allclose(twin.zero_positions, person.zero_positions, atol=1e-3)
    assert twin.mass == pytest.approx(person.mass, rel=1e-6)


def test_betas_change_who_it_is(person, tmp_path):
    np.savez(tmp_path / "smpl.npz", **fields(person))
    smpl = Smpl.read(tmp_path / "smpl.npz", "male")
    taller = describe(smpl.shape([0.5]))
    assert taller.stature == pytest.approx(1.025 * person.stature)
    assert taller.mass == pytest.approx(1.025**3 * person.mass)
    assert taller.thigh == pytest.approx(1.025 * person.thigh, rel=2e-3)
    with pytest.raises(ShapeError, match="stature"):
        smpl.shape([9.0])
    with pytest.raises(SmplError, match="at most 10 finite"):
        smpl.shape(np.zeros(11))


def test_a_pickle_with_sparse_joints_is_read_like_an_npz(person, tmp_path):
    whole = fields(person)
    packed = whole | {"J_regressor": sparse.csc_matrix(whole["J_regressor"])}
    (tmp_path / "smpl.pkl").write_bytes(pickle.dumps(packed, protocol=2))
    np.savez(tmp_path / "smpl.npz", **whole)
    ours, theirs = (Smpl.read(tmp_path / name).shape([0.2]) for name in ("smpl.pkl", "smpl.npz"))
    assert np.array_equal(ours, theirs)


class Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/footfall_was_here",)


def test_a_pickle_that_would_run_something_is_refused(tmp_path):
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"v_template": Evil()}))
    with pytest.raises(SmplError, match="which is no array"):
        Smpl.read(tmp_path / "evil.pkl")
    assert not os.path.exists("/tmp/footfall_was_here")


def test_other_files_are_refused(person, tmp_path):
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(SmplError, match="v_template"):
        Smpl.read(tmp_path / "other.npz")
    odd = fields(person) | {"J_regressor": np.zeros((22, 5))}
    np.savez(tmp_path / "odd.npz", **odd)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SmplError, match=r"J_regressor \(22, 5\)"):
        Smpl.read(tmp_path / "odd.npz")
    (tmp_path / "text.pkl").write_text("no pickle")
    with pytest.raises(SmplError, match="no SMPL body model"):
        Smpl.read(tmp_path / "text.pkl")


def test_volume_of_a_closed_mesh():
    assert volume(CUBE * [2.0, 3.0, 0.5] + 7.0, FACES) == pytest.approx(3.0)
