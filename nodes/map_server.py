"""Publishes the scene's map: raster layers, obstacles and ground; again when an obstacle is dropped.

In: clock. Out: map (latched), at the start and at each event of the scene that changes the place.
"""

import sys
from collections.abc import Iterable

import numpy as np

from ..messages.config import ConfigError
from ..messages.map import HeightField, Obstacle, SemanticMap
from ..messages.topics import CLOCK, MAP, Outgoing
from ..models.scene import ObstacleDropped, Scene, SceneError, load_scene
from ..models.scene_layers import rasterize
from .node import Inbox, Node, NodeConfig
from .spin import spin


class Config(NodeConfig, frozen=True):
    """Which place."""

    scene: str = "crossing"
    """Name of a shipped scene or one in ./scenes, or a scene folder."""


class MapServer(Node[Config]):
    """Knows the place."""

    Config = Config
    inputs = (CLOCK,)
    outputs = (MAP,)
    trigger = CLOCK

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        try:
            self._scene = load_scene(config.scene)
        except SceneError as error:
            raise ConfigError(str(error)) from None
        self._dropped = 0
        self._events = [event for event in self._scene.events if isinstance(event, ObstacleDropped)]

    def start(self) -> Iterable[Outgoing]:
        """The map as it is at first."""
        return [MAP(message_of(self._scene, ()))]

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Drop the obstacles whose time has come."""
        due = sum(event.time <= inbox.now for event in self._events)
        if due == self._dropped:
            return []
        self._dropped = due
        return [MAP(message_of(self._scene, self._events[:due]))]


def message_of(scene: Scene, dropped: Iterable[ObstacleDropped]) -> SemanticMap:
    """The map of a scene with the obstacles dropped so far."""
    obstacles = [*scene.obstacles, *(event.obstacle for event in dropped)]
    terrain = scene.terrain
    solid = rasterize(
        [o.polygon for o in obstacles], scene.shape, scene.resolution, scene.origin, touched=True
    )
    layers = {**scene.layers, "obstacle": solid}
    return SemanticMap(
        name=scene.name,
        layers=list(layers),
        raster=np.stack([(layer > 0).astype(np.uint8) for layer in layers.values()]),
        resolution=scene.resolution,
        origin=scene.origin,
        obstacles=[Obstacle(o.name, np.asarray(o.polygon, dtype=np.float64), o.height) for o in obstacles],
        terrain=None
        if terrain is None
        else HeightField(terrain.heights.astype(np.float32), terrain.resolution, terrain.origin),
    )


if __name__ == "__main__":
    sys.exit(spin(MapServer))
