"""Ground and obstacles of a map as textured meshes."""

from typing import TYPE_CHECKING

import numpy as np

from ..messages.map import Obstacle, SemanticMap

if TYPE_CHECKING:
    import trimesh

BARE = "#8d8a85"
LAYER_COLOURS = {
    "walkable": "#cfccc4",
    "road": "#8e9298",
    "pavement": "#c8c2b3",
    "green": "#a3bf8d",
    "stairs": "#bda98c",
    "crosswalk": "#e4e4e0",
    "marking": "#d8d2a8",
}
"""Ground colours, painted in this order."""
OBSTACLE_COLOUR = (150, 148, 160)
PIXELS = 2048
"""Longest side of the ground's picture."""


def paint(place: SemanticMap) -> np.ndarray:
    """The layers of a map as a picture (H, W, 3) uint8; the first row has the lowest y."""
    image = np.full((*place.raster.shape[1:], 3), _rgb(BARE), np.uint8)
    layers = dict(zip(place.layers, place.raster, strict=True))
    for name, colour in LAYER_COLOURS.items():
        if name in layers:
            image[layers[name] > 0] = _rgb(colour)
    return image


def _rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def ground_mesh(place: SemanticMap) -> "trimesh.Trimesh":
    """The ground with its layers painted on: two triangles where it is flat, else one pair a height cell."""
    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    picture = paint(place)
    rows, columns = picture.shape[:2]
    extent = place.resolution * np.array([columns, rows])
    times = int(np.clip(PIXELS // max(rows, columns), 1, 4))  # sharp edges of cells
    picture = picture.repeat(times, 0).repeat(times, 1)[::-1]
    vertices, faces = _sheet(place, extent)
    uv = (vertices[:, :2] - place.origin) / extent
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(np.ascontiguousarray(picture)),
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    visual = TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


def _sheet(place: SemanticMap, extent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] and triangles (F, 3) of the ground."""
    ground = place.terrain
    if ground is None:
        low, high = np.array(place.origin), np.array(place.origin) + extent
        corners = [(low[0], low[1]), (high[0], low[1]), (low[0], high[1]), (high[0], high[1])]
        vertices = np.array([(x, y, 0.0) for x, y in corners])
        rows = columns = 2
    else:
        rows, columns = ground.heights.shape
        i, j = np.mgrid[:rows, :columns]
        x, y = (ground.origin[0] + ground.resolution * j), (ground.origin[1] + ground.resolution * i)
        vertices = np.stack([x, y, ground.heights], axis=-1).reshape(-1, 3).astype(np.float64)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return vertices, np.concatenate([lower, upper])


def obstacles_mesh(obstacles: list[Obstacle], heights: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """All obstacles as one mesh: vertices (V, 3) [m] and triangles (F, 3).

    Args:
        obstacles: Prisms.
        heights: Ground height below each [m].
    """
    vertices, faces, count = [], [], 0
    for obstacle, ground in zip(obstacles, heights, strict=True):
        outline = np.asarray(obstacle.polygon)
        n = len(outline)
        low = np.column_stack([outline, np.full(n, ground - 0.5)])
        high = np.column_stack([outline, np.full(n, ground + obstacle.height)])
        # Walls and roof have vertices of their own, so that edges stay sharp.
        vertices += [low, high, high]
        here, after = np.arange(n), (np.arange(n) + 1) % n
        walls = np.concatenate(
            [
                np.stack([here, after, n + after], axis=1),
                np.stack([here, n + after, n + here], axis=1),
            ]
        )
        faces += [count + walls, count + 2 * n + triangulate(outline)]
        count += 3 * n
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), int)
    return np.concatenate(vertices), np.concatenate(faces)


def triangulate(outline: np.ndarray) -> np.ndarray:
    """Triangles (K - 2, 3) of a simple counter-clockwise polygon (K, 2), by cutting off ears."""
    left = list(range(len(outline)))
    triangles = []
    while len(left) > 3:
        for position in range(len(left)):
            ear = [left[position - 1], left[position], left[(position + 1) % len(left)]]
            if _is_ear(outline, ear, left):
                break
        else:  # an outline that crosses itself: any corner will do
            position, ear = 0, [left[-1], left[0], left[1]]
        triangles.append(ear)
        left.pop(position)
    return np.array([*triangles, left])


def _is_ear(outline: np.ndarray, ear: list[int], left: list[int]) -> bool:
    a, b, c = outline[ear]
    if _turn(a, b, c) <= 0:
        return False
    others = outline[[k for k in left if k not in ear]]
    inside = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    return not inside.any()


def _turn(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Twice the signed area of the triangles a, b, points; positive where one turns left."""
    return (b[0] - a[0]) * (points[..., 1] - a[1]) - (b[1] - a[1]) * (points[..., 0] - a[0])
