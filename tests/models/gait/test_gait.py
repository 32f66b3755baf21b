"""The kinematic walk, judged by forward kinematics of what it puts out."""

import numpy as np
import pytest

from footfall.models.body import (
    BODY_INDEX,
    JOINT_INDEX,
    JOINT_LIMITS,
    JOINT_NAMES,
    describe,
    forward_kinematics,
    sample_shapes,
    shape_for,
)
from footfall.models.gait import Command, Gait, GaitError, flat_ground, footholds, pose

DT = 1.0 / 30.0
ANKLES = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
TOES = [BODY_INDEX["L_Toe"], BODY_INDEX["R_Toe"]]
ADULT = describe(shape_for(1.75, 75.0))


def stairs(xy, rise=0.17, run=0.31):
    return rise * np.clip(np.floor((xy[:, 0] - 2.0) / run), 0.0, 10.0)


GROUNDS = {
    "flat": flat_ground,
    "stairs up": stairs,
    "stairs down": lambda xy: -stairs(xy),
    "uphill": lambda xy: 0.2 * xy[:, 0],
    "downhill": lambda xy: -0.2 * xy[:, 0],
    "cross slope": lambda xy: 0.15 * xy[:, 1],
    "waves": lambda xy: 0.1 * np.sin(1.5 * xy[:, 0]) * np.cos(xy[:, 1]),
}


