"""The body against published tables, MuJoCo's kinematics and plain geometry."""

import doctest

import mujoco
import numpy as np
import pytest

from footfall.models.body import (
    BODY_INDEX,
    BODY_NAMES,
    JOINT_INDEX,
    JOINT_LIMITS,
    JOINT_NAMES,
    LITE_JOINTS,
    N_JOINTS,
    PARENTS,
    ShapeError,
    describe,
    forward_kinematics,
    sample_shapes,
    shape_for,
)
from footfall.models.body import body as body_module
from footfall.models.body.anthropometry import MASS_RANGE, N_SHAPE, STATURE_RANGE
from footfall.models.body.rotations import matrix_from_quaternion, rotation_vector
from footfall.models.body.skeleton import matrix_from_triplet, triplet_from_matrix
from footfall.models.world.humanoid import MAX_AGENTS, Actuation, actuated_joints, agent_mask, to_mjcf

# pyright: reportAttributeAccessIssue=false

MALE, FEMALE = 1.0, 0.0
PEOPLE = [describe(shape) for shape in sample_shapes(20, seed=7)]

# de Leva (1996), table 4, % of body mass (female, male), copied here by hand, summed over these bodies.
DE_LEVA = {
    ("Neck", "Head"): (6.68, 6.94),
    ("Chest", "L_Thorax", "R_Thorax"): (15.45, 15.96),
    ("Torso", "Spine"): (14.65, 16.33),
    ("Pelvis",): (12.47, 11.17),
    ("L_Shoulder",): (2.55, 2.71),
    ("R_Elbow",): (1.38, 1.62),
    ("L_Wrist", "L_Hand"): (0.56, 0.61),
    ("R_Hip",): (14.78, 14.16),
    ("L_Knee",): (4.81, 4.33),
    ("R_Ankle", "R_Toe"): (1.29, 1.37),
}


def arms_down() -> np.ndarray:
    joints = np.zeros(N_JOINTS)
    joints[JOINT_INDEX["L_Shoulder_x"]] = -np.pi / 2
    joints[JOINT_INDEX["R_Shoulder_x"]] = np.pi / 2
    return joints


def model_of(body, actuation: Actuation = "full"):
    model = mujoco.MjModel.from_xml_string(to_mjcf(body, actuation))
    return model, mujoco.MjData(model)


def test_the_example_in_the_documentation_holds():
    assert doctest.testmod(body_module).failed == 0


def test_order_is_smpl():
    assert BODY_NAMES[:9] == (
        "Pelvis", "L_Hip", "L_Knee", "L_Ankle", "L_Toe", "R_Hip", "R_Knee", "R_Ankle", "R_Toe"
    )  # fmt: skip
    assert len(BODY_NAMES) == 24 and len(JOINT_NAMES) == 69
    assert JOINT_NAMES[:3] == ("L_Hip_x", "L_Hip_y", "L_Hip_z")
    assert all(parent < child for child, parent in enumerate(PARENTS))


@pytest.mark.parametrize(("sex", "column"), [(FEMALE, 0), (MALE, 1)])
def test_segment_masses_are_de_levas(sex, column):
    body = describe(shape_for(1.7, 70.0, sex))
    for names, percent in DE_LEVA.items():
        share = sum(body.masses[BODY_INDEX[name]] for name in names) / body.mass
        assert share == pytest.approx(percent[column] / 100, rel=0.02), names


@pytest.mark.parametrize("body", PEOPLE)
def test_masses_sum_to_body_mass_and_inertias_are_possible(body):
    assert body.masses.sum() == pytest.approx(body.mass, rel=1e-9)
    model, _ = model_of(body)
    assert model.body_mass.sum() == pytest.approx(body.mass, rel=1e-4)
    inertia = body.segments.inertias
    assert (inertia > 0).all()
    assert (inertia.sum(axis=1, keepdims=True) - 2 * inertia > 0).all()  # the triangle inequality


def test_whole_body_inertia_matches_santschi():
    """Santschi et al. (1963), 66 men, mean 75.5 kg and 1.763 m, standing, arms at the sides."""
    body = describe(shape_for(1.763, 75.5, MALE))
    model, data = model_of(body)
    data.qpos[7:] = arms_down()
    mujoco.mj_forward(model, data)
    centre = data.subtree_com[1]
    total = np.zeros((3, 3))
    for i in range(1, model.nbody):
        frame = data.ximat[i].reshape(3, 3)
        arm = data.xipos[i] - centre
        total += frame @ np.diag(model.body_inertia[i]) @ frame.T
        total += model.body_mass[i] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert np.diag(total)[:2] == pytest.approx([13.0, 11.6], rel=0.15)
    assert total[2, 2] == pytest.approx(1.28, rel=0.3)  # sensitive to how far the arms hang from the trunk
    assert centre[2] / body.stature == pytest.approx(0.56, abs=0.02)  # Winter (2009)


