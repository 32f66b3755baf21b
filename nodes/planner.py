"""Plans where everybody walks in the next five seconds.

In: map, bodies, objectives, agents (10 Hz, causes a step). Out: plans, at `rate_hz`.
Methods: `trace` (guided trajectory diffusion), `orca` (reciprocal collision avoidance along the shortest way),
`constant_velocity` (the baseline).
"""

import logging
import sys
from collections.abc import Iterable
from time import perf_counter
from typing import Annotated, Literal, Protocol

import msgspec
import numpy as np
from msgspec import Meta, field

from ..messages.agents import AgentStates
from ..messages.config import ConfigError
from ..messages.map import SemanticMap
from ..messages.objectives import Objectives
from ..messages.plan import Plans
from ..messages.topics import AGENTS, BODIES, MAP, OBJECTIVES, PLANS, Outgoing
from ..models.crowd.convex_obstacles import ObstacleError
from ..models.crowd.navigation import NavigationError
from ..models.crowd.orca_planner import OrcaPlanner
from ..models.crowd.planning import PLAN_DT, ConstantVelocity, Futures, Planner
from .node import Inbox, Node, NodeConfig
from .planner_moment import Moment, moment_of, place_of
from .spin import spin

log = logging.getLogger(__name__)

RATES_HZ = {"trace": 1.0, "orca": 2.0, "constant_velocity": 2.0}
"""Plans per simulated second where the configuration names no rate; 1 Hz is TRACE's (app. C.2)."""
SLACK_NS = 1_000_000
"""A plan may be made so much before its period is over."""


class Config(NodeConfig, frozen=True):
    """Which method plans, and how often."""

    method: Literal["trace", "orca", "constant_velocity"] = "orca"
    rate_hz: Annotated[float, Meta(gt=0, le=10)] | None = None
    """Plans per simulated second, at most 10; None for the method's own. When somebody enters, or is asked
    something new, all are planned at once."""
    stitch: float = 0.15
    """A new plan starts from where the last one has the pedestrian now, if they are that close to it [m];
    so the sway of a walking body does not get into the plans."""
    margin: float = 0.05
    """Added to every body's radius [m]."""
    samples: Annotated[int, Meta(ge=1, le=200)] = 10
    """Futures a pedestrian (`trace`)."""
    steps: Annotated[int, Meta(ge=1, le=100)] = 4
    """Denoising steps of a first plan, 4 with distilled weights; later plans take fewer (`trace`)."""
    context_weight: Annotated[float, Meta(ge=-1, le=10)] = 0.0
    """w of classifier-free sampling (eq 4), at twice the time; distilled weights have .5 in them (`trace`)."""
    guidance: Literal["direct", "clean", "noisy"] = "direct"
    """Where gradients of the objectives are taken (`trace`)."""
    weights: str | None = None
    """File of weights instead of the shipped ones (`trace`)."""
    objectives: tuple[str, ...] = ()
    """Python files or modules that register objectives of one's own (`trace`)."""
    ask: dict[str, dict[str, float]] = field(default_factory=dict)
    """Registered objectives that everybody is asked, with their parameters and `weight` (`trace`)."""
    threads: Annotated[int, Meta(ge=1)] = 1
    """Of the network (`trace`); the same number gives the same bytes."""


class Method(Protocol):
    """A way of planning."""

    def place(self, semantic_map: SemanticMap) -> None:
        """Take a new map."""
        ...

    def plan(self, moment: Moment) -> Futures:
        """The futures of everybody."""
        ...


