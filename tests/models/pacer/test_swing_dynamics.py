import mujoco
import numpy as np
import pytest

from footfall.models.body import BODY_INDEX, JOINT_GAINS, JOINT_INDEX, describe, shape_for
from footfall.models.body.skeleton import GAIN_REFERENCE_MASS
from footfall.models.pacer.swing_dynamics import HINGES, SwingLegs, leg_angles

# pyright: reportAttributeAccessIssue=false


def _hanging_leg(body):
    """MuJoCo's model of the body's left leg below a fixed hip, with hinges about y only."""
    spec = mujoco.MjSpec()
    parent = spec.worldbody
    for name in ("L_Hip", "L_Knee", "L_Ankle", "L_Toe"):
        i = BODY_INDEX[name]
        parent = parent.add_body(
            name=name,
            pos=np.zeros(3) if name == "L_Hip" else body.offsets[i],
            mass=body.masses[i],
            ipos=body.segments.centres[i],
            inertia=body.segments.inertias[i],
            explicitinertial=True,
        )
        if name in ("L_Hip", "L_Knee"):
            parent.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
    return spec.compile()


@pytest.mark.parametrize("stature, mass", [(1.55, 50.0), (1.9, 105.0)])
def test_shifts_are_the_torques_of_inverse_dynamics_by_the_drives_stiffness(stature, mass):
    body = describe(shape_for(stature, mass))
    model = _hanging_leg(body)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[:] = rng.uniform([-0.9, 0.1], [0.3, 1.2])
        data.qvel[:] = rng.uniform(-4, 4, 2)
        data.qacc[:] = rng.uniform(-20, 20, 2)
        mujoco.mj_inverse(model, data)
        wanted = data.qfrc_inverse / (JOINT_GAINS[HINGES[:2], 0] * mass / GAIN_REFERENCE_MASS)
        both = [-np.cumsum(v)[None].repeat(2, 0)[None] for v in (data.qpos, data.qvel, data.qacc)]
        found = SwingLegs([body]).shifts(*both)[0, 0]
        # The model is planar: knees and centres of mass a little off the thigh's line are left out.
        assert found == pytest.approx(np.clip(wanted, -0.5, 0.5), abs=0.03)


def test_leg_angles_are_those_of_the_bones_from_the_vertical():
    joints = np.zeros((1, 69))
    joints[0, JOINT_INDEX["L_Hip_y"]], joints[0, JOINT_INDEX["L_Knee_y"]] = -0.5, 0.8
    root = np.array([[0.0, 0.0, 1.0, np.cos(0.05), 0.0, np.sin(0.05), 0.0]])  # leans 0.1 rad forward
    assert leg_angles(root, joints)[0] == pytest.approx(np.array([[0.4, -0.4], [-0.1, -0.1]]))


def test_people_leave_and_join():
    small, tall = (SwingLegs([describe(shape_for(s, m))]) for s, m in ((1.5, 50.0), (2.0, 100.0)))
    state = [np.full((2, 2, 2), v) for v in (0.3, 1.0, 10.0)]
    alone = [legs.shifts(*(v[:1] for v in state)) for legs in (small, tall)]
    small.join(tall)
    both = small.shifts(*state)
    assert both == pytest.approx(np.concatenate(alone))
    small.keep(np.array([1]))
    assert small.shifts(*(v[:1] for v in state)) == pytest.approx(alone[1])
