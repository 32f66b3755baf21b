"""Moves bodies along their plans.

In: map, bodies, plans, agents, body states (30 Hz, causes a step). Out: body actions (30 Hz).
Method `gait`: a kinematic walk without physics, for huge crowds. Method `pacer`: a trained policy that drives the
joints of bodies in physics; needs torch.
"""

import sys
from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..messages.body import BodyActions
from ..messages.config import ConfigError
from ..messages.topics import AGENTS, BODIES, BODY_ACTIONS, BODY_STATES, MAP, PLANS, Outgoing
from ..models.body import Body, describe
from ..models.gait import flat_ground
from .controller_gait import GaitMethod
from .controller_method import Attendance, Method
from .node import Inbox, Node, NodeConfig
from .place_solids import solids_of
from .spin import spin

TICK = 1 / 30
"""Time from a body state to the pose its action asks for [s]."""


class Config(NodeConfig, frozen=True):
    """How bodies are moved."""

    method: Literal["gait", "pacer"] = "gait"
    """`gait`: kinematic walk along the plan. `pacer`: trained policy, for a simulator in physics mode."""
    max_turn_rate: float = 3.0
    """gait: fastest turn of the body [rad/s]."""
    weights: str | None = None
    """pacer: a walker's safetensors file; null is the shipped one."""
    threads: int = 1
    """pacer: threads of torch."""


class Controller(Node[Config]):
    """Turns plans into poses, or into targets of the joints."""

    Config = Config
    inputs = (MAP, BODIES, PLANS, AGENTS, BODY_STATES)
    outputs = (BODY_ACTIONS,)
    requires = (MAP, BODIES, BODY_STATES)
    trigger = BODY_STATES

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._bodies: dict[int, Body] = {}
        self.on_time_jump()

    def on_time_jump(self) -> None:
        """Forget who walked where."""
        self._method = _make(self.config)
        self._attendance = Attendance()
        self._grounded = False
        self._before = 0.0
        """Simulation time of the last step [s]."""

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Poses or targets for everybody until one tick from now."""
        for bodies in inbox.new(BODIES):
            shapes = bodies.shapes.astype(np.float64)
            self._bodies = {i: describe(shape) for i, shape in zip(bodies.ids.tolist(), shapes, strict=True)}
        if inbox.new(MAP) or not self._grounded:
            obstacles, ground = solids_of(inbox.require(MAP))
            self._method.ground(ground.height_at if ground else flat_ground, obstacles)
            self._grounded = True
        method = self._method
        message = inbox.require(BODY_STATES)
        states = message.joints.astype(np.float64)
        rows = {agent: row for row, agent in enumerate(message.ids.tolist())}
        come, gone = self._attendance.look(list(rows), states[:, 0, :2], inbox.now - self._before)
        self._before = inbox.now
        if gone:
            method.leave(gone)
        if come:
            method.enter(come, [self._bodies[i] for i in come], states[[rows[i] for i in come]], inbox.now)
        self._take_plans(inbox, rows)
        ids = method.ids
        joints, roots = method.step(states[[rows[i] for i in ids]], inbox.now)
        floats = None if roots is None else roots.astype(np.float32)
        return [BODY_ACTIONS(BodyActions(np.array(ids, np.int32), joints.astype(np.float32), floats))]

    def _take_plans(self, inbox: Inbox, here: dict[int, int]) -> None:
        for plans in inbox.received(PLANS):
            message = plans.message
            for row, agent in enumerate(message.ids.tolist()):
                if agent in here:
                    chosen = int(message.chosen[row])
                    points = message.positions[row, chosen].astype(np.float64)
                    headings = message.headings[row, chosen].astype(np.float64)
                    self._method.take(agent, plans.stamp_ns * 1e-9, points, headings)


def _make(config: Config) -> Method:
    """The control method.

    Raises:
        ConfigError: It cannot be had: no torch, broken weights.
    """
    if config.method == "gait":
        return GaitMethod(TICK, config.max_turn_rate)
    try:
        import torch  # noqa: F401
    except ImportError:
        raise ConfigError(
            "controller: config: method: 'pacer' needs torch; install footfall[learn], or choose gait"
        ) from None
    from .controller_pacer import PacerMethod

    return PacerMethod(TICK, config.weights, config.threads)


if __name__ == "__main__":
    sys.exit(spin(Controller))
