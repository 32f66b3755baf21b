"""`footfall data nuscenes`: the pedestrians of nuScenes with seven map layers, in the files that training reads.

The set is licensed (nuscenes.org) and read where the user put it: `v1.0-*/*.json` and `maps/expansion/*.json`.
Which scene is for what says a JSON file of names, {"train": [...], "val": [...], "test": [...]}. That of the
official forecasting benchmark, written with the devkit in an environment of its own:

    import json
    from nuscenes.utils.splits import create_splits_scenes
    s = create_splits_scenes()
    s = {"train": s["train"][200:], "val": s["train"][:200], "test": s["val"]}
    json.dump(s, open("splits.json", "w"))
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import shapely

from ..models.trace.crowd_file import SPLITS, CrowdFileError
from ..models.trace.recordings import FAR, RecordedMaps, Recording, Split, census, pack_recordings
from ..models.trace.scene_map import signed_distance
from .nuscenes_source import LAYERS, DrivingScene, read_json, read_layers, read_scenes

SIDE = 100.0  # m of map around the middle of the pedestrians of a scene; who is outside is left out
RESOLUTION = 0.5  # m


def add_parser(subparsers) -> None:
    """Add `data nuscenes` to the command line."""
    parser = subparsers.add_parser(
        "nuscenes",
        help="recorded pedestrians: nuScenes, with seven map layers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="holds v1.0-trainval/ (or another release) and maps/")
    parser.add_argument("--version", default="v1.0-trainval", help="(default %(default)s)")
    parser.add_argument("--splits", type=Path, required=True, help="JSON file of scene names, see above")
    parser.add_argument("--out", type=Path, default=Path("data/nuscenes.npz"), help="(default %(default)s)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, cut, write and count."""
    splits = read_splits(args.splits)
    scenes = [scene for scene in read_scenes(args.folder, args.version) if scene.name in splits]
    middles = [middle(scene) for scene in scenes]
    scenes = [around(scene, at) for scene, at in zip(scenes, middles, strict=True)]
    walked = [number for number, scene in enumerate(scenes) if scene.tracks]
    if not walked:
        raise CrowdFileError(f"{args.folder}: no scene of {args.splits} has pedestrians")
    scenes, middles = [scenes[i] for i in walked], [middles[i] for i in walked]
    recordings = [Recording(s.name, s.tracks, [(0.0, end_of(s), splits[s.name])]) for s in scenes]
    radius = round(float(np.concatenate([scene.sizes for scene in scenes]).max(1).mean()) / 2, 3)
    maps = layer_maps(scenes, middles, args.folder)
    crowds = pack_recordings("nuscenes", recordings, radius, {"version": args.version}, maps)
    crowds.save(args.out)
    found = census(crowds, np.arange(len(crowds.split)))
    shares = ", ".join(f"{(crowds.split == i).sum()} {split}" for i, split in enumerate(SPLITS))
    print(f"{args.out}: {shares} scenes, {args.out.stat().st_size / 1e6:.1f} MB")
    print(
        f"  {found.people:.1f} people a scene of {2 * radius:.2f} m, {found.speed:.2f} m/s, "
        f"{found.acceleration:.2f} m/s2, {100 * found.in_people:.1f} % of the time within reach of somebody"
    )
    return 0


def read_splits(path: Path) -> dict[str, Split]:
    """The split of each scene by name.

    Raises:
        CrowdFileError: When the file is missing or not as described above.
    """
    lists = read_json(path)
    if not isinstance(lists, dict) or not set(lists) <= set(SPLITS):
        raise CrowdFileError(
            f"{path}: an object with lists of scene names under {', '.join(SPLITS)} is needed"
        )
    return {name: cast(Split, split) for split, names in lists.items() for name in names}


def middle(scene: DrivingScene) -> np.ndarray:
    """(2,) the middle of all positions of a scene, in whole metres of the map's frame; 0 without anybody."""
    places = [track[:, 1:] for track in scene.tracks]
    return np.round(np.median(np.concatenate(places), 0)) if places else np.zeros(2)


def around(scene: DrivingScene, at: np.ndarray) -> DrivingScene:
    """The scene in a frame at a point (2,), without those who are seen once only or leave the map that is kept.

    Positions in a city do not fit in single precision.
    """
    tracks = [track - [0.0, *at] for track in scene.tracks]
    kept = [i for i, t in enumerate(tracks) if len(t) > 1 and np.abs(t[:, 1:]).max() < SIDE / 2]
    return DrivingScene(scene.name, scene.location, [tracks[i] for i in kept], scene.sizes[kept])


def end_of(scene: DrivingScene) -> float:
    """Time after the last frame of a scene [s]."""
    return max(track[-1, 0] for track in scene.tracks) + 0.1


def layer_maps(scenes: Sequence[DrivingScene], middles: Sequence[np.ndarray], root: Path) -> RecordedMaps:
    """The seven layers around the middle of each scene as distance fields."""
    axis = np.arange(-SIDE / 2, SIDE / 2 + RESOLUTION / 2, RESOLUTION)
    x, y = np.meshgrid(axis, axis)  # row index grows with y
    trees: dict[str, dict[str, shapely.STRtree]] = {}
    fields = np.zeros((len(scenes), len(LAYERS), len(axis), len(axis)), np.float16)
    for field, scene, at in zip(fields, scenes, middles, strict=True):
        if scene.location not in trees:
            layers = read_layers(root, scene.location)
            trees[scene.location] = {name: shapely.STRtree(shapes) for name, shapes in layers.items()}
        window = shapely.box(*(at - SIDE), *(at + SIDE))
        for number, layer in enumerate(LAYERS):
            tree = trees[scene.location][layer]
            here = shapely.union_all(tree.geometries[tree.query(window)])
            shapely.prepare(here)
            mask = shapely.contains_xy(here, x + at[0], y + at[1])
            field[number] = np.clip(signed_distance(mask, RESOLUTION), -FAR, FAR)
    return RecordedMaps(fields, (-SIDE / 2, -SIDE / 2), RESOLUTION, [[] for _ in scenes], LAYERS)
