"""Ways around obstacles: lengths known in closed form, goals out of reach, walks through a maze."""

import numpy as np
import pytest

from footfall.models.crowd.navigation import ARRIVAL_TIME, NavigationError, Navigator

RESOLUTION = 0.2


def grid(width: float, height: float) -> np.ndarray:
    return np.zeros((round(height / RESOLUTION), round(width / RESOLUTION)), bool)


def block(cells: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> None:
    """Fill a rectangle given in metres."""
    a, b, c, d = (round(v / RESOLUTION) for v in (x0, y0, x1, y1))
    cells[b:d, a:c] = True


def maze() -> np.ndarray:
    """Four walls across 20 m x 20 m, open alternately left and right."""
    cells = grid(20, 20)
    for k in range(4):
        y = 4.0 * (k + 1)
        block(cells, 0 if k % 2 else 2.4, y, 17.6 if k % 2 else 20, y + 0.4)
    return cells


def walk(navigator: Navigator, xy: np.ndarray, goal: np.ndarray, speed: np.ndarray, dt: float, steps: int):
    track = [xy]
    for _ in range(steps):
        track.append(track[-1] + dt * navigator.preferred_velocity(track[-1], goal, speed))
    return np.stack(track, axis=1)  # (n, H + 1, 2)


def test_lengths_on_an_empty_map_are_euclidean():
    navigator = Navigator(grid(40, 30), RESOLUTION, (-20.0, -15.0), 0.4)
    rng = np.random.default_rng(0)
    xy, goal = rng.uniform([-19, -14], [19, 14], (2, 20, 2))
    euclid = np.linalg.norm(goal - xy, axis=1)
    np.testing.assert_allclose(navigator.distance(xy, goal), euclid, rtol=1e-9)
    expensive = Navigator(grid(40, 30), RESOLUTION, (-20.0, -15.0), 0.4, np.full((150, 200), 3.0))
    np.testing.assert_allclose(expensive.distance(xy, goal), 3 * euclid, rtol=1e-9)


def test_the_grid_alone_is_within_three_percent_of_euclid():
    navigator = Navigator(grid(40, 40), RESOLUTION, (0.0, 0.0), 0.0)
    tree = navigator._tree(100 * 200 + 100)
    cells = np.arange(200 * 200)
    euclid = RESOLUTION * np.hypot(cells // 200 - 100, cells % 200 - 100)
    error = tree.cost / np.maximum(euclid, 1e-9) - 1
    assert np.delete(error, 100 * 200 + 100).max() < 0.03
    assert np.delete(error, 100 * 200 + 100).min() > -1e-6


def test_a_wall_with_a_gap_is_passed_through_the_gap():
    cells = grid(20, 20)
    block(cells, 9.8, 0, 10.2, 9)
    block(cells, 9.8, 11, 10.2, 20)
    navigator = Navigator(cells, RESOLUTION, (0.0, 0.0), 0.4)
    here, there = np.array([3.0, 3.0]), np.array([17.0, 3.0])
    # The taut way bends around the lower edge of the gap, 0.4 m above the wall's end.
    corners = np.array([here, [9.8, 9.4], [10.2, 9.4], there])
    expected = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
    assert navigator.distance(here[None], there[None])[0] == pytest.approx(expected, rel=0.04)
    path = navigator.path(here, there)
    np.testing.assert_array_equal(path[[0, -1]], [here, there])
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(expected, rel=0.02)
    assert len(path) < 8


@pytest.mark.parametrize("dt", [0.1, 0.4])
def test_walkers_find_through_a_maze_with_steady_progress(dt: float):
    cells = maze()
    navigator = Navigator(cells, RESOLUTION, (0.0, 0.0), 0.3)
    rng = np.random.default_rng(1)
    start = rng.uniform(0.5, 19.5, (60, 2))
    start = start[~cells[tuple((start[:, ::-1] / RESOLUTION).astype(int).T)]][:20]
    goal = np.broadcast_to([18.5, 18.9], start.shape)
    track = walk(navigator, start, goal, np.full(len(start), 1.3), dt, int(70 / dt))
    np.testing.assert_allclose(track[:, -1], goal, atol=1e-3)
    entered = cells[tuple(np.moveaxis((track[..., ::-1] / RESOLUTION).astype(int), -1, 0))]
    assert not entered.any()
    pace = max(1, int(1 / dt))
    left = np.stack([navigator.distance(track[:, k], goal) for k in range(0, track.shape[1], pace)], axis=1)
    assert (np.diff(left, axis=1) < 0.06 * left[:, :-1] + 0.01).all()  # never farther, up to the grid's error
    on_the_way = left[:, 5:] > 1.0
    assert ((left[:, :-5] - left[:, 5:])[on_the_way] > 4.0).all()  # 5 s bring at least 4 m


def test_arrival_is_exact_and_without_overshoot():
    navigator = Navigator(grid(10, 10), RESOLUTION, (0.0, 0.0), 0.2)
    start, goal = np.array([[1.03, 1.0]]), np.array([[8.17, 5.51]])
    for dt in (1 / 60, 0.1, ARRIVAL_TIME):
        track = walk(navigator, start, goal, np.array([2.0]), dt, int(12 / dt))
        left = np.linalg.norm(track[0] - goal[0], axis=1)
        assert (np.diff(left) <= 1e-12).all()
        assert left[-1] < 1e-6
        along = (track[0] - start[0]) @ (goal - start)[0] / np.linalg.norm(goal - start)
        assert along.max() <= np.linalg.norm(goal - start) + 1e-9


def test_goals_out_of_reach_move_to_the_nearest_cell_in_reach():
    cells = grid(20, 20)
    block(cells, 8, 8, 12, 12)
    cells[50, :30] = cells[:50, 30] = True  # closes off the lower left room
    navigator = Navigator(cells, RESOLUTION, (0.0, 0.0), 0.4)
    xy = np.array([[15.0, 15.0], [15.0, 15.0], [1.0, 1.0], [15.0, 15.0], [15.0, 15.0]])
    goal = np.array([[10.0, 11.0], [1.0, 1.0], [18.0, 1.0], [25.0, 15.0], [17.0, 17.0]])
    resolved, moved = navigator.resolve(xy, goal)
    np.testing.assert_array_equal(moved, [True, True, True, True, False])
    np.testing.assert_allclose(resolved[0], [10.0, 12.5], atol=0.11)  # above the block, clearance kept
    assert (
        resolved[2, 0] == pytest.approx(5.5, abs=0.11) and resolved[2, 1] < 2
    )  # the wall of the closed room
    np.testing.assert_allclose(resolved[3], [19.9, 15.0], atol=0.11)
    np.testing.assert_array_equal(resolved[4], goal[4])
    track = walk(navigator, xy, goal, np.full(5, 1.5), 0.1, 400)
    np.testing.assert_allclose(track[:, -1], resolved, atol=1e-3)


def test_walkers_prefer_the_cheap_surface():
    cells, cost = grid(20, 10), np.ones((50, 100))
    cost[:, 40:60] = 5.0  # a road across
    cost[35:45, 40:60] = 1.0  # its crosswalk, y from 7 to 9
    plain = Navigator(cells, RESOLUTION, (0.0, 0.0), 0.3)
    careful = Navigator(cells, RESOLUTION, (0.0, 0.0), 0.3, cost)
    start, goal, speed = np.array([[3.0, 2.0]]), np.array([[17.0, 2.0]]), np.array([1.4])
    for navigator, on_crosswalk in ((plain, False), (careful, True)):
        track = walk(navigator, start, goal, speed, 0.1, 250)[0]
        road = (track[:, 0] > 8.2) & (track[:, 0] < 11.8)
        crosswalk = (track[:, 1] > 6.8) & (track[:, 1] < 9.2)
        assert crosswalk[road].all() if on_crosswalk else not crosswalk[road].any()
        np.testing.assert_allclose(track[-1], goal[0], atol=1e-3)
    straight_on_pavement = careful.preferred_velocity([[1.0, 1.0]], [[7.0, 9.0]], 1.0)
    np.testing.assert_allclose(straight_on_pavement, [[0.6, 0.8]], atol=1e-9)


def test_a_walker_pressed_against_a_wall_still_finds_out():
    navigator = Navigator(maze(), RESOLUTION, (0.0, 0.0), 0.4)
    start = np.array([[10.0, 3.95], [10.0, 4.45], [-1.0, 1.0]])
    goal = np.broadcast_to([18.5, 18.9], start.shape)
    track = walk(navigator, start, goal, np.full(3, 1.3), 0.1, 900)
    np.testing.assert_allclose(track[:, -1], goal, atol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((np.zeros(5, bool), 0.2, (0, 0), 0.4), "shape"),
        ((np.zeros((5, 5), bool), 0.0, (0, 0), 0.4), "resolution is 0"),
        ((np.zeros((5, 5), bool), 0.2, (0, 0), -1.0), "clearance is -1"),
        ((np.zeros((5, 5), bool), 0.2, (0, np.nan), 0.4), "origin"),
        ((np.ones((5, 5), bool), 0.2, (0, 0), 0.4), "no free cell"),
        ((np.zeros((5, 5), bool), 0.2, (0, 0), 0.4, np.zeros((5, 5))), "cost"),
        ((np.zeros((5, 5), bool), 0.2, (0, 0), 0.4, np.ones((4, 5))), "cost"),
    ],
)
def test_bad_grids_are_named(arguments: tuple, sentence: str):
    with pytest.raises(NavigationError, match=sentence):
        Navigator(*arguments)


def test_bad_places_are_named():
    navigator = Navigator(grid(4, 4), RESOLUTION, (0.0, 0.0), 0.4)
    with pytest.raises(NavigationError, match=r"\(n, 2\)"):
        navigator.preferred_velocity(np.zeros((2, 2)), np.zeros((3, 2)), np.ones(2))
    with pytest.raises(NavigationError, match="not finite"):
        navigator.preferred_velocity(np.full((1, 2), np.nan), np.zeros((1, 2)), np.ones(1))
    with pytest.raises(NavigationError, match="speed has shape"):
        navigator.preferred_velocity(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(3))
