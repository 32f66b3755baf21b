"""Who takes part in a scene, who comes and goes, and how the people really walked."""

from typing import Annotated

import msgspec
import numpy as np

from .array import Array


class Population(msgspec.Struct, frozen=True):
    """Everybody who may ever enter the scene; latched, sent once before the first tick."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    groups: Annotated[np.ndarray, Array("i4", ("N",))]
    """Social group, -1 for none."""
    shapes: Annotated[np.ndarray, Array("f4", ("N", 10))]
    """Body shape vectors."""
    enter_times: Annotated[np.ndarray, Array("f8", ("N",), "s")]
    """When each is to enter, simulation time."""
    goals: Annotated[np.ndarray, Array("f8", ("N", 2), "m", "world")]
    """Where each is heading when it enters."""


class Enter(msgspec.Struct, frozen=True):
    """A pedestrian steps into the scene."""

    id: int
    position: tuple[float, float]
    heading: float
    speed: float = 0.0


class Admissions(msgspec.Struct, frozen=True):
    """Who enters and who leaves the scene now."""

    enter: list[Enter] = []
    leave: list[int] = []
    reached: list[int] = []
    """Who has just reached their goal, whether they leave or walk on to another."""


class RecordedTracks(msgspec.Struct, frozen=True):
    """How the people of a recorded scene really walked, for comparison; latched. One row a sample."""

    ids: Annotated[np.ndarray, Array("i4", ("R",))]
    times: Annotated[np.ndarray, Array("f8", ("R",), "s")]
    """Simulation time, ascending for each id."""
    positions: Annotated[np.ndarray, Array("f8", ("R", 2), "m", "world")]
