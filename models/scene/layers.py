"""Rasters, polygons and tracks of a scene: reading, writing, and the geometry between them."""

from pathlib import Path

import numpy as np
import shapely
from PIL import Image

from .file import Point, SceneError


def read_png(path: Path) -> np.ndarray:
    """Read a raster, (H, W), row 0 = smallest y: bool (1-bit file), uint8 (8-bit) or uint16 (16-bit).

    Raises:
        SceneError: The file is missing or not a greyscale PNG.
    """
    kinds = {"1": np.bool_, "L": np.uint8, "I;16": np.uint16}
    try:
        with Image.open(path) as image:
            if image.mode not in kinds:
                raise SceneError(f"{path}: a {image.mode} image; layers are 1-bit, 8-bit or 16-bit greyscale")
            pixels = np.array(image, dtype=kinds[image.mode])
    except OSError as error:
        raise SceneError(f"{path}: {'not a PNG file' if path.is_file() else 'no such file'}") from error
    return pixels[::-1].copy()


def write_png(cells: np.ndarray, path: Path) -> None:
    """Write a bool, uint8 or uint16 raster (H, W), row 0 = smallest y, so that a viewer shows y upwards."""
    if cells.dtype not in (np.bool_, np.uint8, np.uint16):
        raise SceneError(f"{path.name}: a layer is bool, uint8 or uint16, not {cells.dtype}")
    Image.fromarray(np.ascontiguousarray(cells[::-1])).save(path, optimize=True)


def cell_centers(shape: tuple[int, int], resolution: float, origin: Point) -> tuple[np.ndarray, np.ndarray]:
    """X (W,) and y (H,) of the cell centres of a raster, metres, world frame."""
    rows, cols = shape
    return origin[0] + (np.arange(cols) + 0.5) * resolution, origin[1] + (np.arange(rows) + 0.5) * resolution


def rasterize(
    polygons: list[np.ndarray],
    shape: tuple[int, int],
    resolution: float,
    origin: Point,
    touched: bool = False,
) -> np.ndarray:
    """Cells (H, W) bool whose centre lies in a polygon, or with `touched` those that any polygon overlaps."""
    cells = np.zeros(shape, dtype=bool)
    x, y = cell_centers(shape, resolution, origin)
    half = 0.5 * resolution - 1e-9  # a polygon that only shares a cell's edge does not touch it
    for polygon in polygons:
        low, high = polygon.min(axis=0) - resolution, polygon.max(axis=0) + resolution
        cols = slice(*np.searchsorted(x, [low[0], high[0]]))
        rows = slice(*np.searchsorted(y, [low[1], high[1]]))
        grid_x, grid_y = np.meshgrid(x[cols], y[rows])
        area = shapely.Polygon(polygon)
        shapely.prepare(area)
        if touched:
            boxes = shapely.box(grid_x - half, grid_y - half, grid_x + half, grid_y + half)
            cells[rows, cols] |= shapely.intersects(area, boxes)
        else:
            cells[rows, cols] |= shapely.contains_xy(area, grid_x, grid_y)
    return cells


def signed_distance(polygons: list[np.ndarray], xy: np.ndarray) -> np.ndarray:
    """Distance (...,) in metres of points (..., 2) to the nearest polygon, negative inside, inf without."""
    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    if not polygons:
        return np.full(np.shape(xy)[:-1], np.inf)
    start = np.concatenate(polygons)  # (E, 2), all edges of all polygons
    edge = np.concatenate([np.roll(polygon, -1, axis=0) for polygon in polygons]) - start
    first = np.cumsum([0] + [len(polygon) for polygon in polygons[:-1]])
    chunks = np.array_split(points, max(1, len(points) * len(start) // 500_000))  # a few MB at a time
    nearest = [_signed_distance(chunk, start, edge, first) for chunk in chunks]
    return np.concatenate(nearest).reshape(np.shape(xy)[:-1])


def _signed_distance(
    points: np.ndarray, start: np.ndarray, edge: np.ndarray, first: np.ndarray
) -> np.ndarray:
    x, y = (points[:, None, axis] - start[:, axis] for axis in (0, 1))  # (P, E)
    dx, dy = edge.T
    along = np.clip((x * dx + y * dy) / np.maximum(dx**2 + dy**2, 1e-18), 0.0, 1.0)
    square = (x - along * dx) ** 2 + (y - along * dy) ** 2
    # Even-odd rule: count the edges that a ray towards +x crosses.
    crossed = ((y < 0) != (y < dy)) & ((x * dy < y * dx) == (dy > 0))
    inside = np.add.reduceat(crossed, first, axis=1, dtype=np.int64) % 2 == 1  # (P, polygons)
    gap = np.sqrt(np.minimum.reduceat(square, first, axis=1))
    return np.where(inside, -gap, gap).min(axis=1)


def polygon_fault(polygon: np.ndarray) -> str | None:
    """Say what is wrong with an outline (K, 2): its shape, a NaN, no area, crossing itself; None: nothing."""
    if polygon.ndim != 2 or polygon.shape[1:] != (2,) or len(polygon) < 3:
        return f"has the shape {polygon.shape}; a polygon is (K, 2) with at least three points"
    if not np.isfinite(polygon).all():
        return "has a corner that is not a finite number"
    area = shapely.Polygon(polygon)
    if not area.is_valid:
        return f"crosses or touches itself ({shapely.is_valid_reason(area)})"
    if area.area < 1e-6:
        return "has no area"
    return None


def read_tracks(path: Path) -> dict[int, np.ndarray]:
    """Read `id,t,x,y` rows (s, m) into {id: (T, 3) [t, x, y]}, ids ascending.

    Raises:
        SceneError: The file is missing, has another header, or a row is not an id and three finite numbers.
    """
    try:
        header, *lines = path.read_text(encoding="utf-8").splitlines() or [""]
        rows = np.array([line.split(",") for line in lines if line], dtype=np.float64).reshape(-1, 4)
    except OSError as error:
        raise SceneError(f"{path}: no such file") from error
    except ValueError as error:
        raise SceneError(f"{path}: a row is not an id and three numbers t, x, y ({error})") from error
    if header != "id,t,x,y":
        raise SceneError(f"{path}: the header is '{header}', not 'id,t,x,y'")
    if not np.isfinite(rows).all():
        raise SceneError(f"{path}: a number is not finite")
    return {int(number): rows[rows[:, 0] == number, 1:] for number in np.unique(rows[:, 0])}


def write_tracks(tracks: dict[int, np.ndarray], path: Path) -> None:
    """Write tracks {id: (T, 3) [t, x, y]} as CSV, times to the millisecond, places to the millimetre."""
    lines = ["id,t,x,y"]
    for number, samples in tracks.items():
        lines += [f"{number},{t:.3f},{x:.3f},{y:.3f}" for t, x, y in samples + 0.0]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
