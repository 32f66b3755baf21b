"""The world: one MuJoCo simulation of everybody, and the owner of time.

In: map, population (both before the first tick), admissions, body actions (30 Hz), steering. Out: clock and
body states (30 Hz), agents (10 Hz), bodies (latched), contacts and falls (when there are any).
"""

import logging
import sys
from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..messages.agents import HISTORY_STEPS, AgentStates
from ..messages.body import Bodies, BodyStates, Contacts, Falls
from ..messages.config import ConfigError
from ..messages.map import SemanticMap
from ..messages.population import Enter, Population
from ..messages.steering import Push
from ..messages.topics import (
    ADMISSIONS,
    AGENTS,
    BODIES,
    BODY_ACTIONS,
    BODY_STATES,
    CLOCK,
    CONTACTS,
    FALLS,
    MAP,
    POPULATION,
    STEERING,
    Outgoing,
)
from ..models.body import Body, describe
from ..models.body.rotations import yaw
from ..models.pacer.gait_reference import GaitReference
from ..models.world import World, WorldError
from .node import Inbox, Node, NodeConfig
from .place_solids import solids_of
from .spin import spin

log = logging.getLogger(__name__)

TICK_RATE_HZ = 30
"""Ticks, body states and actions per second (PACER, appendix B)."""
BOX_LENGTH = 0.4
"""Extent of a person's box along the heading [m]; its width is twice the body's radius."""


class Config(NodeConfig, frozen=True):
    """How bodies move and what becomes of those who fall."""

    mode: Literal["kinematic", "physics"] = "kinematic"
    """Whether bodies take the commanded pose, or are driven to it by PD torques."""
    actuation: Literal["full", "lite"] = "lite"
    """All 69 joints, or the 28 that walking needs (physics only)."""
    physics_rate_hz: int = 120
    """Physics steps per second; a multiple of 30."""
    on_fall: Literal["report", "stand", "respawn", "remove"] = "report"
    """What happens to who has fallen: nothing, back on the feet there or at the entrance, out of the scene."""


