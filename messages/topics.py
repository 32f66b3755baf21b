"""The topics of the graph: the only place where a topic's name is spelt."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import msgspec

from .agents import AgentStates
from .body import Bodies, BodyActions, BodyStates, Contacts, Falls
from .clock import Clock, Done
from .diagnostics import Control, Diagnostics, LogLine, Parameters, StepTrace
from .graph import Graph
from .map import SemanticMap
from .objectives import Objectives
from .plan import Plans
from .population import Admissions, Population, RecordedTracks
from .score import Score
from .steering import Steering

M = TypeVar("M", bound=msgspec.Struct)


@dataclass(frozen=True)
class Outgoing(Generic[M]):
    """A message on its way out of a step."""

    topic: "Topic[M]"
    message: M


@dataclass(frozen=True)
class Topic(Generic[M]):
    """A named stream of messages of one type."""

    name: str
    type: type[M]
    rate_hz: float | None = None
    """Nominal rate in simulation time; None for events. Liveness checks come from it."""
    latched: bool = False
    """The last message is kept for whoever subscribes later."""
    shared: bool = False
    """Many nodes may publish."""
    deterministic: bool = True
    """The same in two lockstep runs of one seed; others are left out of log hashes."""
    recorded: bool = True

    def __call__(self, message: M) -> Outgoing[M]:
        """Address a message to this topic: `return [PLANS(plans)]`."""
        return Outgoing(self, message)


CLOCK = Topic("clock", Clock, rate_hz=30, latched=True)
MAP = Topic("map", SemanticMap, latched=True)
POPULATION = Topic("population", Population, latched=True)
ADMISSIONS = Topic("admissions", Admissions)
OBJECTIVES = Topic("objectives", Objectives, latched=True)
RECORDED_TRACKS = Topic("recorded_tracks", RecordedTracks, latched=True)
AGENTS = Topic("agents", AgentStates, rate_hz=10)
PLANS = Topic("plans", Plans)
BODIES = Topic("bodies", Bodies, latched=True)
BODY_STATES = Topic("body_states", BodyStates, rate_hz=30)
BODY_ACTIONS = Topic("body_actions", BodyActions, rate_hz=30)
CONTACTS = Topic("contacts", Contacts)
FALLS = Topic("falls", Falls)
SCORE = Topic("score", Score, rate_hz=1, latched=True)
DONE = Topic("done", Done, shared=True, deterministic=False, recorded=False)
CONTROL = Topic("control", Control)
STEERING = Topic("steering", Steering, shared=True)
DIAGNOSTICS = Topic("diagnostics", Diagnostics, shared=True, deterministic=False)
LOG = Topic("log", LogLine, shared=True, deterministic=False)
PARAMETERS = Topic("parameters", Parameters, latched=True, shared=True)
STEPS = Topic("steps", StepTrace, shared=True, deterministic=False)
GRAPH = Topic("graph", Graph, latched=True, deterministic=False)

TOPICS: dict[str, Topic] = {
    topic.name: topic for topic in list(globals().values()) if isinstance(topic, Topic)
}
"""Every topic by name."""
