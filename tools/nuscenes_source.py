"""Read pedestrians and maps from the tables of nuScenes (Caesar et al. 2020), as its documentation describes them.

The official devkit asks for numpy < 2 and shapely < 2.1, which this project cannot meet; the tables are plain
JSON, and only their published schema is used here.
"""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..models.trace.crowd_file import CrowdFileError

LAYERS = ("lane", "road_segment", "drivable_area", "road_divider", "lane_divider", "ped_crossing", "walkway")
"""The seven layers of TRACE (app. C.1), under their names in nuScenes."""
PEDESTRIANS = ("adult", "child", "construction_worker", "police_officer")
LINE = 0.3  # m, width of a divider in a raster


@dataclass(frozen=True)
class DrivingScene:
    """The pedestrians of one scene of 20 s.

    Attributes:
        name: `scene-0001`.
        location: Of the map.
        tracks: (T, 3) [t, x, y] of each pedestrian, s from the first key frame, m in the map's frame.
        sizes: (N, 2) mean length and width of their boxes [m].
    """

    name: str
    location: str
    tracks: list[np.ndarray]
    sizes: np.ndarray


def read_scenes(root: Path, version: str) -> list[DrivingScene]:
    """All scenes of a release, in the order of its table.

    Args:
        root: Holds the folder of the release, and `maps`.
        version: `v1.0-trainval`, `v1.0-mini`, ...

    Raises:
        CrowdFileError: When a table is missing, broken, or refers to a row that is not there.
    """

    def table(name: str, *fields: str) -> dict[str, dict[str, Any]]:
        return {row["token"]: row for row in read_table(root / version / f"{name}.json", ("token", *fields))}

    scenes, logs = table("scene", "name", "log_token"), table("log", "location")
    samples = table("sample", "timestamp", "scene_token")
    categories, instances = table("category", "name"), table("instance", "category_token")
    boxes = table("sample_annotation", "sample_token", "instance_token", "translation", "size")
    kinds = {f"human.pedestrian.{kind}" for kind in PEDESTRIANS}
    try:
        walking = {k for k, row in instances.items() if categories[row["category_token"]]["name"] in kinds}
        begins: dict[str, int] = {}
        for sample in samples.values():
            scene = sample["scene_token"]
            begins[scene] = min(begins.get(scene, sample["timestamp"]), sample["timestamp"])
        seen: dict[str, dict[str, list[list[float]]]] = {token: defaultdict(list) for token in scenes}
        for box in boxes.values():
            if box["instance_token"] in walking:
                sample = samples[box["sample_token"]]
                scene = sample["scene_token"]
                seconds = (sample["timestamp"] - begins[scene]) * 1e-6
                width, length = box["size"][:2]
                row = [seconds, *box["translation"][:2], length, width]
                seen[scene][box["instance_token"]].append(row)
        return [
            _scene(row["name"], logs[row["log_token"]]["location"], list(seen[token].values()))
            for token, row in scenes.items()
        ]
    except KeyError as error:
        raise CrowdFileError(f"{root / version}: a row refers to {error}, which no table holds") from error


def _scene(name: str, location: str, people: Sequence[list[list[float]]]) -> DrivingScene:
    rows = [np.array(sorted(person)) for person in people]
    sizes = np.array([row[:, 3:].mean(0) for row in rows]).reshape(-1, 2)
    return DrivingScene(name, location, [row[:, :3] for row in rows], sizes)


def read_layers(root: Path, location: str) -> dict[str, list[shapely.Geometry]]:
    """The shapes of each of `LAYERS` [m] from the map expansion; dividers are thin strips.

    Raises:
        CrowdFileError: When the map is missing, broken, or refers to a shape that is not there.
    """
    path = root / "maps" / "expansion" / f"{location}.json"
    tables = read_json(path)
    try:
        nodes = {row["token"]: (row["x"], row["y"]) for row in tables["node"]}
        lines = {row["token"]: [nodes[t] for t in row["node_tokens"]] for row in tables["line"]}
        polygons = {row["token"]: _polygon(row, nodes) for row in tables["polygon"]}
        shapes: dict[str, list[shapely.Geometry]] = {}
        for layer in LAYERS:
            rows = tables[layer]
            if layer.endswith("divider"):
                ways = [lines[row["line_token"]] for row in rows]
                shapes[layer] = [shapely.LineString(way).buffer(LINE / 2) for way in ways if len(way) > 1]
            else:
                tokens = [t for row in rows for t in row.get("polygon_tokens", [row.get("polygon_token")])]
                shapes[layer] = [polygons[token] for token in tokens]
    except KeyError as error:
        raise CrowdFileError(f"{path}: {error} is missing, or referred to and not there") from error
    return shapes


def _polygon(row: dict[str, Any], nodes: dict[str, tuple[float, float]]) -> shapely.Geometry:
    holes = [[nodes[t] for t in hole["node_tokens"]] for hole in row["holes"]]
    outline = [nodes[t] for t in row["exterior_node_tokens"]]
    return shapely.make_valid(shapely.Polygon(outline, [hole for hole in holes if len(hole) > 2]))


def read_table(path: Path, fields: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The rows of a table.

    Raises:
        CrowdFileError: When the file is missing, no table, or a row lacks one of the fields.
    """
    rows = read_json(path)
    if not isinstance(rows, list):
        raise CrowdFileError(f"{path}: a table is a list of rows")
    for number, row in enumerate(rows):
        missing = [field for field in fields if field not in row]
        if missing:
            raise CrowdFileError(f"{path}: row {number} has no {missing[0]!r}")
        yield row


def read_json(path: Path) -> Any:
    """A parsed file.

    Raises:
        CrowdFileError: When it is missing or no JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise CrowdFileError(f"{path}: no such file; nuScenes has one") from error
    except ValueError as error:
        raise CrowdFileError(f"{path}: not JSON ({error})") from error