@pytest.mark.parametrize("body", PEOPLE)
def test_stands_on_the_ground_and_is_as_tall_as_it_says(body):
    ends = np.array(
        [
            [body.zero_positions[s.body] + s.start, body.zero_positions[s.body] + s.end]
            for s in body.segments.solids
        ]
    )
    radii = np.array([s.radius for s in body.segments.solids])
    assert (ends[..., 2].min(axis=1) - radii).min() == pytest.approx(0.0, abs=1e-9)
    assert (ends[..., 2].max(axis=1) + radii).max() == pytest.approx(body.stature, abs=1e-9)
    ankles = body.zero_positions[[BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]]
    assert (ankles[:, None] + body.sole)[..., 2] == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(body.sole[0, :, 0]) == pytest.approx(body.foot_length, rel=0.2)
    centre = (body.masses[:, None] * (body.zero_positions + body.segments.centres)).sum(axis=0) / body.mass
    assert body.sole[0, 0, 0] < centre[0] < body.sole[0, 3, 0]
    assert centre[1] == pytest.approx(0.0, abs=1e-9)
    assert 0.17 < body.radius < 0.33


def test_left_and_right_mirror_each_other():
    body = PEOPLE[0]
    left = [i for i, name in enumerate(BODY_NAMES) if name.startswith("L_")]
    right = [BODY_INDEX["R_" + BODY_NAMES[i][2:]] for i in left]
    assert np.array_equal(body.offsets[right], body.offsets[left] * [1, -1, 1])
    assert np.array_equal(body.masses[right], body.masses[left])
    limits = JOINT_LIMITS.reshape(23, 3, 2)
    flipped = -limits[np.array(right) - 1][..., ::-1]
    assert np.array_equal(limits[np.array(left) - 1][:, [0, 2]], flipped[:, [0, 2]])


def test_zero_pose_lies_within_the_limits():
    assert (JOINT_LIMITS[:, 0] < 0).all() and (JOINT_LIMITS[:, 1] > 0).all()


@pytest.mark.parametrize("stature", [1.5, 1.62, 1.8, 2.0])
@pytest.mark.parametrize("mass", [50.0, 77.0, 110.0])
@pytest.mark.parametrize("sex", [0.0, 0.3, 1.0])
def test_shape_for_is_the_inverse_of_describe(stature, mass, sex):
    body = describe(shape_for(stature, mass, sex))
    assert (body.stature, body.mass) == pytest.approx((stature, mass), rel=1e-9)
    assert body.male_fraction == pytest.approx(sex, abs=2e-6)


def test_population_is_seeded_varied_and_supported():
    shapes = sample_shapes(400, seed=3)
    assert np.array_equal(shapes, sample_shapes(400, seed=3))
    assert not np.array_equal(shapes, sample_shapes(400, seed=4))
    people = [describe(shape) for shape in shapes]
    stature = np.array([p.stature for p in people])
    male = np.array([p.male_fraction for p in people])
    assert ((stature >= STATURE_RANGE[0]) & (stature <= STATURE_RANGE[1])).all()
    assert all(MASS_RANGE[0] <= p.mass <= MASS_RANGE[1] for p in people)
    # ANSUR II means, which the supported range hardly bends.
    assert stature[male > 0.9].mean() == pytest.approx(1.756, abs=0.015)
    assert stature[male < 0.1].mean() == pytest.approx(1.628, abs=0.015)


@pytest.mark.parametrize(
    ("shape", "complaint"),
    [
        (np.zeros(9), "10 numbers"),
        (np.full(N_SHAPE, np.nan), "its sex is not"),
        ([0, 9, 0, 0, 0, 0, 0, 0, 0, 0], "stature must lie between 1.5 and 2 m"),
        ([0, 0, 9, 0, 0, 0, 0, 0, 0, 0], "mass must lie between 50 and 110 kg"),
    ],
)
def test_impossible_shapes_are_refused(shape, complaint):
    with pytest.raises(ShapeError, match=complaint):
        describe(shape)


def test_impossible_people_are_refused():
    with pytest.raises(ShapeError, match="stature"):
        shape_for(2.4, 80)
    with pytest.raises(ShapeError, match="male fraction"):
        shape_for(1.8, 80, 1.5)


