"""Moves bodies along their plans.

In: map, bodies, plans, agents, body states (30 Hz, causes a step). Out: body actions (30 Hz).
Method `gait`: a kinematic walk without physics, for huge crowds.
"""

import sys
from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..messages.body import BodyActions
from ..messages.plan import PLAN_DT
from ..messages.topics import AGENTS, BODIES, BODY_ACTIONS, BODY_STATES, MAP, PLANS, Outgoing
from ..models.body import Body, describe
from ..models.gait import Command, Gait
from ..models.scene import Terrain
from .node import Inbox, Node, NodeConfig
from .spin import spin

TICK = 1 / 30
"""Time from a body state to the pose its action asks for [s]."""


class Config(NodeConfig, frozen=True):
    """How bodies are moved."""

    method: Literal["gait"] = "gait"
    """`gait`: kinematic walk along the plan."""
    max_turn_rate: float = 3.0
    """Fastest turn of the body [rad/s]."""


class Controller(Node[Config]):
    """Turns plans into poses."""

    Config = Config
    inputs = (MAP, BODIES, PLANS, AGENTS, BODY_STATES)
    outputs = (BODY_ACTIONS,)
    requires = (MAP, BODIES, BODY_STATES)
    trigger = BODY_STATES

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._gait: Gait | None = None
        self._bodies: dict[int, Body] = {}
        self._followed: dict[int, Follower] = {}
        self._until: float | None = None
        """Simulation time of the pose that was asked for last [s]."""

    def on_time_jump(self) -> None:
        """Forget who walked where."""
        self._gait = None
        self._followed = {}
        self._until = None

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Poses for everybody one tick from now."""
        for bodies in inbox.new(BODIES):
            shapes = bodies.shapes.astype(np.float64)
            self._bodies = {i: describe(shape) for i, shape in zip(bodies.ids.tolist(), shapes, strict=True)}
        gait = self._gait
        if gait is None or inbox.new(MAP):
            gait = self._gait = self._ground(inbox, gait)
        self._attend(gait, inbox)
        self._take_plans(inbox)
        followers = [self._followed[i] for i in gait.ids.tolist()]
        until = inbox.now + TICK
        elapsed = TICK if self._until is None else until - self._until  # more where ticks were missed
        self._until = until
        if not followers:
            return [
                BODY_ACTIONS(
                    BodyActions(
                        np.zeros(0, np.int32), np.zeros((0, 69), np.float32), np.zeros((0, 7), np.float32)
                    )
                )
            ]
        for follower in followers:
            follower.advance(until, self.config.max_turn_rate)
        command = Command.of(
            position=[f.position for f in followers],
            heading=[f.heading for f in followers],
            speed=[f.speed for f in followers],
            turn_rate=[f.turn_rate for f in followers],
        )
        roots, joints = gait.update(command, elapsed if elapsed > 0 else TICK)
        ids = gait.ids.astype(np.int32)
        return [BODY_ACTIONS(BodyActions(ids, joints.astype(np.float32), roots.astype(np.float32)))]

    def _ground(self, inbox: Inbox, old: Gait | None) -> Gait:
        """A gait on the map's ground; walkers of an old one walk on."""
        terrain = inbox.require(MAP).terrain
        if terrain is None:
            gait = Gait()
        else:
            gait = Gait(Terrain(np.array(terrain.heights), terrain.resolution, terrain.origin).height_at)
        if old is not None:
            gait.state = old.state
        return gait

    def _attend(self, gait: Gait, inbox: Inbox) -> None:
        """Take over newcomers where they stand; let go of who has left."""
        states = inbox.require(BODY_STATES)
        present = states.ids.tolist()
        here = set(present)
        if gone := sorted(set(self._followed) - here):
            gait.leave(gone)
            for agent in gone:
                del self._followed[agent]
        new = [row for row, agent in enumerate(present) if agent not in self._followed]
        if not new:
            return
        w, x, y, z = states.rotations[new, 0].astype(np.float64).T
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        position = states.positions[new, 0, :2].astype(np.float64)
        speed = np.linalg.norm(states.linear_velocities[new, 0, :2], axis=1).astype(np.float64)
        ids = [present[row] for row in new]
        gait.enter(ids, [self._bodies[i] for i in ids], position, heading, speed)
        for row, agent in enumerate(ids):
            self._followed[agent] = Follower(inbox.now, position[row], float(heading[row]), float(speed[row]))

    def _take_plans(self, inbox: Inbox) -> None:
        for plans in inbox.received(PLANS):
            message = plans.message
            for row, agent in enumerate(message.ids.tolist()):
                if agent in self._followed:
                    chosen = int(message.chosen[row])
                    self._followed[agent].take(
                        plans.stamp_ns * 1e-9,
                        message.positions[row, chosen].astype(np.float64),
                        message.headings[row, chosen].astype(np.float64),
                    )


class Follower:
    """One pedestrian's way along its plan: continuous where plans join, turning no faster than a body can."""

    def __init__(self, time: float, position: np.ndarray, heading: float, speed: float) -> None:
        self.time = time
        self.position = position
        """Commanded ground position (2,) at `time`, world [m]."""
        self.heading = heading
        self.speed = speed
        self.turn_rate = 0.0
        self._times = np.array([time])
        self._way = np.array([[*position, heading]])

    def take(self, stamp: float, points: np.ndarray, headings: np.ndarray) -> None:
        """Follow points (T, 2) [m] and headings (T,) [rad] `PLAN_DT` apart after `stamp` from here on."""
        times = stamp + PLAN_DT * np.arange(1, len(points) + 1)
        ahead = times > self.time + 1e-6
        headings = np.unwrap(np.concatenate([[self.heading], headings[ahead]]))
        self._times = np.concatenate([[self.time], times[ahead]])
        self._way = np.column_stack([np.vstack([self.position, points[ahead]]), headings])

    def advance(self, until: float, max_turn_rate: float) -> None:
        """Be where the plan is at the time `until` [s]; at its end, or without one, stand."""
        dt = until - self.time
        if dt <= 0:
            return
        self.time = until
        x, y, heading = (float(np.interp(self.time, self._times, column)) for column in self._way.T)
        turn = (heading - self.heading + np.pi) % (2 * np.pi) - np.pi
        turn = float(np.clip(turn, -max_turn_rate * dt, max_turn_rate * dt))
        target = np.array([x, y])
        self.speed = float(np.linalg.norm(target - self.position)) / dt
        self.turn_rate = turn / dt
        self.heading += turn
        self.position = target


if __name__ == "__main__":
    sys.exit(spin(Controller))
