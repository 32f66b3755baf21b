"""Ground and obstacles of a map as textured meshes."""

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from ..messages.map import Obstacle, SemanticMap
from ..models.render.ground_paint import paint as paint_layers

if TYPE_CHECKING:
    import trimesh

PIXELS = 1600
"""Longest side of the ground's picture, about."""

TALL = 3.5
"""Obstacles higher than this and `WIDE` are see-through, so that nobody hides behind them [m]."""
WIDE = 1.2
"""Diameter from which an obstacle can hide somebody [m]."""


def paint(place: SemanticMap, times: int = 4, grain: bool = True) -> np.ndarray:
    """The layers of a map as a picture (times H, times W, 3) uint8; the first row has the lowest y."""
    layers = dict(zip(place.layers, place.raster, strict=True))
    return paint_layers(layers, place.resolution, times, grain)


def ground_mesh(place: SemanticMap) -> "trimesh.Trimesh":
    """The ground with its layers painted on: two triangles where it is flat, else one pair a height cell."""
    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    rows, columns = place.raster.shape[1:]
    extent = place.resolution * np.array([columns, rows])
    times = int(np.clip(PIXELS // max(rows, columns), 1, 8))
    file = BytesIO()
    Image.fromarray(paint(place, times)[::-1]).save(file, "JPEG", quality=85)  # a tenth of a PNG's bytes
    vertices, faces = _sheet(place, extent)
    uv = (vertices[:, :2] - place.origin) / extent
    material = PBRMaterial(
        baseColorTexture=Image.open(file),
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


def hides(obstacle: Obstacle) -> bool:
    """Whether somebody can stand behind it unseen from above."""
    outline = np.asarray(obstacle.polygon, dtype=np.float64)
    return obstacle.height > TALL and float(np.ptp(outline, axis=0).max()) > WIDE


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
