"""The planner node with TRACE: what live objectives do to plans, people who come and go, user-made objectives."""

import logging
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import footfall
from footfall.messages.agents import AgentStates
from footfall.messages.body import Bodies
from footfall.messages.config import ConfigError
from footfall.messages.map import SemanticMap
from footfall.messages.objectives import (
    AgentObjectives,
    MinimumSpeed,
    Objectives,
    ObstacleAvoidance,
    SocialDistance,
    SocialGroup,
    TargetSpeed,
    Waypoint,
)
from footfall.messages.topics import AGENTS, BODIES, MAP, OBJECTIVES
from footfall.models.trace.objectives import OBJECTIVES as REGISTERED
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.scene_planner import TraceFutures
from footfall.models.trace.weights import load_tensors, save_tensors
from footfall.nodes.planner import Config, PlannerNode
from footfall.nodes.planner_stops import halted

pytestmark = pytest.mark.usefixtures("one_thread")

SIDE = 240  # cells of 0.1 m


def place(*holes: tuple[slice, slice], layers=("walkable",)):
    """24 m x 24 m around the origin, blocked in `holes` (rows, columns in m)."""
    free = np.ones((SIDE, SIDE), np.uint8)
    for rows, columns in holes:
        cells = [slice(int(10 * (s.start + 12)), int(10 * (s.stop + 12))) for s in (rows, columns)]
        free[tuple(cells)] = 0
    return MAP(SemanticMap("test", list(layers), np.stack([free] * len(layers)), 0.1, (-12.0, -12.0)))


def bodies(count=6):
    quarter = np.full(count, 0.25, np.float32)
    return BODIES(
        Bodies(
            np.arange(count, dtype=np.int32),
            np.zeros((count, 10), np.float32),
            masses=quarter,
            statures=quarter,
            radii=quarter,
            offsets=np.zeros((count, 24, 3), np.float32),
        )
    )


def people(states: Mapping[int, tuple[float, ...]], frames=31):
    """Everybody has walked straight on to (x, y, heading, speed) and was seen for so many frames."""
    history = np.zeros((len(states), 31, 7), np.float32)
    time = 0.1 * np.arange(-30, 1)
    for row, (x, y, heading, speed) in enumerate(states.values()):
        history[row, :, 0] = x + np.cos(heading) * speed * time
        history[row, :, 1] = y + np.sin(heading) * speed * time
        history[row, :, 2:] = (heading, speed, 0.4, 0.5, 1)
    history[:, : 31 - frames] = 0
    ids = np.array(list(states), np.int32)
    return AGENTS(AgentStates(ids, np.full(len(states), -1, np.int32), history))


def wishes(asked: dict[int, list], *groups: SocialGroup):
    return OBJECTIVES(Objectives([AgentObjectives(i, list(w)) for i, w in asked.items()], list(groups)))


def trace(**config) -> PlannerNode:
    return PlannerNode(Config(**({"method": "trace", "samples": 4, "steps": 4} | config)))


def plan(node, inbox):
    (item,) = node.step(inbox)
    return item.message


def chosen(plans, quantity="positions"):
    return getattr(plans, quantity)[np.arange(len(plans.ids)), plans.chosen]


def test_all_samples_losses_and_the_time_are_in_the_message(inbox_of):
    asked = {0: [Waypoint((6, 0)), TargetSpeed(1.3), SocialDistance(0.3), ObstacleAvoidance()], 1: []}
    node = trace()
    plans = plan(
        node,
        inbox_of(
            0.0, place(), bodies(), wishes(asked), people({0: (0, 0, 0, 1.2), 1: (0, 3, 1, 0)}, frames=4)
        ),
    )
    assert plans.positions.shape == (2, 4, 50, 2) and plans.method == "trace"
    assert plans.loss_names == ["agent_avoid", "follow", "maximum_speed", "obstacle_avoid"]
    assert plans.losses.shape == (2, 4, 4) and plans.planning_time > 0
    assert np.isfinite(plans.positions).all()
    assert node.facts["planning_time"] == plans.planning_time and "late_plans" in node.facts


def test_who_is_asked_nothing_stands_still(inbox_of):
    inbox = inbox_of(0.0, place(), bodies(), wishes({}), people({0: (1, 2, 0.5, 0), 1: (5, 5, 0, 0)}))
    plans = plan(trace(), inbox)
    assert np.allclose(chosen(plans), np.array([[[1, 2]], [[5, 5]]]))
    assert chosen(plans, "speeds").max() == 0
    assert np.allclose(chosen(plans, "headings"), np.array([[0.5], [0.0]]))


