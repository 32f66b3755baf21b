"""Plans for crowds: straight where nothing is in the way, around what is, together in groups."""

import numpy as np
import pytest
import shapely

from footfall.models.crowd.navigation import Navigator
from footfall.models.crowd.orca_planner import OrcaPlanner, Place
from footfall.models.crowd.planning import PLAN_DT, PLAN_STEPS, ConstantVelocity, Crowd
from footfall.models.crowd.routes import Routes

SIZE, RESOLUTION = 20.0, 0.1
WALL = np.array([[-0.5, -4.0], [0.5, -4.0], [0.5, 4.0], [-0.5, 4.0]])


def place(*obstacles: np.ndarray) -> Place:
    cells = round(SIZE / RESOLUTION)
    middle = (np.arange(cells) + 0.5) * RESOLUTION - SIZE / 2
    x, y = np.meshgrid(middle, middle)
    blocked = np.zeros((cells, cells), bool)
    for obstacle in obstacles:
        blocked |= shapely.contains_xy(shapely.Polygon(obstacle), x, y)
    return Place(blocked, np.ones((cells, cells)), RESOLUTION, (-SIZE / 2, -SIZE / 2), obstacles)


def crowd(start, goal, speed=1.3, group=-1) -> Crowd:
    start, goal = np.array(start, float), np.array(goal, float)
    count = len(start)
    arm = goal - start
    heading = np.arctan2(arm[:, 1], arm[:, 0])
    pace = np.full(count, float(speed))
    velocity = pace[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return Crowd(start, velocity, heading, np.full(count, 0.3), goal, pace, np.full(count, group))


def test_constant_velocity_is_the_analytic_line():
    futures = ConstantVelocity().plan(crowd([[1, 2]], [[4, 6]], speed=1.0))
    times = PLAN_DT * np.arange(1, PLAN_STEPS + 1)
    assert futures.positions[0, 0] == pytest.approx(np.array([1, 2]) + times[:, None] * [0.6, 0.8])
    assert futures.speeds == pytest.approx(1.0)


def test_alone_on_free_ground_one_walks_straight_at_the_preferred_speed():
    futures = OrcaPlanner(place()).plan(crowd([[-6, 0]], [[6, 0.0]]))
    track = futures.positions[0, 0]
    assert np.abs(track[:, 1]).max() < 0.15
    assert track[-1, 0] == pytest.approx(-6 + 1.3 * 5.0, abs=0.1)
    assert np.abs(futures.headings).max() < 0.1


def test_one_stops_at_the_goal():
    futures = OrcaPlanner(place()).plan(crowd([[0, 0]], [[2, 0.0]]))
    assert futures.positions[0, 0, -1] == pytest.approx([2, 0], abs=0.05)
    assert futures.speeds[0, 0, -1] < 0.05


def test_two_who_meet_pass_each_other():
    futures = OrcaPlanner(place()).plan(crowd([[-3, 0], [3, 0]], [[3, 0], [-3, 0.0]]))
    gap = np.linalg.norm(futures.positions[0, 0] - futures.positions[1, 0], axis=1)
    assert gap.min() >= 0.6 - 1e-6
    assert futures.positions[0, 0, -1, 0] > 2.0


def test_the_way_leads_around_a_wall():
    planner, walker = OrcaPlanner(place(WALL)), crowd([[-2, 0]], [[2, 0.0]])
    wall = shapely.Polygon(WALL)
    tracks = []
    for _ in range(3):
        futures = planner.plan(walker)
        track = futures.positions[0, 0]
        tracks.append(track)
        velocity = (track[-1] - track[-2]) / PLAN_DT
        walker = Crowd(
            track[-1:],
            velocity[None],
            futures.headings[0, 0, -1:],
            *[getattr(walker, name) for name in ("radius", "goal", "speed", "group")],
        )
    track = np.concatenate(tracks)
    assert shapely.distance(shapely.points(track), wall).min() >= 0.3 - 1e-3
    assert track[-1] == pytest.approx([2, 0], abs=0.3)


def test_a_group_stays_together_and_strangers_need_not():
    start, goal = [[-6, 0.0], [-8, 0.8]], [[6, 0.0], [6, 0.8]]
    alone = OrcaPlanner(place()).plan(crowd(start, goal)).positions
    friends = OrcaPlanner(place()).plan(crowd(start, goal, group=3)).positions
    assert (
        np.linalg.norm(friends[0, 0, -1] - friends[1, 0, -1])
        < np.linalg.norm(alone[0, 0, -1] - alone[1, 0, -1]) - 0.4
    )


def test_nobody_is_planned_for_without_complaint():
    futures = OrcaPlanner(place()).plan(crowd(np.zeros((0, 2)), np.zeros((0, 2))))
    assert futures.positions.shape == (0, 1, PLAN_STEPS, 2)


def test_a_route_is_shared_and_followed_to_its_end():
    ground = place(WALL)
    routes = Routes(Navigator(ground.blocked, RESOLUTION, ground.origin, 0.3))
    goal = np.array([[2.0, 0.0]])
    position = np.array([[-2.0, 0.0]])
    for _ in range(400):  # a new lookup each half second, as a planner does
        follow = routes.follow(position, goal)
        for _ in range(5):
            position = position + 0.1 * follow(position, np.array([1.3]))
    assert position[0] == pytest.approx([2, 0], abs=0.1)
