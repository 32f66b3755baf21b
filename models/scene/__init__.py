"""Places and the people in them: the scene format and what can be asked of a scene."""

from .file import Event, Flow, Groups, NewGoal, Obstacle, ObstacleDropped, RandomPopulation, SceneError
from .population import Entry, RecordedPopulation, Track
from .scene import ROAD_COST, Scene, load_scene, save_scene, shipped_scenes
from .terrain import Terrain

__all__ = [
    "ROAD_COST",
    "Entry",
    "Event",
    "Flow",
    "Groups",
    "NewGoal",
    "Obstacle",
    "ObstacleDropped",
    "RandomPopulation",
    "RecordedPopulation",
    "Scene",
    "SceneError",
    "Terrain",
    "Track",
    "load_scene",
    "save_scene",
    "shipped_scenes",
]
