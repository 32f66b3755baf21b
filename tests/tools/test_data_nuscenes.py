"""The importer on a scene in nuScenes' own tables, made by hand: a street, a sidewalk and a crossing."""

import json

import numpy as np
import pytest
import shapely
import torch

from footfall.models.trace.config import COMPACT
from footfall.models.trace.crowd_file import CrowdFileError, Crowds
from footfall.models.trace.windows import CrowdWindows
from footfall.tools import cli
from footfall.tools.nuscenes_source import LAYERS, read_layers, read_scenes

CORNER = np.array([1500.0, 900.0])  # of the city's map
POLYGONS = {  # x0, y0, x1, y1 from the corner
    "drivable_area": (0, 0, 60, 8),
    "road_segment": (0, 0, 60, 8),
    "lane": (0, 0, 60, 4),
    "ped_crossing": (28, 0, 32, 8),
    "walkway": (0, 8, 60, 12),
}
LINES = {"road_divider": ((0, 4), (60, 4)), "lane_divider": ((0, 2), (60, 2))}
KINDS = {"walker": "human.pedestrian.adult", "crosser": "human.pedestrian.child", "car": "vehicle.car"}


def place(name, t):
    """One walks along the sidewalk at 1.2 m/s, one over the crossing at 0.8 m/s, a car drives."""
    at = {"walker": (20 + 1.2 * t, 10.0), "crosser": (30.0, -4 + 0.8 * t), "car": (3 * t, 2.0)}[name]
    return [*(CORNER + at), 0.9]


def tables():
    samples = [f"sample{i}" for i in range(40)]
    stamps = {sample: 1_532_402_927_000_000 + 500_000 * i for i, sample in enumerate(samples)}
    boxes = [
        {
            "token": f"{name} {sample}",
            "sample_token": sample,
            "instance_token": name,
            "translation": place(name, 0.5 * i),
            "size": [0.6, 0.8, 1.7],  # width, length, height
            "rotation": [1, 0, 0, 0],
        }
        for name in KINDS
        for i, sample in enumerate(samples)
    ]
    return {
        "scene": [{"token": "s", "name": "scene-0001", "log_token": "l", "nbr_samples": 40}],
        "log": [{"token": "l", "location": "little-town"}],
        "sample": [{"token": s, "timestamp": stamps[s], "scene_token": "s"} for s in reversed(samples)],
        "category": [{"token": kind, "name": kind} for kind in set(KINDS.values())],
        "instance": [{"token": name, "category_token": kind} for name, kind in KINDS.items()],
        "sample_annotation": boxes,
    }


def expansion():
    nodes, polygons, lines, layers = [], [], [], {layer: [] for layer in LAYERS}

    def node(x, y):
        nodes.append({"token": f"n{len(nodes)}", "x": CORNER[0] + x, "y": CORNER[1] + y})
        return nodes[-1]["token"]

    for layer, (x0, y0, x1, y1) in POLYGONS.items():
        ring = [node(x0, y0), node(x1, y0), node(x1, y1), node(x0, y1)]
        hole = [node(40, 9), node(44, 9), node(44, 11), node(40, 11)]  # a flower bed on the sidewalk
        holes = [{"node_tokens": hole}] if layer == "walkway" else []
        polygons.append({"token": f"p {layer}", "exterior_node_tokens": ring, "holes": holes})
        many = (
            {"polygon_tokens": [f"p {layer}"]}
            if layer == "drivable_area"
            else {"polygon_token": f"p {layer}"}
        )
        layers[layer].append({"token": layer, **many})
    for layer, ends in LINES.items():
        lines.append({"token": f"l {layer}", "node_tokens": [node(*end) for end in ends]})
        layers[layer].append({"token": layer, "line_token": f"l {layer}"})
    return {"node": nodes, "polygon": polygons, "line": lines, **layers}


def write(root, changes=()):
    (root / "v1.0-mini").mkdir(parents=True)
    (root / "maps" / "expansion").mkdir(parents=True)
    for name, rows in {**tables(), **dict(changes)}.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows))
    (root / "maps" / "expansion" / "little-town.json").write_text(json.dumps(expansion()))
    (root / "splits.json").write_text(json.dumps({"train": ["scene-0001"], "test": ["scene-0002"]}))
    return root


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return write(tmp_path_factory.mktemp("nuscenes"))


def run(root, out):
    splits = str(root / "splits.json")
    return cli.main(
        ["data", "nuscenes", str(root), "--version", "v1.0-mini", "--splits", splits, "--out", str(out)]
    )


@pytest.fixture(scope="module")
def crowds(root):
    assert run(root, root / "out.npz") == 0
    return Crowds.load(root / "out.npz")


