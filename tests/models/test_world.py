"""The crowd world against rigid-body mechanics and plain geometry."""

import mujoco
import numpy as np
import pytest

from footfall.models.body import (
    BODY_INDEX,
    FOOT_BODIES,
    JOINT_INDEX,
    N_JOINTS,
    describe,
    forward_kinematics,
    sample_shapes,
    shape_for,
)
from footfall.models.body.rotations import matrix_from_quaternion
from footfall.models.body.skeleton import LITE_JOINTS
from footfall.models.crowd.convex_obstacles import ObstacleError
from footfall.models.scene import Obstacle, Terrain
from footfall.models.world import World, WorldError, crowd_model
from footfall.models.world.contacts import GROUND, NOBODY

# pyright: reportAttributeAccessIssue=false

PEOPLE = [describe(shape) for shape in sample_shapes(4, seed=11)]
DT = 1 / 30
GRAVITY = 9.81


def block(polygon, height=2.0):
    return Obstacle(name="block", polygon=np.asarray(polygon, dtype=float), height=height)


def arms_down() -> np.ndarray:
    joints = np.zeros(N_JOINTS)
    joints[JOINT_INDEX["L_Shoulder_x"]] = -1.4
    joints[JOINT_INDEX["R_Shoulder_x"]] = 1.4
    return joints


def root_at(x, y, body, z=0.0, yaw=0.0):
    return np.array([x, y, z + body.pelvis_height, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])


def square(x, y, half=0.5):
    return np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])


def momentum(world, agent):
    """Linear momentum (3,) of a person from the states of the bodies."""
    body = world.bodies[agent]
    state = world.joint_states([agent])[0].astype(float)
    lever = (matrix_from_quaternion(state[:, 3:7]) @ body.segments.centres[..., None])[..., 0]
    return body.masses @ (state[:, 7:10] + np.cross(state[:, 10:13], lever))


@pytest.mark.parametrize("mode", ["kinematic", "physics"])
def test_states_on_entry_are_forward_kinematics_and_its_derivative(mode):
    rng = np.random.default_rng(0)
    world = World(PEOPLE, mode=mode)
    joints, rates = rng.uniform(-1, 1, (2, N_JOINTS))
    turn = rng.standard_normal(4)
    root = np.concatenate([[1.0, 2.0, 30.0], turn / np.linalg.norm(turn)])
    twist = rng.uniform(-1, 1, 6)
    world.enter(2, root, joints, twist, rates)
    state = world.joint_states([2])[0]
    assert state.shape == (24, 13) and state.dtype == np.float32

    h = 1e-5
    later = root.copy()
    later[:3] += h * twist[:3]
    spin = np.empty(4)
    angle = np.linalg.norm(twist[3:])
    mujoco.mju_axisAngle2Quat(spin, twist[3:] / angle, h * angle)
    mujoco.mju_mulQuat(later[3:], spin, root[3:])
    positions, rotations = forward_kinematics(PEOPLE[2].offsets, root, joints)
    moved, turned = forward_kinematics(PEOPLE[2].offsets, later, joints + h * rates)
    assert state[:, :3] == pytest.approx(positions, abs=1e-5)
    assert matrix_from_quaternion(state[:, 3:7]) == pytest.approx(rotations, abs=1e-6)
    assert state[:, 7:10] == pytest.approx((moved - positions) / h, abs=1e-3)
    skew = (turned - rotations) / h @ np.swapaxes(rotations, -1, -2)
    omega = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    assert state[:, 10:13] == pytest.approx(omega, abs=1e-3)


def test_kinematic_velocities_of_someone_carried_and_turned():
    world = World(PEOPLE[:1])
    body, joints = PEOPLE[0], arms_down()
    world.enter(0, root_at(0, 0, body), joints)
    assert not world.joint_states([0])[0, :, 7:].any()
    velocity, spin = np.array([1.2, -0.3, 0.0]), 0.6
    for k in range(1, 4):
        world.set_pose(
            [0], [root_at(velocity[0] * k * DT, velocity[1] * k * DT, body, yaw=spin * k * DT)], joints[None]
        )
        world.advance(DT)
    state = world.joint_states([0])[0].astype(float)
    middle = np.array([np.cos(-spin * DT / 2), np.sin(-spin * DT / 2)])  # exact half a step ago
    lever = state[:, :3] - state[0, :3]
    arm = lever[:, :2] @ np.array([[middle[0], middle[1]], [-middle[1], middle[0]]])
    expected = velocity[:2] + spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    assert state[:, 7:9] == pytest.approx(expected, abs=1e-3)
    assert state[:, 10:13] == pytest.approx(np.tile([0, 0, spin], (24, 1)), abs=1e-4)
    assert world.joint_angles([0])[0][0] == pytest.approx(joints)


