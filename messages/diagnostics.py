"""How the graph is doing: health of nodes, log lines, parameters, steps taken."""

from typing import Annotated, Literal

import msgspec

from .array import VOLATILE


class InputStats(msgspec.Struct, frozen=True):
    """What has come in on one input since the node started."""

    topic: str
    publisher: str
    received: int
    dropped: int
    """Messages lost on the way: gaps in the sequence numbers."""
    skipped: int
    """Messages that came but were replaced by newer ones before the node took them (`latest`, `queue`)."""
    rejected: int
    """Messages that were not what the topic promises."""
    age: float | None
    """Time since the newest message was sent [s]; None before the first."""


class OutputStats(msgspec.Struct, frozen=True):
    """What has gone out on one topic since the node started."""

    topic: str
    sent: int
    bytes: int
    refused: int
    """Deliveries given up because a reliable subscriber did not take them in time."""


class Diagnostics(msgspec.Struct, frozen=True):
    """A node's health, about once a second of wall time."""

    node: str
    pid: int
    steps: int
    step_time: float
    """Mean wall time of a step since the last report [s]."""
    step_time_max: float
    cpu: float
    """Processor time per wall time since the last report; 1 is one core."""
    memory: int
    """Resident memory [bytes]."""
    inputs: list[InputStats] = []
    outputs: list[OutputStats] = []
    facts: dict[str, float] = {}
    """Numbers the node wants known, e.g. `late_plans`."""
    errors: int = 0
    """Errors and warnings logged since the start."""


Level = Literal["DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL"]


class LogLine(msgspec.Struct, frozen=True):
    """One line of a node's log."""

    node: str
    level: Level
    text: str
    logger: str = ""
    wall_time: Annotated[str, VOLATILE] = ""
    """ISO 8601, UTC."""


class Control(msgspec.Struct, frozen=True):
    """A request to a node while it runs; `*` addresses all. Sent by the launcher for its clients."""

    node: str
    name: str
    """A parameter of the node, `log_level`, or a verb: `pause`, `resume`, `step`, `rate`, `seek`."""
    value: bool | int | float | str | None = None


class Parameters(msgspec.Struct, frozen=True):
    """The configuration a node runs with, as JSON; latched, sent at the start and after each change."""

    node: str
    values: str


class StepTrace(msgspec.Struct, frozen=True):
    """Which messages one step of a node took and gave: what replaying the step exactly needs."""

    node: str
    step: int
    consumed: dict[str, list[int]] = {}
    """Sequence numbers delivered to this step by `topic@publisher`."""
    produced: dict[str, list[int]] = {}
    """Sequence numbers the step sent by topic."""
