"""Simulation time, and the hand-shake of lockstep."""

from typing import Literal

import msgspec

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
    sent: dict[str, int] = {}
    """Lockstep: the last sequence number on each `topic@node` that belongs before this tick's work."""


class Done(msgspec.Struct, frozen=True):
    """A lockstep node has finished its work for one tick."""

    step: int
    node: str
    sent: dict[str, int] = {}
    """The last sequence number this node has sent on each of its `topic@node`s."""
