"""Steering: what the nodes make of commands."""

import logging

import numpy as np
import pytest

from footfall.messages.agents import AgentStates
from footfall.messages.clock import Clock
from footfall.messages.objectives import SocialDistance, TargetSpeed, Waypoint
from footfall.messages.steering import (
    BreakGroup,
    DropObstacle,
    MakeGroup,
    Push,
    Remove,
    RemoveObstacle,
    SetDistance,
    SetSpeed,
    SetWaypoint,
    SetWeight,
    Spawn,
    Steering,
)
from footfall.messages.topics import (
    ADMISSIONS,
    AGENTS,
    BODY_STATES,
    CLOCK,
    MAP,
    OBJECTIVES,
    POPULATION,
    STEERING,
)
from footfall.nodes.director import Config, Director
from footfall.nodes.map_server import Config as MapConfig
from footfall.nodes.map_server import MapServer
from footfall.nodes.simulator import Config as SimulatorConfig
from footfall.nodes.simulator import Simulator


def agents(places: dict[int, tuple[float, float]]):
    history = np.zeros((len(places), 31, 7), np.float32)
    history[:, -1, :2] = np.array(list(places.values())).reshape(-1, 2)
    history[:, -1, 6] = 1
    return AGENTS(AgentStates(np.array(list(places), np.int32), np.full(len(places), -1, np.int32), history))


def sent(outgoing, topic):
    return [item.message for item in outgoing if item.topic is topic]


def steer(command):
    return STEERING(Steering(command))


class Directed:
    """A director with everybody inside, far from their goals."""

    def __init__(self, inbox_of, **config) -> None:
        self.node = Director(Config(scene="crossing", **config))
        self.inbox_of = inbox_of
        self.now = 60.0
        self.places: dict[int, tuple[float, float]] = {}
        self.inbox = inbox_of(self.now, agents({}))
        for admissions in sent(self.node.step(self.inbox), ADMISSIONS):
            self.places = {enter.id: enter.position for enter in admissions.enter}

    def ask(self, *commands):
        """Steer once; returns admissions and objectives sent."""
        self.now += 0.1
        self.inbox = self.inbox_of(
            self.now, agents(self.places), *(steer(c) for c in commands), inbox=self.inbox
        )
        outgoing = list(self.node.step(self.inbox))
        return sent(outgoing, ADMISSIONS), sent(outgoing, OBJECTIVES)


@pytest.fixture
def directed(inbox_of):
    return Directed(inbox_of)


def wishes(objectives, agent, kind):
    mine = next(a for a in objectives.agents if a.id == agent)
    return next(wish for wish in mine.objectives if isinstance(wish, kind))


def test_waypoint_speed_distance_and_weight_reach_the_objectives(directed):
    _, (told,) = directed.ask(
        SetWaypoint(3, (1.5, -2.0), at=90.0),
        SetSpeed(3, 2.1),
        SetDistance(None, 0.7),
        SetWeight(3, "Waypoint", 4.0),
    )
    assert wishes(told, 3, Waypoint) == Waypoint((1.5, -2.0), at=90.0, weight=4.0)
    assert wishes(told, 3, TargetSpeed).speed == 2.1
    assert wishes(told, 3, TargetSpeed).weight == 1.0
    assert {wishes(told, agent, SocialDistance).gap for agent in directed.places} == {0.7}
    assert wishes(told, 4, Waypoint).weight == 1.0
    assert directed.ask() == ([], [])  # nothing is repeated


def test_a_time_of_arrival_is_over_on_arrival(directed):
    directed.ask(SetWaypoint(3, (1.5, -2.0), at=90.0))
    directed.places[3] = (1.5, -2.0)
    (admissions,), (told,) = directed.ask()
    assert admissions.reached == [3]
    assert wishes(told, 3, Waypoint).at is None


def test_groups_are_made_left_and_broken(directed):
    _, (told,) = directed.ask(MakeGroup([5, 1, 2], leader=2, distance=1.5), SetWeight(1, "Group", 3.0))
    group = next(g for g in told.groups if g.members == [1, 2, 5])
    assert (group.leader, group.distance, group.weight) == (2, 1.5, 3.0)
    _, (told,) = directed.ask(MakeGroup([1, 7]))
    assert sum(1 in g.members for g in told.groups) == 1
    assert [2, 5] in [g.members for g in told.groups]
    _, (told,) = directed.ask(BreakGroup(7))
    assert not any(1 in g.members or 7 in g.members for g in told.groups)