def test_the_way_leads_around_a_wall(inbox_of):
    wall = (slice(-2.0, 6.0), slice(2.0, 2.6))  # across the straight line to the goal, open below y = -2
    inbox = inbox_of(
        0.0,
        place(wall),
        bodies(),
        wishes({0: [Waypoint((8, 0)), TargetSpeed(1.4)]}),
        people({0: (0, 0, 0, 1.4)}),
    )
    path = chosen(plan(trace(steps=6, samples=8), inbox))[0]
    inside = (path[:, 0] > 2.0) & (path[:, 0] < 2.6) & (path[:, 1] > -2)
    assert not inside.any()
    assert path[:, 1].min() < -1.5 and path[-1, 0] > 1.5


@pytest.mark.parametrize("speed", [0.0, 1.2])
def test_somebody_whose_goal_is_behind_turns_round(inbox_of, speed):
    asked = wishes({0: [Waypoint((-8, 0)), TargetSpeed(1.3)]})
    node, inbox = trace(), inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, speed)}))
    plans = plan(node, inbox)
    for second in (1, 2):
        state = [chosen(plans, q)[0, 9] for q in ("positions", "headings", "speeds")]
        inbox = inbox_of(float(second), people({0: (*state[0], *state[1:])}), inbox=inbox)
        plans = plan(node, inbox)
    assert chosen(plans)[0, -1, 0] < -2.0
    assert chosen(plans, "speeds").min() >= -0.1


def test_a_time_of_arrival_sets_the_pace(inbox_of):
    for at, distance in ((4.0, 4.0), (10.0, 8.0)):
        asked = wishes({0: [Waypoint((8, 0) if at > 5 else (4, 0), at=at)]})
        path = chosen(plan(trace(), inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, 1)}))))[0]
        frame = min(50, round(10 * at))
        expected = distance * min(1.0, 5.0 / at)
        assert np.linalg.norm(path[frame - 1]) == pytest.approx(expected, abs=0.7)


def test_social_distance_parts_people_more(inbox_of):
    def least(gap):
        asked = {i: [Waypoint((6.0 * (-1) ** i, 0)), TargetSpeed(1.2), SocialDistance(gap)] for i in (0, 1)}
        walkers = people({0: (-4, 0.05, 0, 1.2), 1: (4, -0.05, np.pi, 1.2)})
        path = chosen(plan(trace(samples=8), inbox_of(0.0, place(), bodies(), wishes(asked), walkers)))
        return np.linalg.norm(path[0] - path[1], axis=-1).min()

    assert least(0.1) > 0.5
    assert least(1.0) > 1.2


def test_a_group_closes_up_and_weight_zero_switches_it_off(inbox_of):
    def gap(weight):
        asked = {i: [Waypoint((9, y)), TargetSpeed(1.2)] for i, y in enumerate((0, 4))}
        group = SocialGroup(0, leader=0, members=[0, 1], distance=1.0, weight=weight)
        walkers = people({0: (0, 0, 0, 1.2), 1: (0, 4, 0, 1.2)})
        path = chosen(plan(trace(), inbox_of(0.0, place(), bodies(), wishes(asked, group), walkers)))
        return np.linalg.norm(path[0] - path[1], axis=-1)[-1]

    assert gap(1.0) < gap(0.0) - 1.0


def test_somebody_aimless_walks_at_the_speed_asked(inbox_of):
    asked = {0: [TargetSpeed(1.6)], 1: [MinimumSpeed(1.0)], 2: [TargetSpeed(0.0)]}
    states = {0: (0, 0, 0, 1.0), 1: (0, 4, 0, 0.5), 2: (0, -4, 0, 0.0)}
    speeds = chosen(plan(trace(), inbox_of(0.0, place(), bodies(), wishes(asked), people(states))), "speeds")
    assert speeds[0, 10:].mean() == pytest.approx(1.6, abs=0.15)
    assert speeds[1, 15:].min() > 0.85
    assert speeds[2].max() == 0


