"""Steering: what somebody asks of a running scene; recorded like everything else."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from .objectives import Point

Weighted = Literal["Waypoint", "TargetSpeed", "MinimumSpeed", "SocialDistance", "ObstacleAvoidance", "Group"]
Weight = Annotated[float, Meta(ge=0)]


class SetWaypoint(msgspec.Struct, frozen=True, tag=True):
    """Go there; replaces the waypoint somebody has."""

    agent: int
    position: Point
    """World x, y [m]."""
    at: float | None = None
    """Simulation time of arrival [s], or None for any time."""


class SetSpeed(msgspec.Struct, frozen=True, tag=True):
    """Walk at this speed from now on."""

    agent: int
    speed: Annotated[float, Meta(ge=0, le=12)]
    """[m/s]"""


class SetWeight(msgspec.Struct, frozen=True, tag=True):
    """Change how much an objective matters."""

    agent: int | None
    """Whose; None for everybody's."""
    objective: Weighted
    """Type of the objective; `Group` for the walking together of a social group."""
    weight: Weight


class SetDistance(msgspec.Struct, frozen=True, tag=True):
    """Keep this social distance."""

    agent: int | None
    """Who; None for everybody."""
    gap: Annotated[float, Meta(ge=0, le=10)]
    """Between the bodies [m]."""


class MakeGroup(msgspec.Struct, frozen=True, tag=True):
    """Walk together from now on, and leave the groups one was in."""

    members: Annotated[list[int], Meta(min_length=2)]
    leader: int | None = None
    """One of them; None for the first."""
    distance: Annotated[float, Meta(gt=0)] = 1.0
    """Wanted distance between neighbours [m]."""


class BreakGroup(msgspec.Struct, frozen=True, tag=True):
    """Dissolve the group somebody is in."""

    agent: int


class Spawn(msgspec.Struct, frozen=True, tag=True):
    """Let in the next person who is not there."""

    position: Point
    """World x, y [m]; a free place near it is taken."""
    goal: Point | None = None
    """Where to; None for where they meant to go anyway."""


class Remove(msgspec.Struct, frozen=True, tag=True):
    """Take somebody out of the scene for good."""

    agent: int


class DropObstacle(msgspec.Struct, frozen=True, tag=True):
    """Put a solid prism on the ground."""

    name: str
    """Must differ from the names of all obstacles there are."""
    polygon: Annotated[list[Point], Meta(min_length=3)]
    """Outline seen from above [m], simple; the sense of rotation does not matter."""
    height: Annotated[float, Meta(gt=0)] = 1.0


class RemoveObstacle(msgspec.Struct, frozen=True, tag=True):
    """Take an obstacle away."""

    name: str


class Push(msgspec.Struct, frozen=True, tag=True):
    """Push somebody (physics only)."""

    agent: int
    force: tuple[float, float, float]
    """World x, y, z [N]."""
    duration: Annotated[float, Meta(gt=0, le=5)] = 0.2
    """[s]"""
    part: str = "Chest"
    """Name of the body that is pushed."""


Command = (
    SetWaypoint
    | SetSpeed
    | SetWeight
    | SetDistance
    | MakeGroup
    | BreakGroup
    | Spawn
    | Remove
    | DropObstacle
    | RemoveObstacle
    | Push
)
"""One thing that can be asked."""


class Steering(msgspec.Struct, frozen=True):
    """One command; those whom it does not concern ignore it."""

    command: Command