class PlannerNode(Node[Config]):
    """Looks ahead for everybody."""

    Config = Config
    inputs = (MAP, BODIES, OBJECTIVES, AGENTS)
    outputs = (PLANS,)
    requires = (MAP, BODIES, OBJECTIVES, AGENTS)
    trigger = AGENTS

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._method = self._make(config)
        self._placed = False
        self._radii: dict[int, float] = {}
        self._next_ns = 0
        self._last: Plans | None = None
        self._last_stamp = 0.0
        self._asked: dict[int, bytes] = {}
        self._late = 0

    def configure(self, config: Config) -> None:
        """Change method or settings while running."""
        self._method, self._placed = self._make(config), False
        super().configure(config)

    def on_time_jump(self) -> None:
        """Forget the last plan."""
        self._last, self._asked = None, {}
        self._next_ns = 0
        self._method, self._placed = self._make(self.config), False

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Plan anew when it is time to."""
        if inbox.new(MAP) or not self._placed:
            self._look_at(inbox.require(MAP))
        if inbox.new(BODIES) or not self._radii:
            bodies = inbox.require(BODIES)
            self._radii = dict(zip(bodies.ids.tolist(), bodies.radii.astype(float).tolist(), strict=True))
        agents = inbox.require(AGENTS)
        asked = _asked_of(inbox.require(OBJECTIVES), agents)
        if asked.items() <= self._asked.items() and inbox.now_ns < self._next_ns:
            return []
        self._asked = asked
        period = 1 / (self.config.rate_hz or RATES_HZ[self.config.method])
        self._next_ns = inbox.now_ns + round(1e9 * period) - SLACK_NS
        begin = perf_counter()
        starts = self._starts(agents, inbox.now)
        moment = moment_of(agents, self._radii, inbox.require(OBJECTIVES), inbox.now, starts)
        futures = self._method.plan(moment)
        plans = message_of(agents.ids, futures, self.config.method, perf_counter() - begin)
        self._last, self._last_stamp = plans, inbox.now
        self._late += plans.planning_time > period
        self.facts |= {"planning_time": plans.planning_time, "late_plans": float(self._late)}
        return [PLANS(plans)]

    def _look_at(self, semantic_map: SemanticMap) -> None:
        if not {"walkable", "obstacle"} & set(semantic_map.layers):
            log.error(
                "map %r has the layers %s; a planner needs `walkable` or `obstacle`: everything is taken as free",
                semantic_map.name,
                ", ".join(semantic_map.layers) or "none",
            )
        try:
            self._method.place(semantic_map)
        except (NavigationError, ObstacleError) as error:
            if not self._placed:
                raise
            log.error("map %r: %s; plans go on as on the one before", semantic_map.name, error)
        self._placed = True

    def _make(self, config: Config) -> Method:
        """The planning method.

        Raises:
            ConfigError: It cannot be had: no torch, broken weights, unknown objectives.
        """
        if config.method != "trace":
            return CrowdMethod(config)
        try:
            import torch  # noqa: F401
        except ImportError:
            raise ConfigError(
                "planner: config: method: 'trace' needs torch; install footfall[learn], or choose orca"
            ) from None
        from .planner_trace import TraceMethod

        return TraceMethod(
            seed=self.seed,
            samples=config.samples,
            steps=config.steps,
            context_weight=config.context_weight,
            guidance=config.guidance,
            weights=config.weights,
            modules=config.objectives,
            ask=config.ask,
            margin=config.margin,
            threads=config.threads,
        )

    def _starts(self, agents: AgentStates, now: float) -> np.ndarray:
        """(N, 4) where plans begin: the last plan's states of now, for everybody who is where it had them."""
        states = agents.now[:, :4].astype(np.float64)
        if self._last is None:
            return states
        index = round((now - self._last_stamp) / PLAN_DT) - 1
        if not 0 <= index < self._last.positions.shape[2]:
            return states
        row_of = {agent: row for row, agent in enumerate(self._last.ids.tolist())}
        for row, agent in enumerate(agents.ids.tolist()):
            if (old := row_of.get(agent)) is None:
                continue
            at = old, int(self._last.chosen[old]), index
            planned = self._last.positions[at].astype(np.float64)
            if np.linalg.norm(planned - states[row, :2]) < self.config.stitch:
                states[row] = [*planned, self._last.headings[at], self._last.speeds[at]]
        return states


class CrowdMethod:
    """Planners that need no past: `orca`, `constant_velocity`."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._planner: Planner = ConstantVelocity()

    def place(self, semantic_map: SemanticMap) -> None:
        """Take a new map."""
        if self._config.method == "orca":
            self._planner = OrcaPlanner(place_of(semantic_map))

    def plan(self, moment: Moment) -> Futures:
        """One future a pedestrian."""
        return self._planner.plan(moment.crowd(self._config.margin))


def _asked_of(objectives: Objectives, agents: AgentStates) -> dict[int, bytes]:
    """What each of those who are there is asked, to compare."""
    wishes = {wish.id: wish.objectives for wish in objectives.agents}
    groups = {member: group for group in objectives.groups for member in group.members}
    return {
        agent: msgspec.msgpack.encode((wishes.get(agent), groups.get(agent))) for agent in agents.ids.tolist()
    }


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
