"""How a run is going: collisions, goals, distance from how people really walked."""

import msgspec


class Score(msgspec.Struct, frozen=True):
    """Totals since the start of the run; latched, about once a simulated second and at its end."""

    entered: int
    """Pedestrians who have entered so far."""
    present: int
    goals_reached: int
    falls: int
    agent_seconds: float
    """Simulated time summed over the pedestrians present [s]."""
    agent_overlap_seconds: float
    """Of that, the time in which a pedestrian's disk overlaps another's [s]."""
    obstacle_overlap_seconds: float
    """Of that, the time in which a pedestrian's disk overlaps an obstacle [s]."""
    collisions: int
    """Times two disks have begun to overlap, or one and an obstacle."""
    track_distance: float | None = None
    """Mean distance from where the same person was recorded at the same time [m]; None without records."""
    tracked_seconds: float = 0.0
    """Time over which `track_distance` is the mean [s]."""
