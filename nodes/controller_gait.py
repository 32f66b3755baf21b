"""The kinematic walk as a control method: bodies are where their plans are, without physics."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..messages.plan import PLAN_DT
from ..models.body import Body
from ..models.body.rotations import yaw
from ..models.gait import Command, Gait
from ..models.gait.footholds import HeightAt
from ..models.scene import Obstacle

Array = NDArray[np.float64]


class GaitMethod:
    """Feet that do not skate under bodies that glide along their plans.

    Args:
        tick: Time from one step to the next [s].
        max_turn_rate: Fastest turn of a body [rad/s].
    """

    def __init__(self, tick: float, max_turn_rate: float) -> None:
        self._tick = tick
        self._max_turn_rate = max_turn_rate
        self._gait = Gait()
        self._followers: dict[int, Follower] = {}
        self._until: float | None = None
        """Simulation time of the pose that was asked for last [s]."""

    @property
    def ids(self) -> list[int]:
        """Who walks, in the order of what `step` returns."""
        return self._gait.ids.tolist()

    def ground(self, height_at: HeightAt, obstacles: Sequence[Obstacle]) -> None:
        """Walk on other ground from here on, among other obstacles."""
        state = self._gait.state
        self._gait = Gait(height_at)
        self._gait.state = state

    def enter(self, ids: Sequence[int], bodies: Sequence[Body], states: Array, now: float) -> None:
        """Take over newcomers as they stand or walk: states (n, 24, 13)."""
        position, heading = states[:, 0, :2], yaw(states[:, 0, 3:7])
        speed = np.linalg.norm(states[:, 0, 7:9], axis=1)
        self._gait.enter(ids, bodies, position, heading, speed)
        for agent, *start in zip(ids, position, heading.tolist(), speed.tolist(), strict=True):
            self._followers[agent] = Follower(now, *start)

    def leave(self, ids: Sequence[int]) -> None:
        """Let go of people."""
        self._gait.leave(ids)
        for agent in ids:
            del self._followers[agent]

    def take(self, agent: int, stamp: float, points: Array, headings: Array) -> None:
        """Give a person a new plan: points (T, 2) and headings (T,), `PLAN_DT` apart after `stamp`."""
        self._followers[agent].take(stamp, points, headings)

    def step(self, states: Array, now: float) -> tuple[Array, Array | None]:
        """Hinge angles (N, 69) [rad] and pelvis poses (N, 7) one tick from now [s]."""
        until = now + self._tick
        elapsed = self._tick if self._until is None else until - self._until  # more where ticks were missed
        self._until = until
        followers = [self._followers[agent] for agent in self.ids]
        if not followers:
            return np.zeros((0, 69)), np.zeros((0, 7))
        for follower in followers:
            follower.advance(until, self._max_turn_rate)
        command = Command.of(
            position=[f.position for f in followers],
            heading=[f.heading for f in followers],
            speed=[f.speed for f in followers],
            turn_rate=[f.turn_rate for f in followers],
        )
        roots, joints = self._gait.update(command, elapsed if elapsed > 0 else self._tick)
        return joints, roots


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
