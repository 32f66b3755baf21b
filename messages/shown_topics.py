"""What a picture of a run is made of: the one list for the live window, the window on a log, and the wiring."""

from dataclasses import dataclass
from typing import Literal

from .topics import (
    ADMISSIONS,
    AGENTS,
    BODIES,
    BODY_STATES,
    CONTACTS,
    DIAGNOSTICS,
    FALLS,
    LOG,
    MAP,
    OBJECTIVES,
    PARAMETERS,
    PLANS,
    SCORE,
    Topic,
)


@dataclass(frozen=True)
class ShownTopic:
    """A topic that a picture is made of; any of them may be missing."""

    topic: Topic
    kind: Literal["state", "stream", "event"]
    """`state`: the newest holds. `stream`: the same, but large and often. `event`: several are shown."""
    queue: int = 0
    """Messages a live window keeps until it draws; 0 is the newest of each publisher."""
    recent: int = 0
    """Of events, how many the window on a log looks back to; 0 takes none."""


SHOWN: tuple[ShownTopic, ...] = (
    ShownTopic(MAP, "state"),
    ShownTopic(BODIES, "state"),
    ShownTopic(OBJECTIVES, "state"),
    ShownTopic(SCORE, "state"),
    ShownTopic(BODY_STATES, "stream"),
    ShownTopic(AGENTS, "stream"),
    ShownTopic(PLANS, "stream"),
    ShownTopic(CONTACTS, "stream"),
    ShownTopic(FALLS, "event", queue=50, recent=50),
    ShownTopic(ADMISSIONS, "event", queue=50),
    ShownTopic(LOG, "event", queue=200, recent=200),
    ShownTopic(DIAGNOSTICS, "event", queue=10, recent=100),
    ShownTopic(PARAMETERS, "event", recent=1000),
)


def of_kind(kind: str) -> tuple[Topic, ...]:
    """The topics of one kind."""
    return tuple(shown.topic for shown in SHOWN if shown.kind == kind)
