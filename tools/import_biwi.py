"""Make a scene from a BIWI or UCY recording: `footfall import biwi FOLDER --scene hotel`."""

import argparse
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from scipy.interpolate import PchipInterpolator

from ..models.scene import Obstacle, RecordedPopulation, Scene, SceneError, Track, save_scene
from ..models.scene.file import near
from ..models.scene.layers import rasterize, signed_distance
from .biwi_source import read_recording
from .scene_shapes import outline

SCENES = {  # name: the folders that copies of the recordings use for it
    "eth": ("eth", "seq_eth", "ETH/seq_eth"),
    "hotel": ("hotel", "seq_hotel", "ETH/seq_hotel"),
    "zara01": ("zara01", "UCY/zara01"),
    "zara02": ("zara02", "UCY/zara02"),
    "students03": ("students03", "UCY/students03"),
}
RATE = 10.0  # Hz
RESOLUTION = 0.1  # m
MARGIN = 2.0  # m of map around the tracks
HEIGHT = 2.5  # m; the recordings do not say how high things are
SPECK = 0.01  # m2; less is noise
IN_HOUSES = 0.005  # share of track points that may lie in a house
SETBACKS = np.arange(0.0, 1.5, 0.1)  # m


def import_biwi(source: str | Path, scene: str, out: str | Path) -> Scene:
    """Read one recording, write it as a scene folder and return the scene; see `read_scene`."""
    made = read_scene(source, scene, Path(out).resolve().name)
    save_scene(made, out)
    return made


def read_scene(source: str | Path, scene: str, name: str) -> Scene:
    """Make a scene of one recording.

    Tracks are resampled to 10 Hz with monotone cubic interpolation (no overshoot between annotations); time 0
    is the first annotated frame.

    Args:
        source: Folder of the recording, or the folder that holds `eth`, `hotel`, ... side by side.
        scene: eth, hotel, zara01, zara02 or students03.
        name: Of the scene that is made.

    Raises:
        SceneError: The recording is not there or not in its format.
    """
    recording = read_recording(find_recording(Path(source), scene))
    tracks = {number: _resample(track) for number, track in sorted(recording.tracks.items())}
    points = np.concatenate([track[:, 1:] for track in tracks.values()])
    low = np.floor((points.min(axis=0) - MARGIN) / RESOLUTION) * RESOLUTION
    cells = np.ceil((points.max(axis=0) + MARGIN - low) / RESOLUTION).astype(int)
    high = low + cells * RESOLUTION
    bounds = shapely.box(*low, *high)
    houses = [_house(front, float(high[1]), points) for front in recording.fronts]
    obstacles = [
        Obstacle(f"{name} {index}", outline(solid), HEIGHT)
        for name, shapes in (("house", houses), ("obstacle", recording.obstacles))
        for index, solid in enumerate(_clip(shapes, bounds), start=1)
    ]
    shape = (int(cells[1]), int(cells[0]))
    origin = (round(float(low[0]), 4), round(float(low[1]), 4))
    solid = rasterize([obstacle.polygon for obstacle in obstacles], shape, RESOLUTION, origin)
    seconds = max(track[-1, 0] for track in tracks.values())
    return Scene(
        name=name,
        description=f"Recorded: {scene}, {len(tracks)} pedestrians in {seconds:.0f} s.",
        resolution=RESOLUTION,
        origin=origin,
        layers={"walkable": ~solid, "obstacle": solid},
        obstacles=tuple(obstacles),
        population=RecordedPopulation(
            tuple(Track(number, track) for number, track in tracks.items()), recording.groups
        ),
    )