def test_joint_velocities_of_a_kinematic_world_are_differences():
    world = World(PEOPLE[:1])
    world.enter(0, root_at(0, 0, PEOPLE[0]), np.zeros(N_JOINTS))
    world.set_pose([0], [root_at(0, 0, PEOPLE[0])], [arms_down()])
    world.advance(0.1)
    assert world.joint_angles([0])[1][0] == pytest.approx(arms_down() / 0.1)


def test_nobody_touches_themselves():
    rng = np.random.default_rng(5)
    world = World(PEOPLE[:1])
    world.enter(0, root_at(0, 0, PEOPLE[0], z=20), np.zeros(N_JOINTS))
    for _ in range(20):
        world.set_pose([0], [root_at(0, 0, PEOPLE[0], z=20)], [rng.uniform(-2, 2, N_JOINTS)])
        world.advance(DT)
        assert len(world.contacts()) == 0


def test_two_people_touch_once_they_overlap():
    world = World(PEOPLE[:2])
    joints = arms_down()
    world.enter(0, root_at(0, 0, PEOPLE[0], z=5), joints)
    world.enter(1, root_at(3, 0, PEOPLE[1], z=5), joints)
    world.advance(DT)
    assert len(world.contacts()) == 0
    world.set_pose([1], [root_at(0.15, 0, PEOPLE[1], z=5)], [joints])
    world.advance(DT)
    touch = world.contacts()
    assert len(touch) > 3
    assert (touch.agent == 0).all() and (touch.other == 1).all()
    assert (touch.distance < 0).all() and not touch.force.any()
    chest = touch.select((touch.part == BODY_INDEX["Chest"]) & (touch.other_part == BODY_INDEX["Chest"]))
    assert chest.normal[:, 0] == pytest.approx(-1.0, abs=0.3)  # from the other towards the person
    world.leave(1)
    assert len(world.contacts()) == 0
    world.advance(DT)
    assert len(world.contacts()) == 0


def test_a_wall_stops_whoever_stands_in_it_and_says_where():
    wall = block(square(0.75, 0.0), height=3.0)
    world = World(PEOPLE[:1], [block(square(50, 50)), wall])
    world.enter(0, root_at(0.2, 0, PEOPLE[0]), arms_down())
    world.advance(DT)
    touch = world.contacts()
    hit = touch.select(touch.other_part == 1)
    assert len(hit) > 2 and (hit.other == NOBODY).all()
    assert (hit.normal @ [-1.0, 0.0, 0.0] > 0.9).any()
    world.set_obstacle(1, False)
    world.advance(DT)
    assert not (world.contacts().other_part == 1).any()
    world.set_obstacle(1, True)
    world.advance(DT)
    assert (world.contacts().other_part == 1).any()


def test_a_non_convex_obstacle_leaves_its_notch_free():
    corner = block(np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 4], [0, 4]], dtype=float))
    world = World(PEOPLE[:1], [corner])
    joints = arms_down()

    def touches(x, y):
        world.set_pose([0], [root_at(x, y, PEOPLE[0])], [joints])
        world.advance(DT)
        return bool((world.contacts().other_part == 0).any())

    world.enter(0, root_at(9, 9, PEOPLE[0]), joints)
    assert not touches(2.2, 2.2)
    assert touches(3.0, 0.5)
    assert touches(0.5, 3.0)
    assert not touches(-1.5, 2.0)


def test_a_wall_without_thickness_is_solid():
    world = World(PEOPLE[:1], [block(np.array([[-2.0, 0.0], [2.0, 0.0]]))])
    world.enter(0, root_at(0, 0, PEOPLE[0]), arms_down())
    world.advance(DT)
    assert (world.contacts().other_part == 0).any()


