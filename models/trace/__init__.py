"""TRACE: the guided trajectory-diffusion planner.

What a program needs that plans with it; training, data and evaluation are in the modules.
"""

from .guidance import Guidance
from .objectives import OBJECTIVES, Future, Objective, ObjectiveError, objective
from .planner import THOROUGH, TracePlanner
from .sampling import FEW, SHIPPED, Sampling
from .scene_map import SceneMaps
from .scene_planner import TraceFutures
from .weights import WeightsError

__all__ = [
    "FEW",
    "OBJECTIVES",
    "SHIPPED",
    "THOROUGH",
    "Future",
    "Guidance",
    "Objective",
    "ObjectiveError",
    "Sampling",
    "SceneMaps",
    "TraceFutures",
    "TracePlanner",
    "WeightsError",
    "objective",
]