def course(name, speed, duration=8.0, dt=DT):
    """Positions, headings, speeds and turn rates of a unicycle."""
    t = np.arange(round(duration / dt)) * dt
    v = np.full_like(t, speed)
    turn = np.zeros_like(t)
    if name == "turn":
        turn += 0.7
    elif name == "slalom":
        turn = 1.2 * np.sin(2.0 * t)
        v = speed * (1.0 + 0.4 * np.sin(1.3 * t))
    elif name == "stop and go":
        v = speed * np.interp(t, [0.0, 0.5, 1.5, 4.0, 5.0, 8.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    elif name == "jerk":
        v = np.where((t > 1.0) & (t < 4.0), speed, 0.0)
    elif name == "spin":
        v[:] = 0.0
        turn = np.where((t > 1.0) & (t < 4.0), 1.2, 0.0)
    elif name == "faster":
        v = np.interp(t, [0.0, 8.0], [0.3, 2.0])
    heading = np.concatenate([[0.0], np.cumsum(turn)[:-1] * dt])
    step = v[:, None] * dt * np.stack([np.cos(heading), np.sin(heading)], -1)
    return np.cumsum(step, 0), heading, v, turn


class Walk:
    """A walker's poses along a course, and the world positions of its ankles and soles."""

    def __init__(self, body, plan, ground, root, joints, states):
        self.plan, self.root, self.joints, self.states = plan, root, joints, states
        self.positions, rotations = forward_kinematics(body.offsets, root, joints)
        soles = []
        for side in range(2):
            ankle, toe = ANKLES[side], TOES[side]
            rear = np.einsum("tij,kj->tki", rotations[:, ankle], body.sole[side, :4])
            tip = rotations[:, toe] @ (body.sole[side, 4] - body.offsets[toe])
            parts = (self.positions[:, ankle, None] + rear, (self.positions[:, toe] + tip)[:, None])
            soles.append(np.concatenate(parts, 1))
        self.soles = np.stack(soles, 1)  # (t, 2, 5, 3)
        flat = self.soles[..., :2].reshape(-1, 2)
        self.clearance = self.soles[..., 2] - ground(flat).reshape(self.soles.shape[:-1])

    def slip(self):
        """Speeds, m/s, of the stillest sole point of each foot while one of them is on the ground."""
        speed = np.linalg.norm(np.diff(self.soles, axis=0), axis=-1) / DT
        down = self.clearance.min(-1) < 0.004
        return speed.min(-1)[down[1:] & down[:-1]]

    def flat_places(self, side):
        """Ankle places (m, 2) of the stances, from frames with the whole sole on the ground."""
        flat = np.flatnonzero((self.clearance[:, side, :4] < 0.002).all(-1))
        groups = np.split(flat, np.flatnonzero(np.diff(flat) > 1) + 1)
        return np.array([self.positions[g, ANKLES[side], :2].mean(0) for g in groups])


LANE = 1000.0  # m between the lanes in which walkers of one gait walk on grounds of their own


def walks(courses, duration=8.0, bodies=None, dt=DT):
    """Walk several courses (name, speed, ground) at once and return a Walk of each."""
    bodies = bodies or [ADULT] * len(courses)
    grounds = [GROUNDS[ground] for _, _, ground in courses]
    plans = [course(name, speed, duration, dt) for name, speed, _ in courses]
    position, heading, speed, turn = (np.stack(part, 1) for part in zip(*plans, strict=True))  # (t, n, ...)
    origin = np.stack([np.zeros(len(courses)), LANE * np.arange(len(courses))], -1)

    def height_at(xy):
        lane = np.round(xy[:, 1] / LANE).astype(int)
        height = np.empty(len(xy))
        for k in np.unique(lane):
            height[lane == k] = grounds[k](xy[lane == k] - origin[k])
        return height

    gait = Gait(height_at)
    start = position[0] + origin - speed[:1].T * [[dt, 0.0]]
    gait.enter(range(len(courses)), bodies, start, heading[0], speed[0])
    roots, joints, states = [], [], []
    for at, facing, v, w in zip(position + origin, heading, speed, turn, strict=True):
        root, joint = gait.update(Command(at, facing, v, w), dt)
        root[:, :2] -= origin
        roots.append(root)
        joints.append(joint)
        states.append(gait.state.copy())
    roots, joints, states = np.stack(roots, 1), np.stack(joints, 1), np.stack(states, 1)
    return [
        Walk(bodies[k], position[:, k], grounds[k], roots[k], joints[k], states[k])
        for k in range(len(courses))
    ]


PATHS = [
    *[("line", v, "flat") for v in (0.3, 0.6, 1.0, 1.4, 1.7, 2.0)],
    *[(name, 1.4, "flat") for name in ("turn", "slalom", "stop and go", "jerk", "spin", "faster")],
    *[("line", 0.7, name) for name in ("stairs up", "stairs down")],
    *[("line", 1.2, name) for name in ("uphill", "downhill", "cross slope", "waves")],
    ("turn", 1.2, "uphill"),
    ("stop and go", 1.0, "downhill"),
]
NAMES = [" ".join(map(str, path)) for path in PATHS]


@pytest.fixture(scope="module")
def all_walks():
    return dict(zip(NAMES, walks(PATHS), strict=True))


@pytest.fixture(params=NAMES)
def walk(request, all_walks):
    return all_walks[request.param]


@pytest.fixture(scope="module")
def steady():
    """Long straight walks on the flat, by speed."""
    speeds = (0.6, 1.0, 1.37, 1.4, 1.7, 2.0, 3.0)
    return dict(zip(speeds, walks([("line", v, "flat") for v in speeds], duration=14.0), strict=True))


def test_feet_on_the_ground_stand_still(walk):
    slip = walk.slip()
    assert len(slip) > 100
    assert slip.mean() <= 0.02


def test_feet_do_not_sink_into_the_ground(walk):
    assert walk.clearance.min() > -0.025


def test_root_follows_the_plan(walk):
    error = np.linalg.norm(walk.root[:, :2] - walk.plan, axis=1)
    assert error.mean() <= 0.02
    assert error.max() <= 0.03


def test_motion_has_no_jumps(walk):
    assert np.abs(np.diff(walk.root[:, 2])).max() / DT < 1.7
    assert np.abs(np.diff(walk.joints, axis=0)).max() / DT < 27.0  # rad/s


def test_joints_stay_within_limits_unclipped_but_for_single_frames(walk):
    low, high = JOINT_LIMITS.T
    assert (walk.joints >= low - 1e-12).all() and (walk.joints <= high + 1e-12).all()
    at_limit = np.isclose(walk.joints, low, atol=1e-9) | np.isclose(walk.joints, high, atol=1e-9)
    assert at_limit.any(1).mean() < 0.03, [JOINT_NAMES[i] for i in np.flatnonzero(at_limit.any(0))]


def test_quaternions_are_unit(walk):
    np.testing.assert_allclose(np.linalg.norm(walk.root[:, 3:], axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("speed", [0.6, 1.0, 1.4, 1.7, 2.0])
def test_cadence_and_step_length_follow_grieve_and_gear(steady, speed):
    """Strides a minute of adults: 64.8 (speed / stature)^0.57 (Grieve & Gear 1966)."""
    walk = steady[speed]
    for side in range(2):
        strides = np.diff(walk.flat_places(side)[1:-1, 0])
        assert len(strides) >= 5
        cadence = speed / strides.mean() * 60.0
        norm = 64.8 * (speed / ADULT.stature) ** 0.57
        assert cadence == pytest.approx(norm, rel=0.15)
        assert strides.mean() == pytest.approx(speed * 60.0 / norm, rel=0.15)


def test_free_walk_has_perrys_stride(steady):
    """Adults at 1.37 m/s: stride 1.41 m (Perry 1992, table 1-2)."""
    strides = np.diff(steady[1.37].flat_places(0)[1:-1, 0])
    assert strides.mean() == pytest.approx(1.41, rel=0.15)


def test_double_support_falls_with_speed(steady):
    shares = []
    for speed in (0.6, 1.0, 1.4, 2.0):
        walk = steady[speed]
        moving = np.linalg.norm(np.diff(walk.soles, axis=0), axis=-1).min(-1) / DT > 0.1
        shares.append(1.0 - moving.any(1).mean())
    assert shares == sorted(shares, reverse=True)
    assert 0.15 < shares[2] < 0.30  # two double supports of 10-12 % at a free pace (Perry)


def test_a_jog_leaves_the_ground(steady):
    walk = steady[3.0]
    assert (walk.clearance.min((1, 2)) > 0.02).mean() > 0.05
    assert walk.slip().mean() < 0.03


def test_left_and_right_are_mirror_images(steady):
    """Half a stride later the right side does what the left side did, mirrored."""
    walk = steady[1.4]
    phase, settled = walk.states["phase"], slice(90, None)
    grid = np.linspace(0.0, 1.0, 41)[:-1]

    def curve(joint, shift):
        angle = walk.joints[settled, JOINT_INDEX[joint]]
        at = (phase[settled] + shift) % 1.0
        order = np.argsort(at)
        return np.interp(grid, at[order], angle[order], period=1.0)

    for joint, sign in (("Hip_y", 1), ("Knee_y", 1), ("Ankle_y", 1), ("Hip_x", -1), ("Shoulder_z", -1)):
        np.testing.assert_allclose(curve(f"L_{joint}", 0.0), sign * curve(f"R_{joint}", 0.5), atol=0.03)


def test_arms_swing_against_the_legs(steady):
    walk = steady[1.4]
    arm = -walk.joints[60:, JOINT_INDEX["L_Shoulder_z"]]
    leg = -walk.joints[60:, JOINT_INDEX["L_Hip_y"]]
    assert np.corrcoef(arm, leg)[0, 1] < -0.6
    other = -walk.joints[60:, JOINT_INDEX["R_Hip_y"]]
    assert np.corrcoef(arm, other)[0, 1] > 0.6


def test_joint_angles_resemble_normal_gait(steady):
    """Knee bends about 60 deg in swing and the ankle pushes off about 20 deg (Perry 1992, chs. 4-5)."""
    walk = steady[1.37]
    knee = np.degrees(walk.joints[60:, JOINT_INDEX["L_Knee_y"]])
    ankle = np.degrees(walk.joints[60:, JOINT_INDEX["L_Ankle_y"]])
    hip = np.degrees(-walk.joints[60:, JOINT_INDEX["L_Hip_y"]])
    assert 50.0 < knee.max() < 72.0 and knee.min() < 15.0
    assert 10.0 < ankle.max() < 30.0 or 10.0 < -ankle.min() < 30.0
    assert 25.0 < hip.max() < 45.0 and -20.0 < hip.min() < -5.0
    excursion = np.ptp(walk.root[60:, 2])
    assert 0.03 < excursion < 0.065  # about 0.05 m (Perry)


def test_standing_stays_put_for_a_minute():
    walk = walks([("stand", 0.0, "flat")], duration=60.0, dt=0.1)[0]
    for side in range(2):
        np.testing.assert_allclose(np.ptp(walk.positions[:, ANKLES[side]], axis=0), 0.0, atol=1e-6)
    assert np.ptp(walk.root[:, :2], axis=0).max() < 0.03
    assert np.abs(walk.joints[:, JOINT_INDEX["L_Knee_y"]]).max() < 0.4
    assert np.ptp(walk.joints[:, JOINT_INDEX["Chest_y"]]) > 0.005  # breathing


def test_a_stopped_walker_brings_its_feet_together_and_rests(all_walks):
    walk = all_walks["stop and go 1.4 flat"]
    assert walk.states["held"][-1]
    feet = walk.positions[-1, ANKLES, :2]
    apart = feet[0] - feet[1]
    assert abs(apart[0]) < 0.06 and 0.08 < apart[1] < 0.25
    stopped = np.linalg.norm(np.diff(walk.positions[:, ANKLES], axis=0), axis=-1).max(-1) / DT > 0.05
    last_move = np.flatnonzero(stopped).max() * DT
    assert last_move < 5.0 + 1.6  # the plan stands from 5 s on: two small steps at most


def test_turning_on_the_spot_turns_the_feet(all_walks):
    walk = all_walks["spin 1.4 flat"]
    heading = course("spin", 1.4)[1][-1]
    assert heading > 3.0
    np.testing.assert_allclose(walk.states["place"][-1, :, 3] - heading, [0.1, -0.1], atol=0.2)


def test_the_same_calls_give_the_same_bytes():
    first, second = (walks([("slalom", 1.2, "waves")], duration=3.0)[0] for _ in range(2))
    assert first.root.tobytes() == second.root.tobytes()
    assert first.joints.tobytes() == second.joints.tobytes()


def crowd(count, ground=flat_ground):
    bodies = [describe(shape) for shape in sample_shapes(count, seed=5)]
    rng = np.random.default_rng(6)
    position, heading = rng.uniform(-10, 10, (count, 2)), rng.uniform(-3, 3, count)
    gait = Gait(ground)
    gait.enter(list(range(count)), bodies, position, heading, np.full(count, 1.2))
    return gait, bodies, position, heading


def test_a_copy_lives_its_own_life():
    gait, _, position, heading = crowd(3)
    twin = gait.copy()
    before = twin.state.tobytes()
    gait.update(Command.of(position, heading, np.full(3, 1.2)), DT)
    assert twin.state.tobytes() == before != gait.state.tobytes()


def led_body(ground, offset, sunk=0.0):
    """A gait along x for 3 s, led by a body that is `offset` from where it should be and stands `sunk` lower."""
    gait = Gait(ground)
    gait.enter([0], [ADULT], [[0.0, 0.0]], [0.0], [1.0])
    for tick in range(1, 91):
        x = tick * DT
        gait.update(Command.of([[x, 0.0]], [0.0], [1.0]), DT)
        ankles = pose.ankle_positions(gait.state, pose.sole_rotation(gait.state["place"]))
        gait.feel(np.array([[x, 0.0]]) + offset, ankles - [0.0, 0.0, sunk], np.ones((1, 2), dtype=bool))
    return gait.state[0]


def test_ground_is_felt_where_the_body_is():
    ahead = led_body(GROUNDS["uphill"], np.array([0.2, 0.0]))
    there = led_body(GROUNDS["uphill"], np.zeros(2))
    assert ahead["target"][:, 2] - there["target"][:, 2] == pytest.approx(
        [0.04, 0.04], abs=5e-3
    )  # 0.2 of 0.2 m
    np.testing.assert_allclose(ahead["target"][:, :2], there["target"][:, :2], atol=0.02)


def test_a_foot_that_stands_lower_than_it_was_meant_to_stays_there():
    sunk = led_body(flat_ground, np.zeros(2), sunk=0.1)
    within = led_body(flat_ground, np.zeros(2), sunk=0.02)
    standing = sunk["planted"]
    assert standing.any() and (sunk["place"][standing, 2] < -0.05).all()
    np.testing.assert_allclose(within["place"][within["planted"], 2], 0.0, atol=1e-9)  # as bodies ever are


def test_who_does_not_reach_for_treads_steps_across_their_edges():
    reach = {}
    for farthest in (0.0, 0.15):
        gait = Gait(stairs)
        gait.enter([0], [ADULT], [[0.0, 0.0]], [0.0], [0.8])
        gait.state["reach"] = farthest
        shifts = []
        for tick in range(1, 150):
            gait.update(Command.of([[0.8 * tick * DT, 0.0]], [0.0], [0.8]), DT)
            shifts.append(np.abs(gait.state["shift"]).max())
        reach[farthest] = max(shifts)
    assert reach[0.0] == 0.0 and 0.02 < reach[0.15] <= 0.15


def test_walkers_do_not_depend_on_who_else_is_there():
    gait, bodies, position, heading = crowd(6, GROUNDS["waves"])
    alone = Gait(GROUNDS["waves"])
    alone.enter([2], [bodies[2]], position[2:3], heading[2:3], [1.2])
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    rows = np.arange(6)
    for tick in range(90):
        position = position + 1.2 * DT * direction
        if tick == 30:
            gait.leave([0, 4])
            rows = np.array([1, 2, 3, 5])
        if tick == 60:
            gait.enter([0], [bodies[0]], position[:1], heading[:1])
            rows = np.array([1, 2, 3, 5, 0])
        roots, joints = gait.update(Command.of(position[rows], heading[rows], np.full(len(rows), 1.2)), DT)
        root, joint = alone.update(Command.of(position[2:3], heading[2:3], [1.2]), DT)
        at = int(np.flatnonzero(rows == 2)[0])
        np.testing.assert_allclose(roots[at], root[0], atol=1e-9)
        np.testing.assert_allclose(joints[at], joint[0], atol=1e-9)
    assert gait.ids.tolist() == [1, 2, 3, 5, 0]


def test_people_of_all_sizes_walk_without_slipping():
    bodies = [describe(shape) for shape in sample_shapes(12, seed=21)]
    bodies += [describe(shape_for(1.5, 50.0)), describe(shape_for(2.0, 110.0))]
    for walk in walks([("slalom", 1.2, "flat")] * len(bodies), bodies=bodies):
        assert walk.slip().mean() <= 0.02
        assert walk.clearance.min() > -0.02


def test_a_root_that_is_put_elsewhere_takes_its_feet_along():
    gait, _, position, heading = crowd(2)
    root, joints = gait.update(Command.of(position + 50.0, heading, np.zeros(2)), DT)
    np.testing.assert_allclose(root[:, :2], position + 50.0, atol=0.03)
    assert np.abs(gait.state["place"][..., :2] - (position + 50.0)[:, None]).max() < 0.3
    assert np.isfinite(joints).all()


def test_nobody_is_a_crowd_too():
    root, joints = Gait().update(Command.of(np.zeros((0, 2)), [], []), DT)
    assert root.shape == (0, 7) and joints.shape == (0, 69)


def test_bad_input_is_named():
    gait, bodies, position, heading = crowd(2)
    with pytest.raises(GaitError, match="Walker 1 is here already"):
        gait.enter([1], bodies[:1], position[:1], heading[:1])
    with pytest.raises(GaitError, match="Walker 9 is not here"):
        gait.leave([9])
    with pytest.raises(GaitError, match="2 walkers need"):
        gait.update(Command.of(position[:1], heading, np.ones(2)), DT)
    with pytest.raises(GaitError, match="heading of walker 1 is not finite"):
        gait.update(Command.of(position, [0.0, np.nan], np.ones(2)), DT)
    with pytest.raises(GaitError, match="must be positive"):
        gait.update(Command.of(position, heading, np.ones(2)), 0.0)
    with pytest.raises(GaitError, match="as many bodies"):
        gait.enter([7, 8], bodies[:1], position, heading)


def ledge(xy, edge=0.04, rise=0.12):
    """A step up to the left of a way along x, under the left foot; a ramp of 5 cm as grids have it."""
    return rise * np.clip((xy[:, 1] - edge) / 0.05, 0.0, 1.0)


def soles_over_an_edge(walked, rise=0.12, half=0.045):
    """Share of standing soles that lie neither on the lower nor on the upper level across their width."""
    standing = walked.states["planted"] & (np.abs(walked.states["roll"]) < 0.1)
    place = walked.states["place"][standing]
    left = half * np.stack([-np.sin(place[:, 3]), np.cos(place[:, 3])], -1)
    sides = place[:, :2] - left, place[:, :2] + left
    return np.mean(np.abs(ledge(sides[1]) - ledge(sides[0])) > 0.5 * rise)


def test_feet_step_off_an_edge_beside_them(monkeypatch):
    monkeypatch.setitem(GROUNDS, "ledge", ledge)
    (walked,) = walks([("line", 1.0, "ledge")])
    monkeypatch.setattr(footholds, "_ASIDE", np.zeros(5))
    (straight,) = walks([("line", 1.0, "ledge")])
    assert soles_over_an_edge(walked) < 0.5 * soles_over_an_edge(straight)


def test_steps_are_quicker_beside_an_edge(monkeypatch):
    monkeypatch.setitem(GROUNDS, "ledge", ledge)
    beside, flat = walks([("line", 1.0, "ledge"), ("line", 1.0, "flat")])
    strides = [np.sum(np.diff(w.states["phase"]) < -0.5) for w in (beside, flat)]
    assert strides[0] > strides[1]