def test_plans_go_on_when_people_come_and_go(inbox_of):
    node = trace()
    asked = wishes({i: [Waypoint((8, y)), TargetSpeed(1.2)] for i, y in enumerate((0, 2, 4))})
    inbox = inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, 1.2), 1: (0, 2, 0, 1.2)}))
    first = plan(node, inbox)
    there = chosen(first)[1, 9]
    later = {1: (*there, chosen(first, "headings")[1, 9], chosen(first, "speeds")[1, 9]), 2: (0, 4, 0, 0)}
    second = plan(node, inbox_of(1.0, people(later, frames=1), inbox=inbox))
    assert second.ids.tolist() == [1, 2]
    drift = np.linalg.norm(chosen(second)[0, :20] - chosen(first)[1, 10:30], axis=-1)
    assert drift[0] < 0.05 and drift.mean() < 0.5
    third = plan(node, inbox_of(2.0, people({}), inbox=inbox))
    assert third.positions.shape == (0, 4, 50, 2)


def test_the_same_seed_gives_the_same_plans_and_another_others(inbox_of):
    def run(seed):
        node = PlannerNode(Config(method="trace", samples=3, steps=3), seed)
        asked = wishes({0: [Waypoint((8, 0)), TargetSpeed(1.2)]})
        inbox = inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, 1.2)}))
        first = plan(node, inbox).positions
        return first, plan(node, inbox_of(1.0, people({0: (1.2, 0, 0, 1.2)}), inbox=inbox)).positions

    for one, same, other in zip(run(1), run(1), run(2), strict=True):
        assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_it_plans_once_a_second_and_counts_what_is_late(inbox_of):
    node, rushed = trace(samples=1, steps=1), trace(samples=8, steps=20, rate_hz=10.0)
    for each, ticks in ((node, [0, 10, 20]), (rushed, list(range(21)))):
        planned, late, inbox = [], 0, None
        for tick in range(21):
            first = (place(), bodies(), wishes({0: [Waypoint((8, 0))]})) if not tick else ()
            inbox = inbox_of(tick / 10, *first, people({0: (0.12 * tick, 0, 0, 1.2)}), inbox=inbox)
            for item in each.step(inbox):
                planned.append(tick)
                late += item.message.planning_time > (0.1 if each is rushed else 1.0)
        assert planned == ticks
        assert each.facts["late_plans"] == late


def test_a_waypoint_outside_the_map_is_reported_and_approached(inbox_of, caplog):
    node = trace()
    asked = wishes({0: [Waypoint((500.0, 0.0)), TargetSpeed(1.3)]})
    inbox = inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, 1.3)}))
    with caplog.at_level(logging.WARNING):
        path = chosen(plan(node, inbox))[0]
        plan(node, inbox_of(1.0, people({0: (1.3, 0, 0, 1.3)}), inbox=inbox))
    told = [r.getMessage() for r in caplog.records if "person 0" in r.getMessage()]
    assert len(told) == 1 and "(500.0, 0.0), lies outside the map" in told[0]
    assert path[-1, 0] > 3


def test_a_map_without_the_needed_layer_is_reported_and_planned_on(inbox_of, caplog):
    asked = wishes({0: [Waypoint((5.0, 0.0))]})
    inbox = inbox_of(0.0, place(layers=("green", "road")), bodies(), asked, people({0: (0, 0, 0, 1.3)}))
    with caplog.at_level(logging.ERROR):
        path = chosen(plan(trace(), inbox))[0]
    assert "has the layers green, road; a planner needs `walkable` or `obstacle`" in caplog.text
    assert path[-1, 0] > 3


def test_weights_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"there are no weights at .*none\.safetensors"):
        trace(weights=str(tmp_path / "none.safetensors"))
    from footfall.models.trace.planner import WEIGHTS

    tensors, facts = load_tensors(WEIGHTS)
    other = tmp_path / "other.safetensors"
    save_tensors(other, tensors, facts | {"config": facts["config"] | {"widths": [32, 64]}})
    with pytest.raises(ConfigError, match="does not fit its own configuration") as caught:
        trace(weights=str(other))
    assert len(str(caught.value)) < 300 and "\n" not in str(caught.value)
    save_tensors(other, tensors, facts | {"config": facts["config"] | {"dt": 0.2}})
    with pytest.raises(ConfigError, match=r"50 points 0\.2 s apart; the graph's have 50, 0\.1 s"):
        trace(weights=str(other))


