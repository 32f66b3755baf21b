from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy import ndimage

from footfall.models.scene import RandomPopulation, Scene, load_scene
from footfall.models.scene.scene import SHIPPED
from footfall.tools.make_scenes import MAKERS, main
from footfall.tools.scene_shapes import bus_shelter, car, covered, disc, outline, rect, solid, turned_box

BODY = 0.3  # m, radius of a broad pedestrian


@pytest.fixture(scope="module", params=sorted(MAKERS))
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param)


def test_the_committed_scenes_are_what_the_generator_writes(tmp_path: Path) -> None:
    assert main([str(tmp_path)]) == 0
    for name in MAKERS:
        made, shipped = load_scene(tmp_path / name), load_scene(name)
        assert made.layers.keys() == shipped.layers.keys()
        for layer in made.layers:
            np.testing.assert_array_equal(made.layers[layer], shipped.layers[layer])
        if made.terrain:
            assert shipped.terrain
            np.testing.assert_array_equal(made.terrain.heights, shipped.terrain.heights)
        text = (tmp_path / name / "scene.yaml").read_bytes()
        assert text == (SHIPPED / name / "scene.yaml").read_bytes()


def test_every_goal_can_be_reached_by_a_broad_pedestrian(scene: Scene) -> None:
    reach = round(BODY / scene.resolution)
    y, x = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    free = np.logical_not(ndimage.binary_dilation(scene.blocked(), x**2 + y**2 <= reach**2))
    region = regions(free)[0]
    assert isinstance(scene.population, RandomPopulation)
    for flow in scene.population.flows:
        spawn, goal = (
            set(np.unique(region[covered(shapely.Polygon(scene.areas[name]), *frame(scene)) & free]))
            for name in (flow.spawn, flow.goal)
        )
        assert spawn and spawn == goal and len(spawn) == 1, f"{flow.spawn} -> {flow.goal}"


def regions(cells: np.ndarray) -> tuple[np.ndarray, int]:
    found = ndimage.label(cells)
    assert isinstance(found, tuple)
    return np.asarray(found[0]), int(found[1])


def frame(scene: Scene) -> tuple[tuple[int, int], float, tuple[float, float]]:
    return scene.shape, scene.resolution, scene.origin


def test_obstacles_stand_apart_on_the_map(scene: Scene) -> None:
    solids = [shapely.Polygon(obstacle.polygon) for obstacle in scene.obstacles]
    bounds = shapely.box(*scene.bounds).buffer(1e-6)
    for index, obstacle in enumerate(solids):
        assert bounds.contains(obstacle)
        for other, name in zip(solids[:index], scene.obstacles, strict=False):
            assert obstacle.intersection(other).area < 0.05, (scene.obstacles[index].name, name.name)


@pytest.mark.parametrize(
    ("name", "size", "people"),
    [
        ("crossing", (40, 40), 20),
        ("plaza", (30, 30), 25),
        ("corridor", (24, 7), 30),
        ("slopes", (34, 24), 20),
    ],
)
def test_sizes(name: str, size: tuple[float, float], people: int) -> None:
    scene = load_scene(name)
    low_x, low_y, high_x, high_y = scene.bounds
    assert (high_x - low_x, high_y - low_y) == pytest.approx(size)
    assert len(scene.sample_population(0)) == people
    assert 3 < len(scene.obstacles) < 80


@pytest.mark.parametrize("seed", range(5))
def test_the_corridor_has_two_streams_of_fifteen(seed: int) -> None:
    entries = load_scene("corridor").sample_population(seed)
    assert sum(entry.velocity[0] > 0 for entry in entries) == 15


def test_crosswalks_join_the_pavements_over_the_roads() -> None:
    layers = load_scene("crossing").layers
    assert not (layers["pavement"] & layers["road"]).any()
    assert (layers["road"] | ~layers["crosswalk"]).all()
    crosswalks, number = regions(layers["crosswalk"])
    assert number == 4
    sides = regions(layers["pavement"])[0]
    for index in range(1, number + 1):
        around = np.asarray(ndimage.binary_dilation(crosswalks == index, iterations=2), dtype=bool)
        assert len(set(np.unique(sides[around])) - {0}) == 2  # each joins two pavements


@pytest.mark.parametrize(
    ("y", "step", "count"),
    [(-2.4, 0.16, 9), (1.5, 0.12, 12), (5.4, 0.09, 16)],
    ids=["steep", "middle", "shallow"],
)
def test_stairs_have_their_steps(y: float, step: float, count: int) -> None:
    scene = load_scene("slopes")
    assert scene.terrain
    x = np.linspace(-6.0, 0.0, 121)
    profile = scene.terrain.height_at(np.column_stack([x, np.full_like(x, y)]))
    np.testing.assert_array_equal(np.unique(np.round(profile / step, 2)), np.arange(1, count + 1))
    assert profile.max() == pytest.approx(1.44, abs=0.001)
    assert (np.diff(profile) >= -1e-9).all()
    assert 0.05 + 0.175 * 0.2 <= step <= 0.05 + 0.175 * 0.8  # the paper's step heights for levels 0.2 to 0.8


@pytest.mark.parametrize(("y", "slope"), [(-5.6, 0.28), (9.5, 1.44 / 14)], ids=["steep", "gentle"])
def test_ramps_have_their_slopes(y: float, slope: float) -> None:
    scene = load_scene("slopes")
    rise = scene.height_at(np.array([-2.0, y])) - scene.height_at(np.array([-4.0, y]))
    assert rise == pytest.approx(2.0 * slope, abs=0.003)


def test_the_meadow_is_rough_by_ten_centimetres() -> None:
    scene = load_scene("slopes")
    x, y = np.meshgrid(np.arange(-4, 7, 0.1), np.arange(-11, -8, 0.1))
    bumps = scene.height_at(np.stack([x, y], axis=-1)) - (x + 6.0) * 1.44 / 14
    assert 0.05 < np.abs(bumps).max() <= 0.102
    assert 0.02 < bumps.std() < 0.08


def test_shapes() -> None:
    assert rect(0, 0, 2, 1).area == 2.0
    assert disc(1, 1, 1.0, 64).area == pytest.approx(np.pi, rel=0.01)
    assert turned_box(3, 4, 2, 1, 90).bounds == pytest.approx((2.5, 3.0, 3.5, 5.0))
    assert shapely.LinearRing(outline(rect(0, 0, 2, 1).reverse())).is_ccw
    with pytest.raises(ValueError, match="one polygon without holes"):
        outline(rect(0, 0, 4, 4).difference(rect(1, 1, 2, 2)))
    south_facing = shapely.Polygon(bus_shelter(0, 0, 270).polygon)
    assert not south_facing.contains(shapely.Point(0, -0.7)) and south_facing.contains(shapely.Point(0, 0.71))
    assert np.ptp(car(0, 0, 90).polygon, axis=0) == pytest.approx((1.8, 4.3))
    assert solid("x", rect(0, 0, 1, 1), 3.0).height == 3.0
    ring = rect(0, 0, 4, 4).difference(rect(1, 1, 3, 3))
    assert covered(ring, (4, 4), 1.0, (0.0, 0.0)).sum() == 12
