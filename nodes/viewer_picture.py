"""What there is to see: the newest of every topic a picture needs, the same live and from a log."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from ..messages.agents import AgentStates
from ..messages.body import Bodies, BodyStates, Contacts
from ..messages.clock import Clock
from ..messages.diagnostics import Diagnostics, LogLine
from ..messages.map import HeightField, SemanticMap
from ..messages.objectives import Objective, Objectives, SocialGroup
from ..messages.plan import PLAN_DT, Plans
from ..messages.population import Admissions
from ..messages.score import Score
from ..messages.topics import (
    ADMISSIONS,
    AGENTS,
    BODIES,
    BODY_STATES,
    CLOCK,
    CONTACTS,
    DIAGNOSTICS,
    FALLS,
    LOG,
    MAP,
    OBJECTIVES,
    PARAMETERS,
    PLANS,
    SCORE,
)

FALL_SHOWN = 3.0
"""How long a fall is pointed out [s]."""
LINES = 200
"""Log lines kept."""


@dataclass(frozen=True)
class Fall:
    """Somebody has fallen."""

    agent: int
    position: np.ndarray
    """(3,) [m], world."""
    stamp_ns: int


@dataclass
class Picture:
    """The state of a run at one moment. Nobody is in it at first, and nowhere is there."""

    now_ns: int = 0
    place: SemanticMap | None = None
    bodies: Bodies | None = None
    states: BodyStates | None = None
    agents: AgentStates | None = None
    plans: Plans | None = None
    plans_ns: int = 0
    objectives: Objectives = field(default_factory=Objectives)
    contacts: Contacts | None = None
    falls: list[Fall] = field(default_factory=list)
    score: Score | None = None
    clock: Clock | None = None
    reports: dict[str, deque[tuple[int, Diagnostics]]] = field(default_factory=dict)
    """The last two reports of each node with their stamps [ns]."""
    methods: dict[str, str] = field(default_factory=dict)
    """The configuration value `method` by node that has one."""
    lines: deque[LogLine] = field(default_factory=lambda: deque(maxlen=LINES))
    changed: set[str] = field(default_factory=set)
    """Names of the topics that have changed since this was last cleared."""

    @property
    def now(self) -> float:
        """Simulation time [s]."""
        return self.now_ns * 1e-9

    def take(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Take one message; a topic that is not shown is left aside."""
        if topic == CLOCK.name and stamp_ns < self.now_ns:
            self._jump_back(stamp_ns)
        self.now_ns = max(self.now_ns, stamp_ns)
        self.changed.add(topic)
        match topic:
            case MAP.name:
                self.place = message
            case BODIES.name:
                self.bodies = message
            case BODY_STATES.name:
                self.states = message
            case AGENTS.name:
                self.agents = message
            case PLANS.name:
                self.plans, self.plans_ns = message, stamp_ns
            case OBJECTIVES.name:
                self.objectives = message
            case CONTACTS.name:
                self.contacts = message
            case FALLS.name:
                self.falls += [
                    Fall(agent, position.astype(np.float64), stamp_ns)
                    for agent, position in zip(message.ids.tolist(), message.positions, strict=True)
                ]
            case SCORE.name:
                self.score = message
            case CLOCK.name:
                self.clock = message
            case DIAGNOSTICS.name:
                self.reports.setdefault(message.node, deque(maxlen=2)).append((stamp_ns, message))
            case LOG.name:
                self.lines.append(message)
            case PARAMETERS.name:
                self._take_method(message.node, message.values)
            case ADMISSIONS.name:
                self._forget_leavers(message)

    def _jump_back(self, stamp_ns: int) -> None:
        """A replay begins anew: what has not happened yet is not shown."""
        self.now_ns = stamp_ns
        self.falls = [fall for fall in self.falls if fall.stamp_ns <= stamp_ns]
        self.reports = {}

    def forget(self, topic: str) -> None:
        """Be as before the first message of a topic that describes a state."""
        self.changed.add(topic)
        match topic:
            case MAP.name:
                self.place = None
            case BODIES.name:
                self.bodies = None
            case BODY_STATES.name:
                self.states = None
            case AGENTS.name:
                self.agents = None
            case PLANS.name:
                self.plans, self.plans_ns = None, 0
            case OBJECTIVES.name:
                self.objectives = Objectives()
            case CONTACTS.name:
                self.contacts = None
            case SCORE.name:
                self.score = None
            case CLOCK.name:
                self.clock = None

    def _take_method(self, node: str, values: str) -> None:
        config = msgspec.json.decode(values)
        if isinstance(config, Mapping) and isinstance(config.get("method"), str):
            self.methods[node] = config["method"]

    def _forget_leavers(self, admissions: Admissions) -> None:
        self.falls = [fall for fall in self.falls if fall.agent not in admissions.leave]

    def rates(self, node: str) -> dict[str, float]:
        """Messages per simulated second by topic, between a node's last two reports."""
        reports = self.reports.get(node, ())
        if len(reports) < 2 or reports[1][0] <= reports[0][0]:
            return {}
        (begin_ns, before), (end_ns, after) = reports
        sent = {output.topic: output.sent for output in before.outputs}
        seconds = (end_ns - begin_ns) * 1e-9
        return {o.topic: (o.sent - sent.get(o.topic, 0)) / seconds for o in after.outputs}

    def recent_falls(self) -> list[Fall]:
        """Falls that are still pointed out."""
        return [fall for fall in self.falls if 0 <= self.now_ns - fall.stamp_ns <= FALL_SHOWN * 1e9]

    @property
    def ids(self) -> list[int]:
        """Who is there."""
        if self.states is not None:
            return self.states.ids.tolist()
        return [] if self.agents is None else self.agents.ids.tolist()

    def places(self) -> tuple[list[int], np.ndarray]:
        """Who is there, and where on the ground (N, 2) [m]: by the bodies, else by the agents."""
        if self.states is not None:
            return self.ids, self.states.positions[:, 0, :2].astype(np.float64)
        if self.agents is not None:
            return self.ids, self.agents.now[:, :2].astype(np.float64)
        return [], np.zeros((0, 2))

    def height_at(self, xy: np.ndarray) -> np.ndarray:
        """Ground height (...) [m] at world points (..., 2) [m]."""
        ground = None if self.place is None else self.place.terrain
        if ground is None:
            return np.zeros(np.shape(xy)[:-1])
        return heights_at(ground, np.asarray(xy, dtype=np.float64))

    def on_ground(self, xy: np.ndarray, above: float = 0.0) -> np.ndarray:
        """World points (..., 3) [m] that lie so far above the ground at (..., 2) [m]."""
        xy = np.asarray(xy, dtype=np.float64)
        return np.concatenate([xy, self.height_at(xy)[..., None] + above], axis=-1)

    def wishes(self, agent: int) -> list[Objective]:
        """What somebody is asked to do."""
        return next((list(a.objectives) for a in self.objectives.agents if a.id == agent), [])

    def group_of(self, agent: int) -> SocialGroup | None:
        """The group somebody walks in."""
        return next((group for group in self.objectives.groups if agent in group.members), None)

    def plan_of(self, agent: int) -> int | None:
        """Row of somebody in the newest plans."""
        if self.plans is None:
            return None
        rows = np.flatnonzero(self.plans.ids == agent)
        return int(rows[0]) if len(rows) else None

    def plan_age(self) -> float | None:
        """Simulated time since the newest plans were made [s]; None without plans."""
        return None if self.plans is None else (self.now_ns - self.plans_ns) * 1e-9

    def still_ahead(self) -> int:
        """How many points of the newest plans have gone by."""
        age = self.plan_age()
        if self.plans is None or age is None:
            return 0
        return int(np.clip(round(age / PLAN_DT), 0, self.plans.positions.shape[2]))


def heights_at(ground: HeightField, xy: np.ndarray) -> np.ndarray:
    """Heights (...) [m] of a grid at world points (..., 2) [m], bilinear; outside as at the edge."""
    last = np.array(ground.heights.shape[::-1]) - 1
    cell = np.clip((xy - ground.origin) / ground.resolution, 0, last)
    low = np.minimum(cell.astype(int), np.maximum(last - 1, 0))
    j, i = np.moveaxis(low, -1, 0)
    u, v = np.moveaxis(cell - low, -1, 0)
    right, above = np.minimum(j + 1, last[0]), np.minimum(i + 1, last[1])
    h = ground.heights
    return (h[i, j] * (1 - u) + h[i, right] * u) * (1 - v) + (h[above, j] * (1 - u) + h[above, right] * u) * v
