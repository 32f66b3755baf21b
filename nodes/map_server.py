"""Publishes the scene's map: raster layers, obstacles and ground; again when an obstacle is dropped.

In: clock, steering. Out: map (latched), at the start, at each event of the scene that changes the place, and
when steering drops or removes an obstacle.
"""

import logging
import sys
from collections.abc import Iterable

import numpy as np
import shapely

from ..messages.config import ConfigError
from ..messages.map import HeightField, Obstacle, SemanticMap
from ..messages.steering import Command, DropObstacle, RemoveObstacle
from ..messages.topics import CLOCK, MAP, STEERING, Outgoing
from ..models.scene import ObstacleDropped, Scene, SceneError, load_scene
from ..models.scene.layers import rasterize
from .node import Inbox, Node, NodeConfig
from .spin import spin

log = logging.getLogger(__name__)


SMALLEST = 1e-3
"""Area of the smallest obstacle that may be dropped [m^2]."""


class Config(NodeConfig, frozen=True):
    """Which place."""

    scene: str = "crossing"
    """Name of a shipped scene or one in ./scenes, or a scene folder."""


class MapServer(Node[Config]):
    """Knows the place."""

    Config = Config
    inputs = (CLOCK, STEERING)
    outputs = (MAP,)
    trigger = CLOCK

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        try:
            self._scene = load_scene(config.scene)
        except SceneError as error:
            raise ConfigError(str(error)) from None
        self._obstacles = [
            Obstacle(o.name, np.asarray(o.polygon, dtype=np.float64), o.height) for o in self._scene.obstacles
        ]
        self._events = [event for event in self._scene.events if isinstance(event, ObstacleDropped)]

    def start(self) -> Iterable[Outgoing]:
        """The map as it is at first."""
        return [MAP(message_of(self._scene, self._obstacles))]

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Drop the obstacles whose time has come, and do what steering asks."""
        before = self._obstacles
        due = [event.obstacle for event in self._events if event.time <= inbox.now]
        self._events = self._events[len(due) :]
        for o in due:
            dropped = Obstacle(o.name, np.asarray(o.polygon, dtype=np.float64), o.height)
            self._obstacles = [*self._obstacles, dropped]
        for steering in inbox.new(STEERING):
            self._obstacles = steered(self._obstacles, steering.command)
        return [] if self._obstacles is before else [MAP(message_of(self._scene, self._obstacles))]


def steered(obstacles: list[Obstacle], command: Command) -> list[Obstacle]:
    """The obstacles after a command; the same list where it is not about them or cannot be obeyed."""
    match command:
        case DropObstacle(name=name):
            shape = shapely.Polygon(command.polygon)
            if name in {obstacle.name for obstacle in obstacles}:
                log.warning("steering: there is an obstacle %r already", name)
            elif not shape.is_valid or shape.area < SMALLEST:
                log.warning("steering: the outline of obstacle %r is not a simple polygon", name)
            else:
                outline = np.array(shapely.geometry.polygon.orient(shape).exterior.coords)[:-1]
                return [*obstacles, Obstacle(name, outline, command.height)]
        case RemoveObstacle(name=name):
            if name in {obstacle.name for obstacle in obstacles}:
                return [obstacle for obstacle in obstacles if obstacle.name != name]
            log.warning("steering: there is no obstacle %r", name)
    return obstacles


def message_of(scene: Scene, obstacles: list[Obstacle]) -> SemanticMap:
    """The map of a scene with the obstacles there are now."""
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
        obstacles=obstacles,
        terrain=None
        if terrain is None
        else HeightField(terrain.heights.astype(np.float32), terrain.resolution, terrain.origin),
    )


if __name__ == "__main__":
    sys.exit(spin(MapServer))