def test_somebody_is_taken_out_and_somebody_let_in(directed):
    (admissions,), (told,) = directed.ask(Remove(4))
    assert admissions.leave == [4] and 4 not in [a.id for a in told.agents]
    del directed.places[4]
    assert directed.ask(Remove(4)) == ([], [])
    spot = (0.0, 0.0)
    (admissions,), (told,) = directed.ask(Spawn(spot, goal=(5.0, 0.0)))
    (enter,) = admissions.enter
    assert enter.id == 4 and np.linalg.norm(np.subtract(enter.position, spot)) < 1.2
    assert wishes(told, 4, Waypoint).position == (5.0, 0.0)


def test_the_reserve_comes_only_when_asked_and_changes_nobody_else(inbox_of):
    plain, with_reserve = Directed(inbox_of), Directed(inbox_of, spare=2)
    assert with_reserve.places == plain.places
    (population,) = sent(with_reserve.node.start(), POPULATION)
    assert len(population.ids) == 22
    (admissions,), _ = with_reserve.ask(Spawn((0.0, 0.0)))
    assert [enter.id for enter in admissions.enter] == [20]


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (SetSpeed(99, 1.0), "no person 99"),
        (MakeGroup([1, 77]), "no person 77"),
        (MakeGroup([1, 1]), "two members"),
        (MakeGroup([1, 2], leader=3), "leader"),
        (Spawn((0.0, 0.0)), "everybody is there"),
    ],
)
def test_what_cannot_be_done_is_said_and_changes_nothing(directed, caplog, command, text):
    with caplog.at_level(logging.WARNING):
        assert directed.ask(command) == ([], [])
    assert text in caplog.text


def test_commands_of_others_leave_the_director_alone(directed):
    assert directed.ask(RemoveObstacle("x"), Push(1, (1.0, 0.0, 0.0))) == ([], [])


def clock(inbox_of, now, *messages, inbox=None):
    return inbox_of(now, CLOCK(Clock(0, 1, "lockstep")), *messages, inbox=inbox)


SQUARE = [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)]  # clockwise


def test_obstacles_are_dropped_and_removed(inbox_of):
    server = MapServer(MapConfig(scene="crossing"))
    (before,) = sent(server.start(), MAP)
    inbox = clock(inbox_of, 1.0, steer(DropObstacle("crate", SQUARE, 1.5)))
    (after,) = sent(server.step(inbox), MAP)
    assert [o.name for o in after.obstacles] == [*(o.name for o in before.obstacles), "crate"]
    x, y = after.obstacles[-1].polygon.T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2 == pytest.approx(1.0)  # counter-clockwise
    solid = after.layers.index("obstacle")
    cell = ((np.array([0.5, 0.5]) - after.origin) / after.resolution).astype(int)
    assert (before.raster[solid, cell[1], cell[0]], after.raster[solid, cell[1], cell[0]]) == (0, 1)
    inbox = clock(inbox_of, 2.0, steer(RemoveObstacle("crate")), inbox=inbox)
    (again,) = sent(server.step(inbox), MAP)
    assert np.array_equal(again.raster, before.raster)
    assert not server.step(clock(inbox_of, 3.0, inbox=inbox))


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (DropObstacle("x", [(0, 0), (1, 1), (1, 0), (0, 1)]), "not a simple polygon"),
        (DropObstacle("x", [(0, 0), (1, 1), (2, 2)]), "not a simple polygon"),
        (RemoveObstacle("x"), "no obstacle"),
    ],
)
def test_obstacles_that_cannot_be_are_refused(inbox_of, caplog, command, text):
    server = MapServer(MapConfig(scene="crossing"))
    assert not server.step(clock(inbox_of, 1.0, steer(command)))
    assert text in caplog.text


def test_a_push_moves_a_body_in_physics_and_is_refused_in_a_kinematic_world(inbox_of, caplog):
    director = Director(Config(scene="corridor", count=1))
    semantic_map = next(iter(MapServer(MapConfig(scene="corridor")).start()))
    population = next(item for item in director.start() if item.topic is POPULATION)
    entrance = next(iter(director.step(inbox_of(60.0, agents({})))))
    speeds, states = {}, None
    for force in (0.0, 400.0):
        simulator = Simulator(SimulatorConfig(mode="physics"))
        inbox = inbox_of(0.0, semantic_map, population, entrance)
        list(simulator.step(inbox))
        inbox = inbox_of(0.1, steer(Push(0, (0.0, force, 0.0), 0.1)), inbox=inbox)
        for _ in range(4):
            (states,) = sent(simulator.step(inbox), BODY_STATES)
            inbox = inbox_of(0.2, inbox=inbox)
        assert states is not None
        speeds[force] = states.linear_velocities[0, 11, 1]  # chest
    assert speeds[400.0] > speeds[0.0] + 0.3
    simulator = Simulator(SimulatorConfig(mode="kinematic"))
    list(simulator.step(inbox_of(0.0, semantic_map, population, entrance, steer(Push(0, (1.0, 0.0, 0.0))))))
    assert "kinematic" in caplog.text
