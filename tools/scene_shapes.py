"""Ground plans for scene makers: outlines in metres, street furniture, and rasters from shapes."""

import numpy as np
import shapely
from shapely import affinity

from ..models.scene import Obstacle
from ..models.scene.file import Point
from ..models.scene.layers import cell_centers


def rect(low_x: float, low_y: float, high_x: float, high_y: float) -> shapely.Polygon:
    """Axis-parallel rectangle from its two corners."""
    return shapely.Polygon([(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)])


def disc(x: float, y: float, radius: float, corners: int = 8) -> shapely.Polygon:
    """Regular polygon around (x, y); `radius` reaches its corners."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.5) / corners
    return shapely.Polygon(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=-1))


def turned_box(x: float, y: float, length: float, width: float, angle_deg: float = 0.0) -> shapely.Polygon:
    """Rectangle centred on (x, y), `length` along the direction `angle_deg`."""
    box = rect(x - length / 2, y - width / 2, x + length / 2, y + width / 2)
    return affinity.rotate(box, angle_deg, origin=(x, y))


def outline(shape: shapely.Geometry) -> np.ndarray:
    """Corners (K, 2) of a polygon without holes, counter-clockwise, to the millimetre."""
    if not isinstance(shape, shapely.Polygon) or shape.interiors:
        raise ValueError(f"an outline is one polygon without holes, not a {type(shape).__name__}")
    ring = shapely.orient_polygons(shape).exterior.coords
    return np.round(np.array(ring)[:-1], 3) + 0.0


def solid(name: str, shape: shapely.Geometry, height: float) -> Obstacle:
    """An obstacle with the outline of a shape."""
    return Obstacle(name, outline(shape), height)


def covered(shape: shapely.Geometry, cells: tuple[int, int], resolution: float, origin: Point) -> np.ndarray:
    """Cells (H, W) bool whose centre lies in a shape, holes respected."""
    x, y = np.meshgrid(*cell_centers(cells, resolution, origin))
    shapely.prepare(shape)
    return shapely.contains_xy(shape, x, y)


def pole(x: float, y: float, name: str = "lamp post") -> Obstacle:
    """Lamp, sign or traffic light, 20 cm thick."""
    return solid(name, disc(x, y, 0.1, 6), 4.0)


def bollard(x: float, y: float) -> Obstacle:
    """Low post that keeps cars off the pavement."""
    return solid("bollard", disc(x, y, 0.12, 6), 0.9)


def tree(x: float, y: float, pit: float = 0.35) -> Obstacle:
    """Tree with the guard around its trunk."""
    return solid("tree", disc(x, y, pit, 8), 4.5)


def litter_bin(x: float, y: float) -> Obstacle:
    """Litter bin."""
    return solid("bin", turned_box(x, y, 0.5, 0.5), 1.0)


def bench(x: float, y: float, angle_deg: float = 0.0) -> Obstacle:
    """Bench for three, 1.8 m long."""
    return solid("bench", turned_box(x, y, 1.8, 0.55, angle_deg), 0.8)


def car(x: float, y: float, angle_deg: float = 0.0) -> Obstacle:
    """Parked car, 4.3 m long, with chamfered corners."""
    body = rect(x - 2.15, y - 0.9, x + 2.15, y + 0.9).buffer(-0.35).buffer(0.35, quad_segs=1)
    return solid("parked car", affinity.rotate(body, angle_deg, origin=(x, y)), 1.45)


def bus_shelter(x: float, y: float, facing_deg: float) -> Obstacle:
    """Glass shelter, 4.0 x 1.5 m, a back and two sides of 8 cm, open towards `facing_deg`."""
    walls = rect(x - 2.0, y - 0.75, x + 2.0, y + 0.75).difference(rect(x - 1.92, y - 0.67, x + 1.92, y + 1.0))
    return solid("bus shelter", affinity.rotate(walls, facing_deg - 90.0, origin=(x, y)), 2.4)


def cafe_table(x: float, y: float) -> Obstacle:
    """Round table with its chairs pushed in."""
    return solid("cafe table", disc(x, y, 0.55, 8), 0.75)
