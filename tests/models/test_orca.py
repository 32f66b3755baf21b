"""ORCA crowds: free walking, head-on passing, circle swaps, and no overlap in random scenes."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from footfall.models.crowd.convex_obstacles import ConvexObstacles
from footfall.models.crowd.orca import OrcaError, OrcaParams, Rollout, orca_velocity, rollout, smooth_heading

RADIUS = 0.4


def towards(goal: np.ndarray, speed: float, dt: float):
    """Walk straight to the goal (B, N, 2) and arrive exactly."""

    def preferred(step: int, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        arm = goal - position
        distance = np.linalg.norm(arm, axis=-1, keepdims=True)
        return arm / np.maximum(distance, 1e-9) * np.minimum(speed, distance / dt)

    return preferred


def agent_overlap(run: Rollout, radius: float = RADIUS) -> float:
    """Deepest overlap of two discs at any sample, m; negative when all stay apart."""
    count = run.position.shape[1]
    arm = run.position[:, :, None] - run.position[:, None]
    distance = np.linalg.norm(arm, axis=-1)[:, ~np.eye(count, dtype=bool)]
    return float(2 * radius - distance.min())


def obstacle_overlap(run: Rollout, polygons: list[list[np.ndarray]], radius: float = RADIUS) -> float:
    """Deepest overlap of a disc and an obstacle at any sample, m."""
    depth = [
        radius
        - shapely.distance(
            shapely.union_all([shapely.Polygon(p) for p in scene]), shapely.points(where)
        ).min()
        for scene, where in zip(polygons, run.position, strict=True)
        if scene
    ]
    return float(max(depth))


def random_scene(rng: np.random.Generator, agents: int, shapes: int, size: float) -> tuple:
    """Polygons, and starts and goals of at most so many agents, free of overlap, in a square."""
    polygons = []
    for _ in range(shapes):
        corners = rng.integers(3, 9)
        angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
        reach = rng.uniform(0.5, 2.0, (corners, 1))
        polygon = rng.uniform(0, size, 2) + reach * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        if shapely.Polygon(polygon).is_valid and shapely.Polygon(polygon).area > 0.1:
            polygons.append(polygon)
    solid = shapely.union_all([shapely.Polygon(p) for p in polygons])

    def places() -> np.ndarray:
        tries = rng.uniform(0, size, (1000, 2))
        found: list[np.ndarray] = []
        for place in tries[~(shapely.distance(solid, shapely.points(tries)) <= RADIUS)]:
            if len(found) < agents and all(np.hypot(*(place - other)) > 2 * RADIUS for other in found):
                found.append(place)
        return np.array(found)

    return polygons, places(), places()


def test_an_undisturbed_agent_walks_exactly_as_it_prefers():
    preferred = np.array([[[1.2, -0.5]]])
    chosen = orca_velocity(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), preferred, 0.1, OrcaParams())
    np.testing.assert_allclose(chosen, preferred, atol=1e-12)


@pytest.mark.parametrize("dt", [0.1, 1 / 60])
def test_two_agents_head_on_swap_places_without_touching(dt: float):
    start = np.array([[[-4.0, 0.0], [4.0, 0.0]]])
    run = rollout(start, np.zeros_like(start), towards(-start, 1.3, dt), int(12 / dt), dt, OrcaParams())
    assert agent_overlap(run) < 1e-6
    np.testing.assert_allclose(run.position[:, :, -1], -start, atol=0.05)


@pytest.mark.parametrize("dt", [0.1, 1 / 60])
def test_twenty_agents_on_a_circle_swap_places(dt: float):
    angle = np.arange(20) * 2 * np.pi / 20
    start = 7 * np.stack((np.cos(angle), np.sin(angle)), axis=-1)[None]
    run = rollout(start, np.zeros_like(start), towards(-start, 1.3, dt), int(22 / dt), dt, OrcaParams())
    assert agent_overlap(run) < 1e-6
    np.testing.assert_allclose(run.position[:, :, -1], -start, atol=0.3)


@pytest.mark.parametrize("dt", [0.1, 1 / 60])
def test_nothing_overlaps_in_random_scenes(dt: float):
    rng = np.random.default_rng(3)
    polygons, starts, goals = zip(*(random_scene(rng, 12, 5, 12.0) for _ in range(8)), strict=True)
    start = np.stack(starts)
    run = rollout(
        start,
        np.zeros_like(start),
        towards(np.stack(goals), 1.5, dt),
        int(10 / dt),
        dt,
        OrcaParams(),
        ConvexObstacles.from_polygons(polygons),
    )
    assert agent_overlap(run) < 1e-6
    assert obstacle_overlap(run, list(polygons)) < 1e-6


def test_absent_agents_stand_still_and_are_ignored():
    position = np.array([[[0.0, 0.0], [0.5, 0.0], [3.0, 0.0]]])
    position[0, 1] = np.nan
    present = np.array([[True, False, True]])
    preferred = np.array([[[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]]])
    chosen = orca_velocity(position, preferred, preferred, 0.1, OrcaParams(), present=present)
    alone = orca_velocity(position[:, ::2], preferred[:, ::2], preferred[:, ::2], 0.1, OrcaParams())
    np.testing.assert_array_equal(chosen[:, ::2], alone)
    np.testing.assert_array_equal(chosen[:, 1], 0.0)


def test_heading_turns_smoothly_and_holds_when_standing():
    velocity = np.zeros((100, 2))
    velocity[:40] = [1.0, 0.0]
    velocity[40:80] = [-0.1, 1.0]
    heading = smooth_heading(velocity, 0.1)
    np.testing.assert_allclose(heading[:40], 0.0, atol=1e-12)
    assert np.all(np.diff(heading[40:80]) >= 0) and np.diff(heading).max() < 0.8
    np.testing.assert_allclose(heading[79], np.arctan2(1.0, -0.1), atol=1e-3)
    np.testing.assert_array_equal(heading[80:], heading[79])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"dt": 0.0}, "dt is 0"),
        ({"velocity": np.zeros((1, 3, 2))}, "must all be"),
        ({"preferred": np.full((1, 2, 2), np.nan)}, "not finite"),
        ({"params": OrcaParams(radius=-1.0)}, "radius"),
        ({"params": OrcaParams(radius=np.ones((1, 3)))}, "radius has shape"),
        ({"present": np.ones((2, 2), bool)}, "present has shape"),
        ({"obstacles": ConvexObstacles.from_polygons([[], []])}, "2 scenes"),
    ],
)
def test_bad_input_is_named(change: dict, sentence: str):
    good = {
        "position": np.array([[[0.0, 0.0], [2.0, 0.0]]]),
        "velocity": np.zeros((1, 2, 2)),
        "preferred": np.zeros((1, 2, 2)),
        "dt": 0.1,
        "params": OrcaParams(),
    }
    with pytest.raises(OrcaError, match=sentence):
        orca_velocity(**(good | change))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    agents=st.integers(2, 25),
    shapes=st.integers(0, 6),
    dt=st.sampled_from([1 / 60, 0.1, 0.4]),
    horizon=st.floats(0.5, 5.0),
    neighbors=st.integers(0, 10),
)
def test_discs_that_start_apart_never_touch(
    seed: int, agents: int, shapes: int, dt: float, horizon: float, neighbors: int
):
    rng = np.random.default_rng(seed)
    polygons, start, _ = random_scene(rng, agents, shapes, 11.0)
    agents = len(start)
    max_speed = rng.uniform(1, 3, (1, agents))
    params = OrcaParams(
        max_speed=max_speed,
        max_neighbors=neighbors,
        time_horizon=horizon,
        time_horizon_obst=horizon,
    )
    goal = np.broadcast_to(rng.uniform(3, 8, 2), (1, agents, 2))  # all to one place, often inside an obstacle
    run = rollout(
        start[None],
        rng.normal(0, 1, (1, agents, 2)),
        towards(goal, 2.0, dt),
        60,
        dt,
        params,
        ConvexObstacles.from_polygons([polygons]),
    )
    assert agent_overlap(run) < 1e-6
    assert not polygons or obstacle_overlap(run, [polygons]) < 1e-6
    assert (np.linalg.norm(run.velocity, axis=-1) <= max_speed[..., None] + 1e-9).all()


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), dt=st.sampled_from([1 / 60, 0.1]), coincident=st.booleans())
def test_discs_that_start_overlapping_part_gently(seed: int, dt: float, coincident: bool):
    rng = np.random.default_rng(seed)
    start = np.zeros((1, 4, 2)) if coincident else rng.uniform(0, 1, (1, 4, 2))
    still = np.zeros_like(start)
    run = rollout(start, still, lambda step, position, velocity: still, int(4 / dt), dt, OrcaParams())
    arm = run.position[0, :, None] - run.position[0, None]
    overlap = 2 * RADIUS - np.linalg.norm(arm, axis=-1)[~np.eye(4, dtype=bool)]  # (12, H)
    assert np.diff(np.maximum(overlap.max(axis=0), 0.0)).max() < 1e-6  # the deepest overlap only shrinks
    assert overlap[:, -1].max() < 0.01
    assert np.linalg.norm(run.velocity, axis=-1)[..., -1].max() < 0.05


def test_an_agent_inside_an_obstacle_walks_out():
    box = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    start, still = np.array([[[0.7, 0.1]]]), np.zeros((1, 1, 2))
    run = rollout(
        start, still, lambda *_: still, 30, 0.1, OrcaParams(), ConvexObstacles.from_polygons([[box]])
    )
    assert run.position[0, 0, -1, 0] == pytest.approx(1.4, abs=0.01)
    assert np.diff(run.position[0, 0, :, 0]).min() >= 0
    np.testing.assert_allclose(run.position[0, 0, :, 1], 0.1, atol=1e-9)


def test_an_agent_passes_a_gap_little_wider_than_itself():
    above = np.array([[-0.1, 0.5], [0.1, 0.5], [0.1, 5.0], [-0.1, 5.0]])
    walls = [above, above * [1, -1]]
    start = np.array([[[-4.0, 0.8]]])
    goal = np.array([[[4.0, 0.0]]])
    run = rollout(
        start,
        np.zeros_like(start),
        towards(goal, 1.3, 0.1),
        150,
        0.1,
        OrcaParams(),
        ConvexObstacles.from_polygons([walls]),
    )
    np.testing.assert_allclose(run.position[0, 0, -1], goal[0, 0], atol=0.05)


def test_a_disc_that_fits_exactly_between_two_walls_can_only_walk_along():
    walls = [np.array([[-5.0, side * RADIUS], [5.0, side * RADIUS]]) for side in (1, -1)]
    start, wanted = np.zeros((1, 1, 2)), np.array([[[1.0, 1.0]]])
    obstacles = ConvexObstacles.from_polygons([walls])
    run = rollout(start, start, lambda *_: wanted, 20, 0.1, OrcaParams(), obstacles)
    assert np.abs(run.position[..., 1]).max() < 1e-9
    assert run.position[0, 0, -1, 0] > 1.5
