"""The rules of a scene: each check raises one sentence that says which part is wrong."""

from typing import TYPE_CHECKING

import numpy as np

from .file import NewGoal, ObstacleDropped, RandomPopulation, SceneError, near
from .layers import polygon_fault, rasterize, signed_distance

if TYPE_CHECKING:
    from .scene import Scene


def check_scene(scene: "Scene") -> None:
    """Check every rule.

    Raises:
        SceneError: The first rule that is broken.
    """
    _check_layers(scene)
    _check_obstacles(scene)
    _check_terrain(scene)
    _check_population(scene)


def _check_layers(scene: "Scene") -> None:
    if not (np.isfinite(scene.resolution) and scene.resolution > 0):
        raise SceneError(f"resolution: {scene.resolution} m a cell; it must be a positive number")
    if not np.isfinite(scene.origin).all():
        raise SceneError(f"origin: {scene.origin} is not a finite point")
    if "walkable" not in scene.layers:
        raise SceneError(
            f"layers: 'walkable' is needed, there is only {', '.join(scene.layers) or 'nothing'}"
        )
    for name, cells in scene.layers.items():
        if cells.ndim != 2 or cells.dtype not in (np.bool_, np.uint8) or cells.shape != scene.shape:
            raise SceneError(
                f"layers.{name}: {cells.dtype} {cells.shape}; it must be bool or uint8 of the shape"
                f" {scene.shape} of 'walkable'"
            )


def _check_obstacles(scene: "Scene") -> None:
    dropped = [event.obstacle for event in scene.events if isinstance(event, ObstacleDropped)]
    for where, obstacles in (("obstacles", scene.obstacles), ("events", dropped)):
        for index, obstacle in enumerate(obstacles):
            if fault := polygon_fault(obstacle.polygon):
                raise SceneError(f"{where}[{index}] '{obstacle.name}': the polygon {fault}")


def _check_terrain(scene: "Scene") -> None:
    terrain = scene.terrain
    if not terrain:
        return
    if terrain.heights.ndim != 2 or not np.isfinite(terrain.heights).all():
        raise SceneError("terrain: heights must be (H, W) finite numbers")
    if not (np.isfinite(terrain.resolution) and terrain.resolution > 0):
        raise SceneError(f"terrain.resolution: {terrain.resolution} m; it must be a positive number")
    span = (np.array(terrain.heights.shape[::-1]) - 1) * terrain.resolution
    reach = np.concatenate([terrain.origin, terrain.origin + span])
    if not np.allclose(reach, scene.bounds, atol=0.5 * terrain.resolution):
        raise SceneError(f"terrain: its points span {reach.round(3).tolist()}, the map {list(scene.bounds)}")


def _check_population(scene: "Scene") -> None:
    for name, polygon in scene.areas.items():
        if fault := polygon_fault(polygon):
            raise SceneError(f"areas.{name}: the polygon {fault}")
        cells = rasterize([polygon], scene.shape, scene.resolution, scene.origin)
        if not cells.any():
            raise SceneError(f"areas.{name}: lies outside the map {scene.bounds} or is smaller than a cell")
        if scene.blocked()[cells].all():
            deep = signed_distance([o.polygon for o in scene.obstacles], polygon.mean(axis=0)) < 0
            where = "in an obstacle" if deep else "off walkable ground"
            raise SceneError(f"areas.{name}: lies wholly {where}; nobody could enter or arrive there")
    if isinstance(scene.population, RandomPopulation):
        for index, flow in enumerate(scene.population.flows):
            for key, name in (("spawn", flow.spawn), ("goal", flow.goal)):
                _check_area(scene, name, f"population.flows[{index}].{key}")
        for index, event in enumerate(scene.events):
            if isinstance(event, NewGoal) and event.agent >= scene.population.count:
                last = scene.population.count - 1
                raise SceneError(f"events[{index}].agent: {event.agent}, but the last pedestrian is {last}")
    for index, event in enumerate(scene.events):
        if isinstance(event, NewGoal) and isinstance(event.goal, str):
            _check_area(scene, event.goal, f"events[{index}].goal")


def _check_area(scene: "Scene", name: str, where: str) -> None:
    if name not in scene.areas:
        hint = near(name, list(scene.areas)) or f"; areas are {', '.join(scene.areas) or 'none'}"
        raise SceneError(f"{where}: there is no area '{name}'{hint}")
