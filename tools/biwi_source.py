"""Read the BIWI (ETH) and UCY recordings as their authors published them: tracks, groups and obstacles.

BIWI walking pedestrians: Pellegrini et al., "You'll never walk alone", ICCV 2009. UCY crowds: Lerner et al.,
"Crowds by example", Eurographics 2007.
"""

import json
import re
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import shapely
from PIL import Image

from ..models.scene import SceneError

ANNOTATION_STEP = 0.4  # s between two annotations of BIWI, whatever the video's frame rate (their info.txt)
UCY_FRAME_RATE = 25.0  # Hz
UCY_PICTURE = (720, 576)  # pixels
# World from UCY annotation pixels (origin in the picture's middle, y up), as in the metric release that
# the field uses. It is one scaling for all scenes, not a homography, so UCY metres are approximate.
UCY_SCALE = np.array([0.02104652, 0.02386599])  # m a pixel
UCY_MIDDLE = np.array([7.576743, 6.873402])  # m
WALL = 0.05  # m, thickness of a wall that is given as a line
JOIN = 0.3  # m between the ends of two lines that are one wall
EDGE = 0.5  # m from the picture's edge within which a line counts as cut by it
SPECK = 0.01  # m2; smaller obstacles are noise of the mask


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording: {id: (T, 3) [t, x, y]} in s and m, ids who walk together, and what is built there.

    `fronts` are the fronts of houses as the camera sees them; the house goes on behind, towards larger y.
    """

    tracks: dict[int, np.ndarray]
    groups: tuple[tuple[int, ...], ...]
    obstacles: list[shapely.Polygon]
    fronts: list[shapely.Polygon]


def read_recording(folder: Path) -> Recording:
    """Read a folder of BIWI (obsmat.txt, H.txt, map.png) or UCY (annotation.vsp) files.

    Raises:
        SceneError: A file is missing or not in its format.
    """
    if (folder / "annotation.vsp").is_file():
        return _read_ucy(folder)
    if (folder / "obsmat.txt").is_file():
        return _read_biwi(folder)
    raise SceneError(f"{folder}: neither obsmat.txt (BIWI) nor annotation.vsp (UCY) is there")


def _read_biwi(folder: Path) -> Recording:
    rows = _numbers(folder / "obsmat.txt", 8)[:, [1, 0, 2, 4]]  # id, frame, x, y
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    by_id = np.split(rows, np.nonzero(np.diff(rows[:, 0]))[0] + 1)
    steps = np.concatenate([np.diff(track[:, 1]) for track in by_id])
    if not len(steps) or steps.min() <= 0:
        raise SceneError(f"{folder / 'obsmat.txt'}: nobody is seen twice, or somebody twice in a frame")
    # The step is 6 frames in eth and 10 in hotel: 0.4 s both. Copies that take every 10th frame of eth as
    # 0.4 s play it 1.67 times too fast.
    seconds = ANNOTATION_STEP / steps.min()
    start = rows[:, 1].min()
    tracks = {
        int(track[0, 0]): np.column_stack([(track[:, 1] - start) * seconds, track[:, 2:]]) for track in by_id
    }
    obstacles = _from_mask(folder / "map.png", _numbers(folder / "H.txt", 3))
    return Recording(tracks, _groups(folder, set(tracks)), obstacles, [])


def _read_ucy(folder: Path) -> Recording:
    path = folder / "annotation.vsp"
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        splines, rest = _splines(lines)
        walls, cylinders = _vsp_obstacles(rest)
    except (IndexError, ValueError) as error:
        raise SceneError(f"{path}: not an annotation of splines ({error})") from error
    start = min(spline[0, 2] for spline in splines)
    tracks = {
        number: np.column_stack([(spline[:, 2] - start) / UCY_FRAME_RATE, _ucy_world(spline[:, :2])])
        for number, spline in enumerate(splines, start=1)
    }
    extra = folder / "obstacles_world.json"
    if extra.is_file():
        walls += [np.array(wall) for wall in json.loads(extra.read_text(encoding="utf-8"))["segments"]]
    fronts = []
    if (folder / "static.txt").is_file():
        pixels = _numbers(folder / "static.txt", 2) - np.array(UCY_PICTURE) / 2
        fronts.append(shapely.Polygon(_ucy_world(pixels * (1, -1))))  # column, row -> x, y up
    picture = shapely.box(*_ucy_world(-np.array(UCY_PICTURE) / 2), *_ucy_world(np.array(UCY_PICTURE) / 2))
    # Lines off the picture cannot be checked against the video; some copies put a house where nobody sees it.
    walls = [wall for wall in walls if shapely.LineString(wall).intersects(picture)]
    return Recording(tracks, _groups(folder, set(tracks)), _from_walls(walls, picture) + cylinders, fronts)


def _ucy_world(pixels: np.ndarray) -> np.ndarray:
    return UCY_MIDDLE + UCY_SCALE * pixels


def _splines(lines: list[str]) -> tuple[list[np.ndarray], list[str]]:
    """Control points (K, 3) [x, y, frame] of every spline, and the lines after them."""
    splines, at = [], 1
    for _ in range(int(lines[0].split()[0])):
        count = int(lines[at].split()[0])
        points = [[float(word) for word in line.split()[:3]] for line in lines[at + 1 : at + 1 + count]]
        splines.append(np.array(points).reshape(count, 3))
        if (np.diff(splines[-1][:, 2]) <= 0).any():
            raise ValueError(f"frames do not grow in the spline at line {at + 1}")
        at += 1 + count
    return splines, lines[at:]


def _vsp_obstacles(lines: list[str]) -> tuple[list[np.ndarray], list[shapely.Polygon]]:
    """Walls (2, 2) and what stands there all the time, m, from the end of an annotation."""
    words = [line.split() for line in lines if line.strip()]
    if not words:
        return [], []
    count = int(words[0][0])
    walls = [_ucy_world(np.array(row[:4], dtype=float).reshape(2, 2)) for row in words[1 : 1 + count]]
    cylinders = []
    for center, size, when in zip(*(words[count + 2 + part :: 3] for part in range(3)), strict=True):
        if when[0] == when[1]:  # "0 0" is for ever; the others are people who stand for a while
            x, y = _ucy_world(np.array(center[:2], dtype=float))
            cylinders.append(_disc(x, y, float(size[0]) * float(UCY_SCALE.mean())))
    return walls, cylinders


def _disc(x: float, y: float, radius: float) -> shapely.Polygon:
    return shapely.Point(x, y).buffer(radius, quad_segs=2)


def _from_walls(walls: list[np.ndarray], picture: shapely.Polygon) -> list[shapely.Polygon]:
    """Solids from lines: a loop, or a chain that the picture cuts at both ends, filled; else thin walls."""
    solids = []
    for chain in _chains([wall for wall in walls if np.ptp(wall, axis=0).max() > JOIN]):
        ends = shapely.points(chain[[0, -1]])
        cut = ~shapely.contains(picture.buffer(-EDGE), ends)
        loop = np.hypot(*(chain[0] - chain[-1])) < JOIN
        if len(chain) > 2 and (loop or cut.all()):
            solids.append(shapely.Polygon(chain))
        else:
            lines = [shapely.LineString(pair) for pair in pairwise(chain)]
            solids += [line.buffer(WALL / 2, cap_style="square") for line in lines]
    return solids


def _chains(walls: list[np.ndarray]) -> list[np.ndarray]:
    """Join lines (2, 2) whose ends meet into chains (K, 2)."""
    chains: list[np.ndarray] = []
    for wall in walls:
        joined = wall
        for other in [*chains]:
            for near, far in product((joined, joined[::-1]), (other, other[::-1])):
                if np.hypot(*(near[-1] - far[0])) < JOIN:
                    joined = np.concatenate([near[:-1], [(near[-1] + far[0]) / 2], far[1:]])
                    chains = [chain for chain in chains if chain is not other]
                    break
        chains.append(joined)
    return chains


def _from_mask(path: Path, world_from_pixel: np.ndarray) -> list[shapely.Polygon]:
    """Vectorise an obstacle mask (255 = obstacle); the homography takes (row, column, 1), in this order."""
    if not path.is_file():
        raise SceneError(f"{path}: no such file; the obstacles of a BIWI scene are in it")
    with Image.open(path) as image:
        mask = np.pad(np.array(image.convert("L")) > 127, 1).astype(np.int8)
    starts, stops = (np.argwhere(np.diff(mask, axis=1) == sign) for sign in (1, -1))  # runs of each row
    runs = shapely.box(starts[:, 0] - 1.5, starts[:, 1] - 0.5, starts[:, 0] - 0.5, stops[:, 1] - 0.5)
    solids = []
    for part in shapely.get_parts(shapely.union_all(runs)):
        world = shapely.transform(shapely.simplify(part, 1.0), lambda rc: _project(world_from_pixel, rc))
        solids += [solid for solid in shapely.get_parts(world.simplify(WALL)) if solid.area > SPECK]
    return solids


def _project(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    moved = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return moved[:, :2] / moved[:, 2:]


def _groups(folder: Path, known: set[int]) -> tuple[tuple[int, ...], ...]:
    """Ids in each line of groups.txt, without ids that have no track."""
    path = folder / "groups.txt"
    if not path.is_file():
        return ()
    lines = [re.findall(r"\d+", line) for line in path.read_text(encoding="utf-8").splitlines()]
    groups = [tuple(number for number in map(int, line) if number in known) for line in lines]
    return tuple(group for group in groups if len(group) > 1)


def _numbers(path: Path, columns: int) -> np.ndarray:
    try:
        rows = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise SceneError(f"{path}: no such file") from error
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from error
    if rows.shape[1] != columns or not len(rows) or not np.isfinite(rows).all():
        raise SceneError(f"{path}: {columns} finite numbers a row are needed, not {rows.shape[1]}")
    return rows
