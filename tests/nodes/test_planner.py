"""The planner node: when it plans, where plans begin, what objectives mean to it."""

import numpy as np
import pytest

from footfall.messages.agents import AgentStates
from footfall.messages.body import Bodies
from footfall.messages.map import SemanticMap
from footfall.messages.objectives import AgentObjectives, Objectives, TargetSpeed, Waypoint
from footfall.messages.topics import AGENTS, BODIES, MAP, OBJECTIVES
from footfall.models.crowd.navigation import NavigationError
from footfall.nodes.planner import Config, PlannerNode

PLACE = MAP(SemanticMap("test", ["walkable"], np.ones((1, 200, 200), np.uint8), 0.1, (-10.0, -10.0)))
QUARTER = np.full(3, 0.25, np.float32)
BODY = BODIES(
    Bodies(
        np.arange(3, dtype=np.int32),
        np.zeros((3, 10), np.float32),
        masses=QUARTER,
        statures=QUARTER,
        radii=QUARTER,
        offsets=np.zeros((3, 24, 3), np.float32),
    )
)


def agents(**places):
    """`a=(x, y, heading, speed)`; ids are a, b, c."""
    history = np.zeros((len(places), 31, 7), np.float32)
    for row, state in enumerate(places.values()):
        history[row, -1, :4] = state
        history[row, -1, 4:] = (0.4, 0.5, 1)
    ids = np.array(["abc".index(name) for name in places], np.int32)
    return AGENTS(AgentStates(ids, np.full(len(places), -1, np.int32), history))


def wishes(*goals, speed=1.3, at=None):
    return OBJECTIVES(
        Objectives(
            [AgentObjectives(i, [Waypoint(goal, at), TargetSpeed(speed)]) for i, goal in enumerate(goals)]
        )
    )


def plans_of(planner, inbox):
    return [item.message for item in planner.step(inbox)]


@pytest.mark.parametrize("method", ["orca", "constant_velocity"])
def test_everybody_gets_a_plan_of_five_seconds(inbox_of, method):
    planner = PlannerNode(Config(method=method))
    inbox = inbox_of(0.0, PLACE, BODY, wishes((5.0, 0.0), (0.0, 5.0)), agents(a=(0, 0, 0, 1), b=(0, 3, 1, 1)))
    (plans,) = plans_of(planner, inbox)
    assert plans.positions.shape == (2, 1, 50, 2)
    assert plans.ids.tolist() == [0, 1]
    assert plans.planning_time > 0


@pytest.mark.parametrize("method", ["orca", "trace"])
def test_a_map_without_room_is_an_error_in_the_log_not_the_end(inbox_of, method, caplog):
    full = MAP(SemanticMap("full", ["obstacle"], np.ones((1, 200, 200), np.uint8), 0.1, (-10.0, -10.0)))
    rest = (BODY, wishes((5.0, 0.0)), agents(a=(0, 0, 0, 1)))
    planner = PlannerNode(Config(method=method))
    before = plans_of(planner, inbox_of(0.0, PLACE, *rest))[0]
    after = plans_of(planner, inbox_of(1.0, full, *rest))[0]
    assert "map 'full': a clearance of" in caplog.text and "leaves no free cell" in caplog.text
    assert before.positions.shape == after.positions.shape and np.isfinite(after.positions).all()
    with pytest.raises(NavigationError):  # there is none to go on with
        plans_of(PlannerNode(Config(method=method)), inbox_of(0.0, full, *rest))


def test_it_plans_at_its_rate_and_at_once_for_newcomers(inbox_of):
    planner = PlannerNode(Config(rate_hz=2))
    inbox, counts = None, []
    for tick in range(10):
        people = {"a": (0, 0, 0, 0)} | ({"b": (3, 3, 0, 0)} if tick >= 7 else {})
        first = (PLACE, BODY, wishes((5.0, 0.0), (3.0, 3.0))) if tick == 0 else ()
        inbox = inbox_of(tick / 10, *first, agents(**people), inbox=inbox)
        counts.append(len(plans_of(planner, inbox)))
    assert counts == [1, 0, 0, 0, 0, 1, 0, 1, 0, 0]


def test_it_plans_at_once_when_somebody_is_asked_something_new(inbox_of):
    planner = PlannerNode(Config(rate_hz=1))
    inbox, counts = None, []
    for tick in range(8):
        messages = [agents(a=(0, 0, 0, 0), **({"b": (3, 3, 0, 0)} if tick < 2 else {}))]  # b leaves
        if tick in (0, 3, 5):  # 5: the same again; 6: somebody else, who is not there
            goal = (5.0, 0.0) if tick == 0 else (0.0, 5.0)
            messages += [wishes(goal)]
        if tick == 6:
            messages += [wishes((0.0, 5.0), (9.0, 9.0))]
        inbox = inbox_of(tick / 10, *((PLACE, BODY) if tick == 0 else ()), *messages, inbox=inbox)
        counts.append(len(plans_of(planner, inbox)))
    assert counts == [1, 0, 0, 1, 0, 0, 0, 0]


def test_a_plan_begins_on_the_last_one_unless_the_walker_has_left_it(inbox_of):
    planner = PlannerNode(Config(rate_hz=10))
    inbox = inbox_of(0.0, PLACE, BODY, wishes((8.0, 0.0)), agents(a=(0, 0, 0, 1.3)))
    (first,) = plans_of(planner, inbox)
    swayed = first.positions[0, 0, 0] + [0, 0.03]
    (second,) = plans_of(planner, inbox_of(0.1, agents(a=(*swayed, 0, 1.3)), inbox=inbox))
    assert second.positions[0, 0, 0] == pytest.approx(first.positions[0, 0, 1], abs=0.01)
    (third,) = plans_of(planner, inbox_of(0.2, agents(a=(0, 2.0, 0, 1.3)), inbox=inbox))
    assert third.positions[0, 0, 0, 1] == pytest.approx(2.0, abs=0.1)


def test_a_time_of_arrival_sets_the_speed(inbox_of):
    planner = PlannerNode(Config())
    inbox = inbox_of(0.0, PLACE, BODY, wishes((4.0, 0.0), at=5.0), agents(a=(0, 0, 0, 0.8)))
    (plans,) = plans_of(planner, inbox)
    assert plans.positions[0, 0, -1] == pytest.approx([4, 0], abs=0.4)
    assert plans.speeds[0, 0, :20].mean() == pytest.approx(0.8, abs=0.1)


def test_who_has_no_objective_stays(inbox_of):
    planner = PlannerNode(Config())
    inbox = inbox_of(0.0, PLACE, BODY, OBJECTIVES(Objectives()), agents(a=(1, 2, 0.5, 0)))
    (plans,) = plans_of(planner, inbox)
    assert plans.positions[0, 0, -1] == pytest.approx([1, 2], abs=0.05)
    assert plans.headings[0, 0, -1] == pytest.approx(0.5, abs=0.05)
