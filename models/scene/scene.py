"""A place and the people in it: layers, obstacles, terrain, areas, population, events, and the folder."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from .checks import check_scene
from .draw import draw_entries
from .file import (
    Event,
    Obstacle,
    Point,
    RandomPopulation,
    RecordedFile,
    SceneError,
    SceneFile,
    TerrainFile,
    near,
    read_scene_file,
    write_scene_file,
)
from .layers import (
    rasterize,
    read_png,
    read_tracks,
    signed_distance,
    write_png,
    write_tracks,
)
from .population import Entry, RecordedPopulation, Track, recorded_entries
from .terrain import Terrain

SHIPPED = Path(__file__).resolve().parents[2] / "launch" / "scenes"
ROAD_COST = 4.0
"""A metre of road off the crosswalk counts as so many metres of pavement for somebody who looks for a way."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One place with its people; a scene that breaks a rule cannot be made.

    Attributes:
        name: Folder name.
        description: One sentence for people.
        resolution: Edge of a layer's cell, metres.
        origin: World x, y of the outer corner of cell [0, 0], metres.
        layers: Named rasters (H, W), bool or uint8, all of one shape; row index grows with y. `walkable`
            (where a person can stand, obstacles not considered) is always there; `road`, `pavement`,
            `crosswalk` and so on as the place has them.
        obstacles: Prisms with counter-clockwise outlines.
        terrain: Ground heights, or None: flat at z = 0.
        areas: Named polygons (K, 2), metres, where people enter and go to.
        population: Who walks there, drawn or recorded; None: nobody.
        events: What happens at which time, ascending.

    Raises:
        SceneError: Says which part is wrong and what would be right.
    """

    name: str
    description: str
    resolution: float
    origin: Point
    layers: Mapping[str, np.ndarray]
    obstacles: tuple[Obstacle, ...] = ()
    terrain: Terrain | None = None
    areas: Mapping[str, np.ndarray] = field(default_factory=dict)
    population: RandomPopulation | RecordedPopulation | None = None
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        check_scene(self)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (along y) and columns (along x) of every layer."""
        rows, cols = self.layers["walkable"].shape
        return rows, cols

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x, smallest y, largest x, largest y of the map, metres, world frame."""
        (x, y), (rows, cols) = self.origin, self.shape
        return x, y, x + cols * self.resolution, y + rows * self.resolution

    def blocked(self) -> np.ndarray:
        """Cells (H, W) bool where nobody can stand: not walkable, or overlapped by an obstacle. Read-only."""
        return self._blocked

    def walking_cost(self) -> np.ndarray:
        """Cost of a metre (H, W) float32: 1, or 4 on a road off the crosswalk, inf where blocked."""
        cost = np.ones(self.shape, dtype=np.float32)
        if "road" in self.layers:
            road = self.layers["road"] > 0
            if "crosswalk" in self.layers:
                road &= self.layers["crosswalk"] == 0
            cost[road] = ROAD_COST
        cost[self._blocked] = np.inf
        return cost

    def obstacle_distance(self, xy: np.ndarray) -> np.ndarray:
        """Distance (...,) in metres from points (..., 2) to the nearest obstacle, negative inside one."""
        return signed_distance([obstacle.polygon for obstacle in self.obstacles], xy)

    def height_at(self, xy: np.ndarray) -> np.ndarray:
        """Ground height (...,) in metres at world points (..., 2)."""
        return self.terrain.height_at(xy) if self.terrain else np.zeros(np.shape(xy)[:-1])

    def sample_population(
        self, seed: int, count: int | None = None, duration: float | None = None
    ) -> list[Entry]:
        """Who enters where and when, with which goal; the same arguments give the same list.

        Args:
            seed: Seed of the draw; a recorded population takes only the bodies from it.
            count: Number of pedestrians instead of the scene's own; of a recording the first that many.
            duration: Leave out who enters later than this, seconds.

        Returns:
            Entries ordered by time.

        Raises:
            SceneError: An area has no room for that many.
        """
        if seed < 0 or (count is not None and count < 0):
            raise SceneError(f"seed and count must not be negative (seed {seed}, count {count})")
        if self.population is None:
            return []
        sample = recorded_entries if isinstance(self.population, RecordedPopulation) else draw_entries
        entries = sample(self, seed, count)
        return [entry for entry in entries if duration is None or entry.time <= duration]

    @cached_property
    def _blocked(self) -> np.ndarray:
        outlines = [obstacle.polygon for obstacle in self.obstacles]
        blocked = rasterize(outlines, self.shape, self.resolution, self.origin, touched=True)
        blocked |= self.layers["walkable"] == 0
        blocked.setflags(write=False)
        return blocked


def shipped_scenes() -> list[str]:
    """Names of the scenes that come with footfall."""
    return sorted(path.parent.name for path in SHIPPED.glob("*/scene.yaml"))


def load_scene(name: str | Path) -> Scene:
    """Load a scene by folder, by shipped name, or by its name in ./scenes.

    Raises:
        SceneError: There is no such scene, or something in it is wrong.
    """
    folder = _find(name)
    text = read_scene_file(folder / "scene.yaml")
    if not text.layers:
        raise SceneError(f"{folder / 'scene.yaml'}: layers: at least 'walkable' is needed")
    rows, cols = round(text.size[1] / text.resolution), round(text.size[0] / text.resolution)
    layers = {}
    for layer, file in text.layers.items():
        layers[layer] = read_png(_inside(folder, file))
        if layers[layer].shape != (rows, cols):
            high, wide = layers[layer].shape
            raise SceneError(
                f"{folder / file}: {wide} x {high} pixels; {text.size[0]:g} x {text.size[1]:g} m at"
                f" {text.resolution:g} m a cell need {cols} x {rows}"
            )
    try:
        return Scene(
            name=text.name,
            description=text.description,
            resolution=text.resolution,
            origin=text.origin,
            layers=layers,
            obstacles=text.obstacles,
            terrain=_load_terrain(folder, text) if text.terrain else None,
            areas=text.areas,
            population=_load_population(folder, text.population),
            events=tuple(sorted(text.events, key=lambda event: event.time)),
        )
    except SceneError as error:
        place = folder / "scene.yaml"
        raise error if str(error).startswith(str(folder)) else SceneError(f"{place}: {error}") from error


def save_scene(scene: Scene, folder: str | Path) -> Path:
    """Write a scene into a folder, made if missing, and return it; the same scene gives the same files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for layer, cells in scene.layers.items():
        write_png(cells, folder / f"{layer}.png")
    low_x, low_y, high_x, high_y = scene.bounds
    population = scene.population
    if isinstance(population, RecordedPopulation):
        write_tracks({track.id: track.samples for track in population.tracks}, folder / "tracks.csv")
        population = RecordedFile("tracks.csv", population.groups)
    text = SceneFile(
        name=scene.name,
        description=scene.description,
        resolution=scene.resolution,
        origin=scene.origin,
        size=(high_x - low_x, high_y - low_y),
        layers={layer: f"{layer}.png" for layer in scene.layers},
        terrain=_save_terrain(scene.terrain, folder) if scene.terrain else None,
        obstacles=scene.obstacles,
        areas=dict(scene.areas),
        population=population,
        events=scene.events,
    )
    write_scene_file(text, folder / "scene.yaml")
    return folder