@pytest.mark.parametrize("seed", range(3))
def test_forward_kinematics_agrees_with_mujoco(seed):
    body = PEOPLE[seed]
    model, data = model_of(body)
    rng = np.random.default_rng(seed)
    quaternions = rng.standard_normal((8, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    root = np.concatenate([rng.uniform(-5, 5, (8, 3)), quaternions], axis=1)
    joints = rng.uniform(-2, 2, (8, N_JOINTS))
    positions, rotations = forward_kinematics(body.offsets, root, joints)
    for k in range(8):
        data.qpos[:7], data.qpos[7:] = root[k], joints[k]
        mujoco.mj_kinematics(model, data)
        assert positions[k] == pytest.approx(data.xpos[1:], abs=1e-4)  # the XML keeps six digits
        assert rotations[k].reshape(24, 9) == pytest.approx(data.xmat[1:], abs=1e-9)


def test_signs_of_the_joints_are_as_documented():
    body = PEOPLE[0]
    root = [0, 0, body.pelvis_height, 1, 0, 0, 0]

    def place(name: str, **angles: float) -> np.ndarray:
        joints = arms_down()
        for joint, angle in angles.items():
            joints[JOINT_INDEX[joint]] = angle
        return forward_kinematics(body.offsets, root, joints)[0][BODY_INDEX[name]]

    assert place("L_Knee", L_Hip_y=-0.5)[0] > place("L_Knee")[0] + 0.1
    assert place("R_Ankle", R_Knee_y=0.5)[0] < place("R_Ankle")[0] - 0.1
    assert place("L_Toe", L_Ankle_y=-0.3)[2] > place("L_Toe")[2] + 0.02
    assert place("L_Wrist")[2] < place("L_Shoulder")[2] - 0.4
    assert place("L_Elbow", L_Shoulder_z=-0.5)[0] > place("L_Elbow")[0] + 0.1
    assert place("R_Elbow", R_Shoulder_z=0.5)[0] > place("R_Elbow")[0] + 0.1
    assert place("L_Wrist", L_Elbow_z=-0.5)[0] > place("L_Wrist")[0] + 0.1
    assert place("Head", Torso_y=0.3)[0] > place("Head")[0] + 0.1


def test_triplets_and_matrices_are_inverses():
    triplets = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 3))
    assert triplet_from_matrix(matrix_from_triplet(triplets)) == pytest.approx(triplets, abs=1e-12)


def test_rotation_vector_undoes_a_known_turn():
    rng = np.random.default_rng(1)
    before = rng.standard_normal((50, 4))
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    vector = rng.uniform(-1.7, 1.7, (50, 3))
    vector[0] = 0.0
    after = np.empty((50, 4))
    for i in range(50):
        turn = np.empty(4)
        angle = np.linalg.norm(vector[i])
        mujoco.mju_axisAngle2Quat(turn, vector[i] / max(angle, 1e-12), angle)
        mujoco.mju_mulQuat(after[i], turn, before[i])
    assert rotation_vector(-after, before) == pytest.approx(vector, abs=1e-9)
    turned = matrix_from_quaternion(after)
    assert np.linalg.det(turned) == pytest.approx(1.0)


@pytest.mark.parametrize(("actuation", "hinges"), [("full", 69), ("lite", 28)])
def test_mjcf_has_the_promised_joints_and_scaled_gains(actuation, hinges):
    light, heavy = (model_of(describe(shape_for(1.75, mass)), actuation)[0] for mass in (55.0, 110.0))
    assert (light.nu, light.nv, light.nbody) == (hinges, hinges + 6, 25)
    assert heavy.actuator_gainprm[:, 0] == pytest.approx(2 * light.actuator_gainprm[:, 0], rel=1e-4)
    assert heavy.actuator_forcerange == pytest.approx(2 * light.actuator_forcerange, rel=1e-4)
    assert light.jnt_range[1:] == pytest.approx(JOINT_LIMITS[actuated_joints(actuation)], abs=1e-5)
    assert LITE_JOINTS.sum() == 28


def test_unknown_actuation_is_refused():
    with pytest.raises(ValueError, match="'full' or 'lite'"):
        actuated_joints("half")  # type: ignore[arg-type]


def test_everybody_touches_everybody_else_and_nobody_themselves():
    masks = [agent_mask(i) for i in range(MAX_AGENTS)]
    contype = np.array([mask.contype for mask in masks])
    conaffinity = np.array([mask.conaffinity for mask in masks])
    touches = (contype[:, None] & conaffinity[None]) != 0
    assert np.array_equal(touches, ~np.eye(MAX_AGENTS, dtype=bool))
