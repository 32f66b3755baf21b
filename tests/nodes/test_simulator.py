"""The world node: who is there, what is told of them, kinematic and physical."""

import numpy as np
import pytest

from footfall.messages.body import BodyActions
from footfall.messages.config import ConfigError
from footfall.messages.map import Obstacle, SemanticMap
from footfall.messages.population import Admissions, Enter, Population
from footfall.messages.topics import (
    ADMISSIONS,
    AGENTS,
    BODIES,
    BODY_ACTIONS,
    BODY_STATES,
    CONTACTS,
    FALLS,
    MAP,
    POPULATION,
)
from footfall.models.body import sample_shapes
from footfall.nodes.simulator import Config, Simulator

FLAT = SemanticMap("test", ["walkable"], np.ones((1, 100, 100), np.uint8), 0.2, (-10.0, -10.0))
TICK = 1 / 30


def population(count: int):
    return POPULATION(
        Population(
            np.arange(count, dtype=np.int32),
            np.full(count, -1, np.int32),
            sample_shapes(count, 1).astype(np.float32),
            np.zeros(count),
            np.zeros((count, 2)),
        )
    )


class World:
    """A simulator ticked by hand; keeps the last message of each topic."""

    def __init__(self, inbox_of, count: int, place: SemanticMap = FLAT, **config) -> None:
        self.simulator = Simulator(Config(**config))
        self.fill = inbox_of
        self.inbox = None
        self.first = (MAP(place), population(count))
        self.tick_number = 0
        self.last = {}

    def tick(self, *messages):
        self.inbox = self.fill(self.tick_number * TICK, *self.first, *messages, inbox=self.inbox)
        self.first = ()
        self.tick_number += 1
        sent = [(item.topic, item.message) for item in self.simulator.step(self.inbox)]
        self.last |= dict(sent)
        return dict(sent)


def enter(*people):
    return ADMISSIONS(Admissions([Enter(i, (x, y), heading, speed) for i, x, y, heading, speed in people]))


def act(ids, roots):
    pose = np.zeros((len(ids), 69), np.float32)
    return BODY_ACTIONS(BodyActions(np.array(ids, np.int32), pose, np.array(roots, np.float32)))


def test_bodies_are_told_once_and_nobody_is_there_at_first(inbox_of):
    world = World(inbox_of, 3)
    sent = world.tick()
    assert len(sent[BODIES].ids) == 3
    assert len(sent[AGENTS].ids) == 0
    assert BODIES not in world.tick()


def test_people_enter_walking_where_they_are_told_and_leave(inbox_of):
    world = World(inbox_of, 2)
    world.tick()
    states = world.tick(enter((1, 3.0, -2.0, np.pi / 2, 1.2)))[BODY_STATES]
    assert states.ids.tolist() == [1]
    assert states.positions[0, 0, :2] == pytest.approx([3, -2], abs=0.05)
    assert states.linear_velocities[0, 0, :2] == pytest.approx([0, 1.2], abs=0.3)  # the pelvis sways
    assert 0.0 < states.positions[0, [3, 7], 2].min() < 0.2  # ankles just above the ground
    assert not len(world.tick(ADMISSIONS(Admissions(leave=[1])))[BODY_STATES].ids)


def test_agents_come_at_ten_hertz_with_their_past(inbox_of):
    world = World(inbox_of, 1)
    world.tick()
    world.tick(enter((0, 0.0, 0.0, 0.0, 1.0)))
    height = float(world.last[BODY_STATES].positions[0, 0, 2])
    sent = [AGENTS in world.tick(act([0], [[0.05 * k, 0, height, 1, 0, 0, 0]])) for k in range(1, 31)]
    assert sum(sent) == 10
    history = world.last[AGENTS].history[0]
    assert np.diff(history[-8:, 0]) == pytest.approx(0.15, abs=1e-5)
    assert history[-8:, 3] == pytest.approx(1.5, abs=1e-4)
    assert history[:, 6].sum() == 10
    assert not history[history[:, 6] == 0].any()


