"""Where the planner wants everybody to go."""

from typing import Annotated

import msgspec
import numpy as np

from .array import VOLATILE, Array

PLAN_DT = 0.1
"""Time between the points of a plan [s]; the first point lies one step after the stamp."""
PLAN_STEPS = 50
"""Points of a full plan: five seconds."""


class Plans(msgspec.Struct, frozen=True):
    """The sampled futures of every pedestrian and the one it shall follow; time 0 is the stamp."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    chosen: Annotated[np.ndarray, Array("i4", ("N",))]
    """Index of the sample to follow."""
    positions: Annotated[np.ndarray, Array("f4", ("N", "S", "T", 2), "m", "world")]
    headings: Annotated[np.ndarray, Array("f4", ("N", "S", "T"), "rad", "world")]
    speeds: Annotated[np.ndarray, Array("f4", ("N", "S", "T"), "m/s")]
    method: str
    """Planner method that made the plans."""
    loss_names: list[str] = []
    losses: Annotated[np.ndarray | None, Array("f4", ("N", "S", "L"))] = None
    """Guidance loss of each sample by objective, in the order of `loss_names`."""
    planning_time: Annotated[float, VOLATILE] = 0.0
    """Wall time the planner took [s]."""