def test_distilled_weights_take_their_own_steps(inbox_of):
    from footfall.models.trace.planner import DISTILLED, WEIGHTS

    asked = (place(), bodies(), wishes({0: [Waypoint((5.0, 0.0))]}), people({0: (0, 0, 0, 1.3)}))
    shipped, named, six, other = (
        plan(trace(samples=2, **options), inbox_of(0.0, *asked)).positions
        for options in ({}, {"weights": str(DISTILLED), "steps": 9}, {"steps": 6}, {"weights": str(WEIGHTS)})
    )
    assert np.array_equal(shipped, named) and not np.array_equal(shipped, other)
    assert not np.array_equal(shipped, six)
    for positions in (shipped, six, other):
        assert positions[0, :, -1, 0].min() > 3
    with pytest.raises(
        ConfigError, match="distilled for the steps 99, 90, 70, 28 of ddim without context_weight"
    ):
        trace(weights=str(DISTILLED), context_weight=0.5)


def test_an_objective_from_a_file_bends_the_plans(inbox_of, tmp_path: Path):
    module = tmp_path / "my_objectives.py"
    document = (Path(footfall.__file__).parent / "docs" / "trace.md").read_text()
    (block,) = [b for b in re.findall(r"```python\n(.*?)```", document, re.DOTALL) if "stay_left" in b]
    module.write_text(block)
    asked = wishes({0: [TargetSpeed(1.2)]})
    try:
        ends = []
        for weight in (0.0, 1.0):
            node = trace(objectives=(str(module),), ask={"stay_left": {"y": 2.0, "weight": weight}})
            inbox = inbox_of(0.0, place(), bodies(), asked, people({0: (0, 0, 0, 1.2)}))
            plans = plan(node, inbox)
            assert "stay_left" in plans.loss_names
            ends.append(chosen(plans)[0, -1, 1])
        assert ends[1] > max(1.0, ends[0] + 0.5)
    finally:
        REGISTERED.pop("stay_left", None)


def test_faulty_modules_and_objectives_are_named(tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("import nothing_of_that_name\n")
    with pytest.raises(ConfigError, match=r"cannot load .*broken\.py: ModuleNotFoundError"):
        trace(objectives=(str(broken),))
    with pytest.raises(ConfigError, match=r"cannot load .*missing\.py: FileNotFoundError"):
        trace(objectives=(str(tmp_path / "missing.py"),))
    with pytest.raises(ConfigError, match="did you mean 'target_speed'"):
        trace(ask={"target_sped": {}})


def test_without_torch_the_sentence_says_what_to_do(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(ConfigError, match="'trace' needs torch; install footfall"):
        trace()
    PlannerNode(Config(method="orca"))


def test_who_would_walk_into_a_wall_stops_before_it_and_all_others_walk_on():
    wall = np.zeros((200, 200), bool)
    wall[:, 120:] = True  # from x = 12 m on
    maps = SceneMaps.from_raster({"obstacle": wall}, 0.1, (0.05, 0.05))
    now = np.array([[8.0, 10.0, 0.0, 1.5], [8.0, 5.0, np.pi, 1.5], [12.1, 10.0, np.pi, 1.0]])
    time = 0.1 * np.arange(1, 51, dtype=float)
    ahead = np.stack([np.cos(now[:, 2]), np.sin(now[:, 2])], -1)
    places = now[:, None, :2] + now[:, 3, None, None] * time[:, None] * ahead[:, None]
    headings, speeds = (np.broadcast_to(now[:, column, None], (3, 50))[:, None] for column in (2, 3))
    futures = TraceFutures(places[:, None], headings, speeds, np.zeros(3, np.int64))
    radius, all_do = np.full(3, 0.25), np.ones(3, bool)
    stopped = halted(futures, now, maps, radius, all_do)
    x = stopped.positions[0, 0, :, 0]
    assert 11.5 < x[-1] <= 11.77 and (np.diff(x) >= 0).all()
    brakes = np.diff(stopped.speeds[0, 0]) / 0.1
    assert stopped.speeds[0, 0, 0] == pytest.approx(1.5) and stopped.speeds[0, 0, -1] < 0.1
    assert brakes.min() > -2.5
    for one in (1, 2):  # away from the wall; out of the wall
        np.testing.assert_array_equal(stopped.positions[one], futures.positions[one])
    assert halted(futures, now, None, radius, all_do) is futures
    assert halted(futures, now, maps, radius, ~all_do) is futures