def test_terrain_carries_the_feet():
    rows, columns = 40, 60
    x = np.arange(columns) * 0.1 - 1.0
    heights = np.tile(np.clip(x, 0, 2) * 0.2, (rows, 1)).astype(np.float32)  # a ramp along x, then a plateau
    terrain = Terrain(heights, 0.1, (-1.0, -2.0))
    world = World(PEOPLE[:1], terrain=terrain)
    assert world.height_at([[0.5, 0.0], [3.5, 1.0]]) == pytest.approx([0.1, 0.4], abs=1e-6)
    body = PEOPLE[0]
    world.enter(0, root_at(3.5, 0.0, body, z=0.4 - 0.005), arms_down())
    world.advance(DT)
    touch = world.contacts()
    assert set(touch.part) <= set(FOOT_BODIES) and len(touch) >= 10
    assert (touch.other_part == GROUND).all()
    lowest = [touch.distance[touch.part == part].min() for part in FOOT_BODIES]
    assert lowest == pytest.approx([-0.005] * 4, abs=1e-4)
    assert touch.position[:, 2] == pytest.approx(0.3975, abs=3e-3)
    assert not world.fallen([0])[0]


def test_someone_in_the_air_falls_as_everything_does():
    world = World(PEOPLE[:1], mode="physics")
    world.enter(0, root_at(0, 0, PEOPLE[0], z=50), np.zeros(N_JOINTS), root_velocity=[1.0, 0, 2.0, 0, 0, 0])
    for _ in range(15):
        world.advance(DT)
    expected = PEOPLE[0].mass * np.array([1.0, 0.0, 2.0 - GRAVITY * 0.5])
    assert momentum(world, 0) == pytest.approx(expected, rel=2e-3, abs=0.05)


@pytest.mark.parametrize("actuation", ["full", "lite"])
def test_a_push_gives_its_impulse(actuation):
    world = World(PEOPLE[:1], mode="physics", actuation=actuation)
    world.enter(0, root_at(0, 0, PEOPLE[0], z=50), arms_down())
    world.push(0, [300.0, -100.0, 0.0], 0.1)
    for _ in range(6):
        world.advance(DT)
    assert momentum(world, 0)[:2] == pytest.approx([30.0, -10.0], rel=0.01)
    world.push(0, [300.0, 0.0, 0.0], 10.0)
    world.leave(0)
    world.enter(0, root_at(0, 0, PEOPLE[0], z=50), arms_down())
    world.advance(DT)
    assert momentum(world, 0)[:2] == pytest.approx([0.0, 0.0], abs=0.05)  # leaving ends a push


@pytest.mark.parametrize("actuation", ["full", "lite"])
def test_whoever_lies_is_fallen_and_presses_with_their_weight(actuation):
    world = World(PEOPLE[:1], mode="physics", actuation=actuation)
    world.enter(0, root_at(0, 0, PEOPLE[0]), arms_down())
    world.advance(DT)
    assert not world.fallen([0])[0]
    for _ in range(240):
        world.advance(DT)
    assert world.fallen([0])[0]
    touch = world.contacts()
    assert (touch.other_part == GROUND).all()
    assert touch.force.sum() == pytest.approx(PEOPLE[0].mass * GRAVITY, rel=0.03)
    assert touch.normal @ [0, 0, 1] == pytest.approx(1.0)


def test_lying_is_a_fall_at_once():
    world = World(PEOPLE[:1], mode="physics")
    world.enter(0, [0, 0, 0.25, np.sqrt(0.5), 0, np.sqrt(0.5), 0], arms_down())
    assert world.fallen([0])[0]


def test_a_thigh_that_carries_weight_is_a_fall_however_high():
    body = PEOPLE[0]
    hip, thigh = body.measurements.hip_height, body.segments.thickness[BODY_INDEX["L_Hip"]]
    columns = np.arange(41) * 0.05 - 1.0
    ledge = np.where(columns > 0.2, hip - thigh - 0.01, 0.0)
    world = World([body], terrain=Terrain(np.tile(ledge, (41, 1)), 0.05, (-1.0, -1.0)), mode="physics")
    sitting = arms_down()
    sitting[[JOINT_INDEX["L_Hip_y"], JOINT_INDEX["R_Hip_y"]]] = -np.pi / 2
    world.enter(0, root_at(0, 0, body, z=0.5), sitting)
    world.advance(DT)
    assert not world.fallen([0])[0]
    world.leave(0)
    world.enter(0, root_at(0, 0, body), sitting)
    for _ in range(3):
        world.advance(DT)
    height = world.joint_states([0])[0, [BODY_INDEX["Pelvis"], BODY_INDEX["Head"]], 2]
    assert (height > 0.8 * np.array([body.pelvis_height, body.measurements.head_height])).all()
    assert world.fallen([0])[0]


