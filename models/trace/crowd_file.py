"""One file of recorded or simulated crowds: positions, obstacles, distance fields and the split."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from .orca_scenes import Crowd, CrowdSpec, map_axis

SPLITS = ("train", "val", "test")
FACTS = ("name", "origin", "resolution", "dt", "radius", "source", "layers")


class CrowdFileError(ValueError):
    """A file of crowds is missing, broken or of another format."""


@dataclass(frozen=True)
class Crowds:
    """Scenes padded to the fullest one.

    Attributes:
        name: Of the data set.
        positions: (S, N, T, 2) world x, y [m]; NaN where nobody is.
        polygons: (S, M, V, 2) convex obstacle outlines [m]; NaN padding.
        distance: (S, H, W) signed distance to the obstacles [m], float16; (S, 0, 0) without maps;
            (S, C, H, W) with several layers.
        origin: World x, y of the centre of cell (0, 0) [m].
        resolution: Cell size [m].
        split: (S,) index into `SPLITS`.
        dt: Time between frames [s].
        radius: Disc of a person [m].
        source: How the file was made.
        layers: Names of the C layers of the map.
    """

    name: str
    positions: NDArray[np.float32]
    polygons: NDArray[np.float32]
    distance: NDArray[np.float16]
    origin: tuple[float, float]
    resolution: float
    split: NDArray[np.uint8]
    dt: float
    radius: float
    source: dict
    layers: tuple[str, ...] = ("obstacle",)

    @property
    def has_map(self) -> bool:
        """Whether the scenes come with obstacles."""
        return self.distance.size > 0

    def polygons_of(self, scene: int) -> list[NDArray[np.float32]]:
        """The obstacle outlines of one scene without padding."""
        kept = [p[~np.isnan(p[:, 0])] for p in self.polygons[scene]]
        return [p for p in kept if len(p)]

    def save(self, path: Path) -> None:
        """Write atomically; the folder is made if needed."""
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = {k: getattr(self, k) for k in FACTS}
        arrays = {k: getattr(self, k) for k in ("positions", "polygons", "distance", "split")}
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            np.savez_compressed(file, facts=np.array(json.dumps(facts)), **arrays)
        part.replace(path)

    @classmethod
    def load(cls, path: Path) -> "Crowds":
        """Read what `save` wrote.

        Raises:
            CrowdFileError: When the file is missing or is no file of crowds.
        """
        if not path.is_file():
            raise CrowdFileError(f"there is no crowd file {path}; `footfall data orca` makes one")
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                facts = json.loads(str(file["facts"]))
                facts |= {k: tuple(facts[k]) for k in ("origin", "layers") if k in facts}
                crowds = cls(**facts, **{k: file[k] for k in ("positions", "polygons", "distance", "split")})
            crowds.check()
        except (OSError, EOFError, BadZipFile, KeyError, ValueError, TypeError) as error:
            raise CrowdFileError(f"{path} is not a crowd file: {error}") from error
        return crowds

    def check(self) -> None:
        """What is no set of scenes is refused.

        Raises:
            CrowdFileError: Says what is not as it must be.
        """
        scenes = len(self.positions)
        axes = {"positions": (4,), "polygons": (4,), "distance": (3, 4), "split": (1,)}
        for name, counts in axes.items():
            array = getattr(self, name)
            if array.ndim not in counts or len(array) != scenes or array.dtype.kind not in "fu":
                raise CrowdFileError(f"{name} has shape {array.shape} of {array.dtype} for {scenes} scenes")
        if self.positions.shape[-1] != 2 or self.polygons.shape[-1] != 2:
            raise CrowdFileError("positions and polygons must end in x and y")
        for name in ("dt", "resolution", "radius"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or not 0 < value < np.inf:
                raise CrowdFileError(f"{name} must be a number above 0, not {value!r}")
        if len(self.origin) != 2 or not np.isfinite(self.origin).all():
            raise CrowdFileError(f"origin must be two finite coordinates, not {self.origin}")


def pack_crowds(spec: CrowdSpec, crowds: Sequence[Crowd], seed: int, base: int | None = None) -> Crowds:
    """Pad finished scenes into one set.

    Args:
        spec: How they were drawn.
        crowds: Scene number 0, 1, 2, ...
        seed: The seed they were drawn with.
        base: The first `base` scenes are split 0.8 / 0.1 / 0.1, later ones only train; by default all.
    """
    count, base = len(crowds), min(base or len(crowds), len(crowds))
    positions = np.full((count, spec.most_agents, spec.frames, 2), np.nan, np.float32)
    corners = max((len(p) for c in crowds for p in c.polygons), default=0)
    polygons = np.full((count, spec.most_obstacles, corners, 2), np.nan, np.float32)
    axis = map_axis(spec)
    side = len(axis) if spec.most_obstacles else 0
    distance = np.zeros((count, side, side), np.float16)
    for s, crowd in enumerate(crowds):
        positions[s, : len(crowd.positions)] = crowd.positions
        distance[s] = np.clip(crowd.distance, -20, 20) if side else 0
        for m, polygon in enumerate(crowd.polygons):
            polygons[s, m, : len(polygon)] = polygon
    split = np.zeros(count, np.uint8)
    split[round(0.8 * base) : round(0.9 * base)] = SPLITS.index("val")
    split[round(0.9 * base) : base] = SPLITS.index("test")
    return Crowds(
        name=f"orca-{spec.subset}" + ("" if spec.area == 15 else f"-{spec.area:g}m"),
        positions=positions,
        polygons=polygons,
        distance=distance,
        origin=(float(axis[0]), float(axis[0])),
        resolution=spec.resolution,
        split=split,
        dt=1 / spec.rate_hz,
        radius=spec.radius,
        source={"seed": seed, **asdict(spec)},
    )