def test_a_kinematic_body_is_where_its_action_puts_it(inbox_of):
    world = World(inbox_of, 1)
    world.tick()
    world.tick(enter((0, 0.0, 0.0, 0.0, 0.0)))
    turned = [np.cos(0.4), 0, 0, np.sin(0.4)]
    states = world.tick(act([0], [[1, 2, 0.9, *turned]]))[BODY_STATES]
    assert states.joints[0, 0, :7] == pytest.approx([1, 2, 0.9, *turned], abs=1e-5)
    assert states.linear_velocities[0, 0, :2] == pytest.approx([30, 60], rel=1e-3)  # who stands sways


def test_touching_an_obstacle_or_somebody_is_told(inbox_of):
    wall = Obstacle("wall", np.array([[1.0, -2.0], [2.0, -2.0], [2.0, 2.0], [1.0, 2.0]]))
    place = SemanticMap("test", FLAT.layers, FLAT.raster, FLAT.resolution, FLAT.origin, [wall])
    world = World(inbox_of, 3, place)
    world.tick()
    world.tick(enter((0, 0.95, 0.0, 0.0, 0.0), (1, -5.0, 0.0, 0.0, 0.0), (2, -5.0, 0.2, 0.0, 0.0)))
    world.tick()
    contacts = world.last[CONTACTS]
    pairs = {tuple(pair) for pair in contacts.agents.tolist()}
    assert pairs == {(0, -1), (1, 2)}
    assert contacts.bodies[contacts.agents[:, 1] == -1, 1].tolist() == [0] * int(
        (contacts.agents[:, 1] == -1).sum()
    )
    normals = contacts.normals[contacts.agents[:, 0] == 0]
    assert normals[:, 0].max() > 0.9  # from the person to the wall, which stands at larger x


@pytest.mark.parametrize(
    ("handling", "present"), [("report", [0]), ("remove", []), ("respawn", [0]), ("stand", [0])]
)
def test_who_falls_in_physics_is_told_and_handled(inbox_of, handling, present):
    world = World(inbox_of, 1, mode="physics", on_fall=handling)
    world.tick()
    world.tick(enter((0, 0.0, 0.0, 0.0, 2.5)))
    for _ in range(150):
        world.tick()
        if FALLS in world.last:
            break
    assert world.last[FALLS].ids.tolist() == [0]
    assert world.last[FALLS].handling == handling
    states = world.tick()[BODY_STATES]
    assert states.ids.tolist() == present
    if handling == "respawn":
        assert states.positions[0, 0, :2] == pytest.approx([0, 0], abs=0.05)
    if handling == "stand":
        assert states.positions[0, 0, :2] == pytest.approx(world.last[FALLS].positions[0, :2], abs=0.1)
        assert states.positions[0, 0, 2] > 0.8


def test_a_kinematic_world_refuses_targets_of_joints(inbox_of):
    world = World(inbox_of, 1)
    world.tick()
    world.tick(enter((0, 0.0, 0.0, 0.0, 0.0)))
    with pytest.raises(ConfigError, match="takes mode: physics"):
        world.tick(BODY_ACTIONS(BodyActions(np.zeros(1, np.int32), np.zeros((1, 69), np.float32))))


def test_a_new_map_keeps_people_where_they_are(inbox_of):
    world = World(inbox_of, 1)
    world.tick()
    world.tick(enter((0, 1.0, 1.0, 0.3, 0.0)))
    before = world.tick()[BODY_STATES].joints
    after = world.tick(MAP(FLAT))[BODY_STATES].joints
    assert after[..., :7] == pytest.approx(before[..., :7], abs=1e-6)


def test_a_physics_rate_that_is_no_multiple_of_the_tick_is_refused():
    with pytest.raises(ConfigError, match="100 is not a multiple of 30"):
        Simulator(Config(physics_rate_hz=100))