def test_pedestrians_are_read_and_cars_are_not(root):
    (scene,) = read_scenes(root, "v1.0-mini")
    assert (scene.name, scene.location, len(scene.tracks)) == ("scene-0001", "little-town", 2)
    assert np.allclose(scene.sizes, [0.8, 0.6])
    walker = scene.tracks[0]
    assert np.allclose(walker[:, 0], 0.5 * np.arange(40))
    assert np.allclose(walker[:, 1:], CORNER + np.column_stack([20 + 1.2 * walker[:, 0], np.full(40, 10.0)]))


def test_the_scene_is_resampled_around_its_middle(crowds, root):
    assert crowds.positions.shape[:2] == (1, 2) and crowds.radius == 0.4 and crowds.layers == LAYERS
    step = np.diff(crowds.positions[0, :, :196], axis=1)
    assert np.allclose(np.linalg.norm(step, axis=-1), [[0.12], [0.08]], atol=1e-4)
    assert np.abs(crowds.positions[np.isfinite(crowds.positions)]).max() < 50


def the_map(crowds):
    maps = CrowdWindows(crowds, "train", COMPACT).maps(torch.tensor([0]))
    assert maps is not None
    return maps


def test_all_seven_layers_are_where_they_were(crowds):
    maps = the_map(crowds)
    walker = crowds.positions[0, 0, 0]
    shift = walker - (20.0, 10.0)  # of the frame against the corner

    def inside(x, y):
        point = torch.tensor([[[x + shift[0], y + shift[1]]]], dtype=torch.float32)
        values = maps.sample(point, torch.tensor([0]))[0, 0]
        return {layer for layer, value in zip(maps.layers, values, strict=True) if value < 0}

    street = {"drivable_area", "road_segment"}
    assert inside(20.0, 1.0) == street | {"lane"}
    assert inside(20.0, 6.0) == street
    assert inside(30.0, 6.0) == street | {"ped_crossing"}
    assert inside(20.0, 10.0) == {"walkway"}
    assert inside(42.0, 10.0) == set()  # the hole
    assert inside(20.0, 14.0) == set()


def test_dividers_are_strips(root):
    layers = read_layers(root, "little-town")
    (divider,) = layers["road_divider"]
    assert shapely.area(divider) == pytest.approx(60 * 0.3, rel=0.01)
    low, high = np.add(CORNER, [-0.15, 3.85]), np.add(CORNER, [60.15, 4.15])
    assert shapely.bounds(divider) == pytest.approx([*low, *high])


def test_distances_of_a_layer_are_metres(crowds):
    maps = the_map(crowds).layer("walkway")
    walker = torch.from_numpy(crowds.positions[0, 0, :1])[None]  # in the middle of a strip of 4 m
    assert float(maps.sample(walker, torch.tensor([0]))) == pytest.approx(-2.0, abs=0.5)


def test_windows_and_mirror_images_come_with_their_maps(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT, mirror=True)
    context, actions = windows.batch(torch.tensor([0, len(windows) - 1]))
    assert actions.shape == (2, 52, 2) and context.maps is not None
    there = torch.from_numpy(crowds.positions[0, 0, 30])
    mirrored = there * torch.tensor([1.0, -1.0])
    maps = windows.maps(torch.tensor([0, 1]))
    assert maps is not None
    both = maps.sample(torch.stack([there, mirrored])[:, None], torch.tensor([0, 1]))
    assert torch.allclose(both[0], both[1])


def test_what_is_wrong_is_named(root, tmp_path, capsys):
    with pytest.raises(CrowdFileError, match=r"scene.json: no such file"):
        read_scenes(root, "v1.0-trainval")
    with pytest.raises(CrowdFileError, match=r"mars.json: no such file"):
        read_layers(root, "mars")
    broken = write(tmp_path / "a", [("log", [{"token": "other", "location": "little-town"}])])
    with pytest.raises(CrowdFileError, match="'l', which no table holds"):
        read_scenes(broken, "v1.0-mini")
    lacking = write(tmp_path / "b", [("instance", [{"token": "walker"}])])
    with pytest.raises(CrowdFileError, match=r"instance.json: row 0 has no 'category_token'"):
        read_scenes(lacking, "v1.0-mini")
    (root / "splits.json").write_text('{"dev": []}')
    assert run(root, tmp_path / "out.npz") == 2
    assert "under train, val, test is needed" in capsys.readouterr().err
    (root / "splits.json").write_text('{"train": ["scene-0009"]}')
    assert run(root, tmp_path / "out.npz") == 2
    assert "no scene of" in capsys.readouterr().err
