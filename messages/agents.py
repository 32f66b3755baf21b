"""Where everybody is and has been, as a planner sees it."""

from typing import Annotated

import msgspec
import numpy as np

from .array import Array

HISTORY_STEPS = 31
"""Three seconds at 10 Hz, and now (TRACE, appendix C.1)."""
HISTORY_DT = 0.1
"""Time between history frames [s]."""
STATE_COLUMNS = ("x", "y", "heading", "speed", "length", "width", "present")
"""Columns of a state: m, m, rad from the x axis, m/s, m, m, 1 or 0 (all zero when absent)."""


class AgentStates(msgspec.Struct, frozen=True):
    """The pedestrians in the scene now, each with its recent past."""

    ids: Annotated[np.ndarray, Array("i4", ("N",))]
    """Identity of each pedestrian, ascending; constant over its life."""
    groups: Annotated[np.ndarray, Array("i4", ("N",))]
    """Social group of each pedestrian, -1 for none."""
    history: Annotated[np.ndarray, Array("f4", ("N", HISTORY_STEPS, 7), "", "world")]
    """States at 10 Hz, the last one now; columns are `STATE_COLUMNS`."""

    @property
    def now(self) -> np.ndarray:
        """Present states (N, 7)."""
        return self.history[:, -1]