def test_targets_move_the_joints():
    world = World(PEOPLE[:1], mode="physics")
    world.enter(0, root_at(0, 0, PEOPLE[0], z=200), np.zeros(N_JOINTS))
    world.set_targets([0], arms_down()[None])
    for _ in range(45):
        world.advance(DT)
    angles, rates = world.joint_angles([0])
    assert angles[0] == pytest.approx(arms_down(), abs=0.03)
    assert abs(rates).max() < 0.3


def test_lite_and_full_share_one_layout():
    world = World(PEOPLE[:1], mode="physics", actuation="lite")
    world.enter(0, root_at(0, 0, PEOPLE[0], z=50), np.full(N_JOINTS, 0.2))
    world.set_targets([0], np.full((1, N_JOINTS), 0.3))
    world.advance(DT)
    angles, rates = world.joint_angles([0])
    assert angles.shape == rates.shape == (1, N_JOINTS)
    assert not angles[0, ~LITE_JOINTS].any() and (abs(angles[0, LITE_JOINTS]) > 0.05).all()


def scripted(world):
    rng = np.random.default_rng(3)
    log = []
    for step in range(45):
        if step in (0, 20):
            world.enter(0, root_at(0, 0, PEOPLE[0]), arms_down())
            world.enter(1, root_at(0.3, 0.2, PEOPLE[1]), arms_down())
        if step == 15:
            world.leave(0)
            world.leave(1)
        there = np.flatnonzero(world.present)
        if world.mode == "physics":
            world.set_targets(there, rng.uniform(-1, 1, (len(there), N_JOINTS)))
        world.advance(DT)
        log += [world.joint_states(there).tobytes(), world.contacts().force.tobytes()]
    return log


@pytest.mark.parametrize("mode", ["kinematic", "physics"])
def test_the_same_calls_give_the_same_bytes(mode):
    assert scripted(World(PEOPLE, mode=mode)) == scripted(World(PEOPLE, mode=mode))


def test_a_second_thread_gives_the_same_bytes(monkeypatch):
    alone = scripted(World(PEOPLE, mode="physics"))
    monkeypatch.setattr(crowd_model, "_CROWDED", 1)
    monkeypatch.setattr(crowd_model.os, "cpu_count", lambda: 2)
    world = World(PEOPLE, mode="physics")
    assert scripted(world) == alone and world._crowd.data.threadpool


def test_the_absent_change_nothing():
    """Who never enters, or has left, leaves no trace in the others' motion."""
    alone = World(PEOPLE[:1], mode="physics")
    crowd = World(PEOPLE, mode="physics")
    for world in (alone, crowd):
        world.enter(0, root_at(0, 0, PEOPLE[0]), arms_down())
    crowd.enter(3, root_at(8, 0, PEOPLE[3]), arms_down())
    for step in range(60):
        if step == 10:
            crowd.leave(3)
        alone.advance(DT)
        crowd.advance(DT)
    assert crowd.joint_states([0]) == pytest.approx(alone.joint_states([0]), abs=1e-4)
    assert (crowd._crowd.data.tree_asleep[1:] >= 0).all()


def test_sparse_and_dense_solvers_agree():
    """Guards against a solver that factors sparse Hessians wrongly."""
    world = World(PEOPLE, mode="physics")
    for i, body in enumerate(PEOPLE):
        world.enter(i, root_at(0.3 * i, 0, body), arms_down())
    for _ in range(20):
        world.advance(DT)
    model, data = world._crowd.model, world._crowd.data
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    accelerations = []
    for jacobian in (mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE):
        model.opt.jacobian = jacobian
        data.qacc_warmstart[:] = 0
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc.copy())
    assert data.ncon > 10
    assert accelerations[0] == pytest.approx(accelerations[1], rel=1e-4, abs=1e-3)