def overlap(scene: Scene, depth: float = 0.1) -> float:
    """Share of all recorded points that lie more than `depth` metres inside an obstacle."""
    assert isinstance(scene.population, RecordedPopulation)
    points = np.concatenate([track.samples[:, 1:] for track in scene.population.tracks])
    distance = signed_distance([obstacle.polygon for obstacle in scene.obstacles], points)
    return float((distance < -depth).mean())


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `biwi` to the verbs of `footfall import`."""
    parser = subparsers.add_parser("biwi", help="a BIWI (ETH, Hotel) or UCY recording", description=__doc__)
    parser.add_argument("folder", type=Path, help="the recording's folder, or the one that holds several")
    parser.add_argument("--scene", required=True, help=", ".join(SCENES))
    parser.add_argument("--out", type=Path, help="folder to write (./scenes/SCENE)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Import as the arguments say."""
    out = args.out or Path("scenes") / args.scene
    scene = import_biwi(args.folder, args.scene, out)
    moved = [entry.moved for entry in scene.sample_population(seed=0) if entry.moved > 0]
    assert isinstance(scene.population, RecordedPopulation)
    low_x, low_y, high_x, high_y = scene.bounds
    print(f"{out}: {scene.description}")
    print(f"  map {high_x - low_x:.1f} x {high_y - low_y:.1f} m, {len(scene.obstacles)} obstacles")
    print(f"  {len(scene.population.groups)} groups, {100 * overlap(scene):.2f} % of points inside obstacles")
    print(f"  {len(moved)} entry points moved out of obstacles, at most {max(moved, default=0):.2f} m")
    return 0


def find_recording(source: Path, scene: str) -> Path:
    """The folder of a recording: `source` itself, or one in it.

    Raises:
        SceneError: No such recording is known, or it is not there.
    """
    if scene not in SCENES:
        hint = near(scene, list(SCENES)) or f"; there are {', '.join(SCENES)}"
        raise SceneError(f"no recording '{scene}'{hint}")
    for folder in [*(source / name for name in SCENES[scene]), source]:
        if (folder / "annotation.vsp").is_file() or (folder / "obsmat.txt").is_file():
            return folder
    raise SceneError(
        f"{source}: neither it nor {', '.join(SCENES[scene])} in it has an obsmat.txt (BIWI) or an"
        f" annotation.vsp (UCY)"
    )


def _resample(track: np.ndarray) -> np.ndarray:
    """Track (T, 3) [t, x, y] at 10 Hz, at whole tenths of a second from the first to the last annotation."""
    first, last = np.round(track[[0, -1], 0] * RATE).astype(int)
    times = np.arange(first, last + 1) / RATE
    if len(track) == 1:
        return np.array([[times[0], *track[0, 1:]]])
    inside = np.clip(times, track[0, 0], track[-1, 0])
    return np.column_stack([times, PchipInterpolator(track[:, 0], track[:, 1:])(inside)])


def _house(front: shapely.Polygon, high_y: float, points: np.ndarray) -> shapely.Geometry:
    """The front and all that lies behind it up to the map's edge, set back until people are out of it.

    People are annotated at their heads, and a head before a shop window appears in the window: the outline
    that the picture gives is too far out by some decimetres.
    """
    ring, top = np.array(front.exterior.coords), high_y + SETBACKS[-1]
    behind = [
        shapely.MultiPoint([start, end, (start[0], top), (end[0], top)]).convex_hull
        for start, end in pairwise(ring)
    ]
    house = shapely.union_all([front.buffer(0), *behind])
    for setback in SETBACKS:
        smaller = shapely.buffer(house, -setback, join_style="mitre")
        if shapely.contains_xy(smaller, points[:, 0], points[:, 1]).mean() <= IN_HOUSES:
            return smaller
    raise SceneError(f"people walk more than {SETBACKS[-1]:.1f} m deep in the house outlined by static.txt")


def _clip(shapes: Sequence[shapely.Geometry], bounds: shapely.Polygon) -> list[shapely.Polygon]:
    """The parts of shapes inside the map, as polygons without holes, simplified to 3 cm."""
    whole = shapely.union_all([shapely.intersection(shape, bounds) for shape in shapes])
    parts = [part for part in shapely.get_parts(whole) if isinstance(part, shapely.Polygon)]
    solids = [shapely.simplify(shapely.Polygon(part.exterior), 0.03) for part in parts]
    return [solid for solid in solids if shapely.area(solid) > SPECK]
