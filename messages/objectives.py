"""What each pedestrian is asked to do; every objective has a weight and works at test time."""

import msgspec

Point = tuple[float, float]


class Waypoint(msgspec.Struct, frozen=True, tag=True):
    """Be at a place: at a given time, or as soon as it is convenient (TRACE, appendix A.2)."""

    position: Point
    """World x, y [m]."""
    at: float | None = None
    """Simulation time of arrival [s], or None for any time."""
    urgency: float = 0.7
    """0 strolls, 1 hurries: how far towards the goal each plan must get (eq 15)."""
    weight: float = 1.0


class TargetSpeed(msgspec.Struct, frozen=True, tag=True):
    """Walk at a speed [m/s]."""

    speed: float
    weight: float = 1.0


class MinimumSpeed(msgspec.Struct, frozen=True, tag=True):
    """Never walk slower than a speed [m/s]."""

    speed: float
    weight: float = 1.0


class SocialDistance(msgspec.Struct, frozen=True, tag=True):
    """Stay clear of other pedestrians by a gap between the bodies [m]."""

    gap: float = 0.2
    weight: float = 1.0


class ObstacleAvoidance(msgspec.Struct, frozen=True, tag=True):
    """Stay off obstacles by a margin [m]."""

    margin: float = 0.0
    weight: float = 1.0


Objective = Waypoint | TargetSpeed | MinimumSpeed | SocialDistance | ObstacleAvoidance


class AgentObjectives(msgspec.Struct, frozen=True):
    """The objectives of one pedestrian."""

    id: int
    objectives: list[Objective] = []


class SocialGroup(msgspec.Struct, frozen=True):
    """Pedestrians who walk together (TRACE, eq 21)."""

    id: int
    leader: int
    members: list[int]
    """Ids of all who belong, the leader included."""
    distance: float = 1.0
    """Wanted distance between neighbours [m]."""
    cohesion: float = 0.3
    """Chance that a member looks at a random other instead of the nearest."""
    weight: float = 1.0


class Objectives(msgspec.Struct, frozen=True):
    """Everybody's objectives; latched, sent whole whenever one changes."""

    agents: list[AgentObjectives] = []
    groups: list[SocialGroup] = []