def _find(name: str | Path) -> Path:
    text = str(name)
    for folder in (SHIPPED / text, Path("scenes") / text) if Path(text).name == text else ():
        if (folder / "scene.yaml").is_file():
            return folder
    folder = Path(name)
    folder = folder.parent if folder.name == "scene.yaml" else folder
    if (folder / "scene.yaml").is_file():
        return folder
    own = sorted(path.parent.name for path in Path("scenes").glob("*/scene.yaml"))
    known = shipped_scenes() + own
    raise SceneError(
        f"no scene '{name}'{near(text, known) or '; give a folder with a scene.yaml or one of the names'}"
        f" (known here: {', '.join(known)})"
    )


def _inside(folder: Path, file: str) -> Path:
    if Path(file).name != file:
        raise SceneError(f"{folder / 'scene.yaml'}: '{file}' is not a file name inside the scene's folder")
    return folder / file


def _load_terrain(folder: Path, text: SceneFile) -> Terrain:
    assert text.terrain
    path = _inside(folder, text.terrain.file)
    values = read_png(path)
    cols, rows = (round(length / text.terrain.resolution) + 1 for length in text.size)
    if values.dtype != np.uint16 or values.shape != (rows, cols):
        high, wide = values.shape
        raise SceneError(
            f"{path}: {wide} x {high} pixels of {values.dtype}; {text.size[0]:g} x {text.size[1]:g} m with a"
            f" point every {text.terrain.resolution:g} m need {cols} x {rows} pixels of uint16"
        )
    heights = (text.terrain.offset + text.terrain.step * values.astype(np.float64)).astype(np.float32)
    return Terrain(heights, text.terrain.resolution, text.origin)


def _save_terrain(terrain: Terrain, folder: Path) -> TerrainFile:
    step = 0.001
    offset = float(np.floor(float(terrain.heights.min()) / step) * step)
    values = np.round((terrain.heights.astype(np.float64) - offset) / step)
    if values.max() > np.iinfo(np.uint16).max:
        raise SceneError("terrain: more than 65 m between the lowest and the highest point")
    write_png(values.astype(np.uint16), folder / "heights.png")
    return TerrainFile("heights.png", terrain.resolution, step, offset)


def _load_population(
    folder: Path, text: RandomPopulation | RecordedFile | None
) -> RandomPopulation | RecordedPopulation | None:
    if not isinstance(text, RecordedFile):
        return text
    samples = read_tracks(_inside(folder, text.tracks))
    return RecordedPopulation(tuple(Track(*item) for item in samples.items()), text.groups)
