"""Plans where everybody walks in the next five seconds.

In: map, bodies, objectives, agents (10 Hz, causes a step). Out: plans, at `rate_hz`.
Methods: `orca` (reciprocal collision avoidance along the shortest way), `constant_velocity` (the baseline).
"""

import sys
from collections.abc import Iterable
from time import perf_counter
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from ..messages.agents import AgentStates
from ..messages.body import Bodies
from ..messages.map import SemanticMap
from ..messages.objectives import Objectives, SocialDistance, TargetSpeed, Waypoint
from ..messages.plan import Plans
from ..messages.topics import AGENTS, BODIES, MAP, OBJECTIVES, PLANS, Outgoing
from ..models.crowd.orca_planner import OrcaPlanner, Place
from ..models.crowd.planning import PLAN_DT, ConstantVelocity, Crowd, Futures, Planner
from .node import Inbox, Node, NodeConfig
from .spin import spin

DEFAULT_SPEED = 1.34
"""Free walking speed where no objective names one [m/s] (Weidmann 1993)."""


ROAD_COST = 4.0
"""A metre of road counts as so many metres of pavement for somebody who looks for a way."""


class Config(NodeConfig, frozen=True):
    """Which method plans, and how often."""

    method: Literal["orca", "constant_velocity"] = "orca"
    rate_hz: Annotated[float, Meta(gt=0, le=10)] = 2.0
    """Plans per simulated second, at most 10; who enters gets a plan at once."""
    stitch: float = 0.15
    """A new plan starts from where the last one has the pedestrian now, if they are that close to it [m];
    so the sway of a walking body does not get into the plans."""
    margin: float = 0.05
    """Added to every body's radius [m]."""


class PlannerNode(Node[Config]):
    """Looks ahead for everybody."""

    Config = Config
    inputs = (MAP, BODIES, OBJECTIVES, AGENTS)
    outputs = (PLANS,)
    requires = (MAP, BODIES, OBJECTIVES, AGENTS)
    trigger = AGENTS

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._planner: Planner | None = None
        self._next_ns = 0
        self._last: Plans | None = None
        self._last_stamp = 0.0

    def configure(self, config: Config) -> None:
        """Change method or rate while running."""
        super().configure(config)
        self._planner = None

    def on_time_jump(self) -> None:
        """Forget the last plan."""
        self._last = None
        self._next_ns = 0

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Plan anew when it is time to."""
        if inbox.new(MAP) or self._planner is None:
            self._planner = self._make(inbox.require(MAP))
        agents = inbox.require(AGENTS)
        planned = self._last is not None and set(agents.ids.tolist()) <= set(self._last.ids.tolist())
        if planned and inbox.now_ns < self._next_ns:
            return []
        self._next_ns = inbox.now_ns + round(1e9 / self.config.rate_hz) - 1_000_000
        begin = perf_counter()
        crowd = self._crowd(agents, inbox.require(BODIES), inbox.require(OBJECTIVES), inbox.now)
        futures = self._planner.plan(crowd)
        plans = message_of(agents.ids, futures, self.config.method, perf_counter() - begin)
        self._last, self._last_stamp = plans, inbox.now
        self.facts["planning_time"] = plans.planning_time
        return [PLANS(plans)]

    def _make(self, semantic_map: SemanticMap) -> Planner:
        if self.config.method == "constant_velocity":
            return ConstantVelocity()
        return OrcaPlanner(place_of(semantic_map))

    def _crowd(self, agents: AgentStates, bodies: Bodies, objectives: Objectives, now: float) -> Crowd:
        """The crowd as the planner sees it, with what everybody is asked to do."""
        states = agents.now.astype(np.float64)
        position, heading = states[:, :2].copy(), states[:, 2].copy()
        velocity = states[:, 3:4] * np.column_stack([np.cos(heading), np.sin(heading)])
        self._stitch(agents.ids, position, heading, velocity, now)
        radii = dict(zip(bodies.ids.tolist(), bodies.radii.astype(float).tolist(), strict=True))
        wishes = {wish.id: wish.objectives for wish in objectives.agents}
        goal, speed, gap = position.copy(), np.full(len(states), DEFAULT_SPEED), np.zeros(len(states))
        for row, agent in enumerate(agents.ids.tolist()):
            for wish in wishes.get(agent, ()):
                match wish:
                    case TargetSpeed():
                        speed[row] = wish.speed
                    case SocialDistance():
                        gap[row] = wish.gap
            for wish in wishes.get(agent, ()):
                if isinstance(wish, Waypoint):
                    goal[row] = wish.position
                    if wish.at is not None:
                        left = max(wish.at - now, PLAN_DT)
                        speed[row] = np.linalg.norm(goal[row] - position[row]) / left
        group = np.full(len(states), -1)
        for social in objectives.groups:
            group[np.isin(agents.ids, social.members)] = social.id
        own = np.array([radii[agent] for agent in agents.ids.tolist()]).reshape(len(states))
        return Crowd(position, velocity, heading, own + self.config.margin + gap / 2, goal, speed, group)

    def _stitch(
        self, ids: np.ndarray, position: np.ndarray, heading: np.ndarray, velocity: np.ndarray, now: float
    ) -> None:
        """Start (in place) from the last plan's states of now, for everybody who is where it had them."""
        if self._last is None:
            return
        index = round((now - self._last_stamp) / PLAN_DT) - 1
        if not 0 <= index < self._last.positions.shape[2]:
            return
        row_of = {agent: row for row, agent in enumerate(self._last.ids.tolist())}
        for row, agent in enumerate(ids.tolist()):
            if (old := row_of.get(agent)) is None:
                continue
            chosen = int(self._last.chosen[old])
            planned = self._last.positions[old, chosen, index].astype(np.float64)
            if np.linalg.norm(planned - position[row]) < self.config.stitch:
                position[row] = planned
                heading[row] = self._last.headings[old, chosen, index]
                speed = float(self._last.speeds[old, chosen, index])
                velocity[row] = speed * np.array([np.cos(heading[row]), np.sin(heading[row])])


def place_of(semantic_map: SemanticMap) -> Place:
    """What a map means for somebody who looks for a way."""
    layers = {name: layer > 0 for name, layer in zip(semantic_map.layers, semantic_map.raster, strict=True)}
    cost = np.ones(semantic_map.raster.shape[1:])
    if "road" in layers:
        crosswalk = layers.get("crosswalk", np.zeros_like(layers["road"]))
        cost[layers["road"] & ~crosswalk] = ROAD_COST
    return Place(
        blocked=~layers["walkable"] | layers.get("obstacle", np.zeros_like(layers["walkable"])),
        cost=cost,
        resolution=semantic_map.resolution,
        origin=semantic_map.origin,
        obstacles=[np.array(obstacle.polygon) for obstacle in semantic_map.obstacles],
    )


def message_of(ids: np.ndarray, futures: Futures, method: str, planning_time: float) -> Plans:
    """Futures as a message."""
    names = sorted(futures.losses)
    return Plans(
        ids=ids,
        chosen=futures.chosen.astype(np.int32),
        positions=futures.positions.astype(np.float32),
        headings=futures.headings.astype(np.float32),
        speeds=futures.speeds.astype(np.float32),
        method=method,
        loss_names=names,
        losses=np.stack([futures.losses[name] for name in names], axis=-1).astype(np.float32)
        if names
        else None,
        planning_time=planning_time,
    )


if __name__ == "__main__":
    sys.exit(spin(PlannerNode))
