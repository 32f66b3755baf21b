"""Places and the people in them: the scene format and what can be asked of a scene."""

from .scene import (
    Entry,
    Event,
    Flow,
    Groups,
    NewGoal,
    Obstacle,
    ObstacleDropped,
    RandomPopulation,
    RecordedPopulation,
    Scene,
    SceneError,
    Terrain,
    Track,
    load_scene,
    save_scene,
    shipped_scenes,
)

__all__ = [
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