class Simulator(Node[Config]):
    """Moves the bodies and says where they are."""

    Config = Config
    inputs = (MAP, POPULATION, ADMISSIONS, BODY_ACTIONS, STEERING)
    outputs = (CLOCK, AGENTS, BODIES, BODY_STATES, CONTACTS, FALLS)
    requires = (MAP, POPULATION)
    clock_rate_hz = TICK_RATE_HZ

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        if config.physics_rate_hz % TICK_RATE_HZ or config.physics_rate_hz <= 0:
            raise ConfigError(
                f"simulator: config: physics_rate_hz: {config.physics_rate_hz} is not a multiple of "
                f"{TICK_RATE_HZ}"
            )
        self._world: World | None = None
        self._bodies: list[Body] = []
        self._population: Population | None = None
        self._step = 0
        self._down: set[int] = set()
        self._touching: set[tuple[int, ...]] = set()

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """One tick: let people out, take the actions, let 1/30 s pass, let people in, look."""
        outgoing: list[Outgoing] = []
        if self._population is None:
            self._population = inbox.require(POPULATION)
            self._bodies = [describe(shape) for shape in self._population.shapes.astype(np.float64)]
            count = len(self._bodies)
            self._history = np.zeros((count, HISTORY_STEPS, 7), np.float32)
            self._homes = np.zeros((count, 3))
            self._boxes = np.array([[BOX_LENGTH, 2 * body.radius, 1.0] for body in self._bodies])
            outgoing.append(BODIES(describe_bodies(self._population, self._bodies)))
        if inbox.new(MAP) or self._world is None:
            self._world = self._build(inbox.require(MAP))
        world = self._world
        for agent in (agent for admissions in inbox.new(ADMISSIONS) for agent in admissions.leave):
            self._leave(world, agent)
        self._act(world, inbox)
        for steering in inbox.new(STEERING):
            if isinstance(steering.command, Push):
                self._push(world, steering.command)
        if self._step:
            world.advance(1 / TICK_RATE_HZ)
        self._enter(world, [enter for admissions in inbox.new(ADMISSIONS) for enter in admissions.enter])
        present = np.flatnonzero(world.present)
        joints = world.joint_states(present)
        outgoing.append(BODY_STATES(BodyStates(self._population.ids[present], joints)))
        if self._step % 3 == 0:
            outgoing.append(AGENTS(self._agents(present, joints)))
        outgoing += self._contacts(world)
        outgoing += self._falls(world, present)
        self._step += 1
        return outgoing

    def _build(self, semantic_map: SemanticMap) -> World:
        """The world of a map; people in the old one keep their poses."""
        world = World(
            self._bodies,
            *solids_of(semantic_map),
            mode=self.config.mode,
            actuation=self.config.actuation,
            timestep=1 / self.config.physics_rate_hz,
        )
        old = self._world
        if old is not None:
            for agent in np.flatnonzero(old.present).tolist():
                state = old.joint_states([agent])[0, 0].astype(np.float64)
                angles, rates = old.joint_angles([agent])
                world.enter(agent, state[:7], angles[0], state[7:], rates[0])
        return world

    def _enter(self, world: World, entering: list[Enter]) -> None:
        here = world.present
        new = {enter.id: enter for enter in entering if not here[enter.id]}
        if not new:
            return
        agents = list(new)
        self._homes[agents] = [[*enter.position, enter.heading] for enter in new.values()]
        self._history[agents] = 0.0
        self._put(world, agents, self._homes[agents], np.array([enter.speed for enter in new.values()]))

    def _put(self, world: World, agents: list[int], places: np.ndarray, speeds: np.ndarray) -> None:
        """Put people (n,) at places (n, 3): at rest, or in mid-stride where physics must be able to go on from it.

        Args:
            world: where.
            agents: who.
            places: m, m, rad.
            speeds: (n,) m/s.
        """
        gait = GaitReference([self._bodies[agent] for agent in agents], 1 / TICK_RATE_HZ, world.height_at)
        feet = 0.5 * (np.array(agents) % 2)  # who starts with the left, who with the right one
        starts = gait.place(np.arange(len(agents)), places[:, :2], places[:, 2], speeds, feet)
        for agent, root, joints, twist, rates in zip(agents, *starts, strict=True):
            world.enter(agent, root, joints, twist, rates)

    def _leave(self, world: World, agent: int) -> None:
        if world.present[agent]:
            world.leave(agent)
        self._down.discard(agent)

    def _act(self, world: World, inbox: Inbox) -> None:
        actions = inbox.latest(BODY_ACTIONS)
        if actions is None or not inbox.new(BODY_ACTIONS):
            return
        here = np.flatnonzero(world.present[actions.ids])
        ids = actions.ids[here]
        if world.mode == "physics":
            world.set_targets(ids, actions.joint_targets[here].astype(np.float64))
        elif actions.roots is not None:
            world.set_pose(
                ids, actions.roots[here].astype(np.float64), actions.joint_targets[here].astype(np.float64)
            )
        elif len(ids):
            raise ConfigError(
                "simulator: config: mode: 'kinematic' needs a controller that says where bodies are; "
                "this one drives joints, which takes mode: physics"
            )

    def _push(self, world: World, push: Push) -> None:
        ticks = max(1, round(push.duration * TICK_RATE_HZ))
        try:
            world.push(push.agent, push.force, ticks / TICK_RATE_HZ, push.part)
        except WorldError as error:
            log.warning("steering: %s", error)

    def _agents(self, present: np.ndarray, joints: np.ndarray) -> AgentStates:
        """Push the states of those present into the history."""
        assert self._population is not None
        self._history[:, :-1] = self._history[:, 1:]
        self._history[:, -1] = 0.0
        heading = yaw(joints[:, 0, 3:7])
        before, here = self._history[present, -2], joints[:, 0, :2]
        moved = np.linalg.norm(here - before[:, :2], axis=1) * 10.0
        speed = np.where(before[:, 6] > 0, moved, np.linalg.norm(joints[:, 0, 7:9], axis=1))
        self._history[present, -1, :2] = here
        self._history[present, -1, 2] = heading
        self._history[present, -1, 3] = speed
        self._history[present, -1, 4:7] = self._boxes[present]
        population = self._population
        return AgentStates(population.ids[present], population.groups[present], self._history[present])

    def _contacts(self, world: World) -> Iterable[Outgoing]:
        """Touches of people with others and obstacles, told when they begin or end."""
        found = world.contacts()
        found = found.select((found.other >= 0) | (found.other_part >= 0))
        touching = set(
            zip(*(c.tolist() for c in (found.agent, found.part, found.other, found.other_part)), strict=True)
        )
        if touching == self._touching:
            return
        self._touching = touching
        yield CONTACTS(
            Contacts(
                agents=np.column_stack([found.agent, found.other]).astype(np.int32),
                bodies=np.column_stack([found.part, found.other_part]).astype(np.int32),
                positions=found.position.astype(np.float32),
                normals=(-found.normal).astype(np.float32),
                forces=found.force.astype(np.float32),
            )
        )

    def _falls(self, world: World, present: np.ndarray) -> Iterable[Outgoing]:
        """Who has just fallen; they are handled as configured."""
        if not len(present) or world.mode == "kinematic":
            return
        down = {int(agent) for agent in present[world.fallen(present)]}
        new = sorted(down - self._down)
        self._down = down
        if not new:
            return
        states = world.joint_states(new)[:, 0]
        positions = states[:, :3]
        handling = self.config.on_fall
        if handling != "report":
            for agent in new:
                world.leave(agent)
            self._down.difference_update(new)
        if handling == "respawn":
            self._put(world, new, self._homes[new], np.zeros(len(new)))
        elif handling == "stand":
            places = states[:, [0, 1, 3]].astype(np.float64)
            places[:, 2] = yaw(states[:, 3:7].astype(np.float64))
            self._put(world, new, places, np.zeros(len(new)))
        yield FALLS(Falls(np.array(new, np.int32), positions, self.config.on_fall))


def describe_bodies(population: Population, bodies: list[Body]) -> Bodies:
    """What everybody is made of."""
    return Bodies(
        ids=population.ids,
        shapes=population.shapes,
        masses=np.array([body.mass for body in bodies], np.float32),
        statures=np.array([body.stature for body in bodies], np.float32),
        radii=np.array([body.radius for body in bodies], np.float32),
        offsets=np.stack([body.offsets for body in bodies]).astype(np.float32),
    )


if __name__ == "__main__":
    sys.exit(spin(Simulator))