def test_mistakes_are_named():
    body = PEOPLE[0]
    world = World(PEOPLE)
    root, joints = root_at(0, 0, body), arms_down()
    world.enter(0, root, joints)
    for call, complaint in [
        (lambda: world.enter(0, root, joints), "already in the world"),
        (lambda: world.enter(9, root, joints), "no person 9"),
        (lambda: world.enter(1, root[:6], joints), "root has shape"),
        (lambda: world.enter(1, root * 2, joints), "unit quaternion"),
        (lambda: world.enter(1, root, joints[:5]), "joints has shape"),
        (lambda: world.enter(1, root, joints * np.nan), "not finite"),
        (lambda: world.leave(1), "not in the world"),
        (lambda: world.set_pose([0, 2], [root, root], [joints, joints]), "Person 2 is not"),
        (lambda: world.set_pose([0, 0], [root, root], [joints, joints]), "twice"),
        (lambda: world.joint_states([0.5]), "list of integers"),
        (lambda: world.set_targets([0], [joints]), "needs a physics world"),
        (lambda: world.push(0, [1, 0, 0], 0.1), "kinematic"),
        (lambda: world.set_obstacle(0, True), "no obstacle 0"),
        (lambda: world.advance(0.0), "positive"),
        (lambda: World([]), "1 to 1024"),
        (lambda: World(PEOPLE, timestep=0.0), "must be positive"),
        (lambda: World(PEOPLE, mode="magic"), "'magic'"),  # type: ignore[arg-type]
    ]:
        with pytest.raises(WorldError, match=complaint):
            call()
    with pytest.raises(ObstacleError, match="obstacle 0"):
        World(PEOPLE, [block(np.array([[0, 0], [1, 1], [1, 0], [0, 1]], dtype=float))])
    physics = World(PEOPLE, mode="physics")
    with pytest.raises(WorldError, match="whole number"):
        physics.advance(0.01)
    physics.enter(0, root, joints)
    with pytest.raises(WorldError, match="no body part 'Tail'"):
        physics.push(0, [1, 0, 0], DT, part="Tail")
    with pytest.raises(WorldError, match="needs a kinematic world"):
        physics.set_pose([0], [root], [joints])


@pytest.mark.parametrize("actuation", ["full", "lite"])
def test_wild_targets_stay_stable(actuation):
    """Random targets over the whole range of every joint, for light, ordinary and heavy people."""
    people = [describe(shape_for(*size)) for size in ((1.5, 50.0), (1.75, 75.0), (2.0, 110.0))]
    world = World(people, mode="physics", actuation=actuation)
    for i, body in enumerate(people):
        world.enter(i, root_at(3.0 * i, 0, body), arms_down())
    rng = np.random.default_rng(2)
    fastest = 0.0
    for _ in range(90):
        world.set_targets([0, 1, 2], rng.uniform(-2, 2, (3, N_JOINTS)))
        world.advance(DT)
        fastest = max(fastest, float(abs(world.joint_states([0, 1, 2])[..., 10:13]).max()))
    assert fastest < 60.0  # rad/s


@pytest.mark.parametrize("seed", [1, 5])
def test_a_heap_of_wild_people_does_not_explode(seed):
    """Twelve people in each other's way with random targets; then they come to rest, all still there."""
    people = [describe(shape_for(1.5 + 0.04 * i, 50.0 + 5.0 * i)) for i in range(12)]
    ids = list(range(12))
    world = World(people, mode="physics", actuation="lite")
    for i, body in enumerate(people):
        world.enter(i, root_at(0.7 * (i % 4), 0.7 * (i // 4), body), arms_down())
    rng = np.random.default_rng(seed)
    for _ in range(150):
        world.set_targets(ids, rng.uniform(-2, 2, (12, N_JOINTS)))
        world.advance(DT)
    for _ in range(90):
        world.set_targets(ids, np.zeros((12, N_JOINTS)))
        world.advance(DT)
    states = world.joint_states(ids)
    assert abs(states[..., 10:13]).max() < 5.0  # rad/s
    assert abs(states[..., :2]).max() < 20.0  # m
