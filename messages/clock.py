"""Simulation time, and the hand-shake of lockstep."""

from typing import Annotated, Literal

import msgspec

from .array import VOLATILE

Mode = Literal["realtime", "free", "lockstep"]


class Clock(msgspec.Struct, frozen=True):
    """One tick of simulation time; the stamp of its header is the time. Exactly one node publishes it."""

    step: int
    """Tick number, from 0."""
    step_ns: int
    """Simulation time between ticks [ns]."""
    mode: Mode
    paused: bool = False
    """True while time stands still: the tick is repeated so that late joiners know the time."""
    sent: Annotated[dict[str, int], VOLATILE] = {}
    """Lockstep: the last sequence number on each `topic@node` that belongs before this tick's work. Counts
    diagnostics and log lines too, which come by wall time."""


class Done(msgspec.Struct, frozen=True):
    """A lockstep node has finished its work for one tick."""

    step: int
    node: str
    sent: dict[str, int] = {}
    """The last sequence number this node has sent on each of its `topic@node`s."""
