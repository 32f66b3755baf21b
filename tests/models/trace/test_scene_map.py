import numpy as np
import pytest
import torch
from shapely.geometry import Point, Polygon
from shapely.ops import unary_union

from footfall.models.trace.context import from_frame
from footfall.models.trace.scene_map import SceneMaps, polygon_distance, signed_distance

SQUARE = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], np.float32)
TRIANGLE = np.array([[3, 3], [5, 3.5], [4, 5]], np.float32)


def disc_map(resolution=0.1):
    axis = np.arange(-4, 4, resolution)
    x, y = np.meshgrid(axis, axis)
    return SceneMaps.from_raster({"obstacle": x**2 + y**2 < 1}, resolution, (-4, -4))


def test_polygon_distance_equals_shapely():
    points = np.random.default_rng(0).uniform(-2, 7, (400, 2)).astype(np.float32)
    union = unary_union([Polygon(SQUARE), Polygon(TRIANGLE)])
    expected = []
    for x, y in points:
        point = Point(x, y)
        sign = -1 if union.contains(point) else 1
        expected.append(sign * union.boundary.distance(point))
    assert np.allclose(polygon_distance(points, [SQUARE, TRIANGLE[::-1]]), expected, atol=1e-5)


def test_raster_distance_is_that_of_the_disc():
    maps = disc_map()
    points = torch.rand(1, 300, 2) * 6 - 3
    expected = points[0].norm(dim=1) - 1
    assert torch.allclose(maps.sample(points, torch.tensor([0]))[0, :, 0], expected, atol=0.09)


def test_gradient_points_away_from_the_obstacle():
    points = torch.tensor([[[2.0, 0.03], [0.02, -1.7]]], requires_grad=True)
    disc_map().sample(points, torch.tensor([0])).sum().backward()
    assert points.grad is not None
    assert torch.allclose(points.grad[0], torch.tensor([[1.0, 0.0], [0.0, -1.0]]), atol=0.1)


def test_slopes_are_those_of_the_distance_and_end_where_the_map_ends():
    maps, scene = disc_map(), torch.tensor([0])
    points = torch.rand(1, 300, 2) * 6 - 3
    distance, slopes = (x[0, :, 0] for x in maps.sample_slopes(points, scene))
    assert torch.equal(distance, maps.sample(points, scene)[0, :, 0])
    radius = points[0].norm(dim=1, keepdim=True)
    assert (slopes - points[0] / radius).norm(dim=1)[radius[:, 0] > 0.5].mean() < 0.1
    assert maps.sample_slopes(torch.tensor([[[9.0, 0.0]]]), scene)[1].abs().max() == 0
    one_row = SceneMaps.from_raster({"obstacle": np.array([[True, False, False]])}, 0.1)
    assert one_row.sample_slopes(torch.zeros(1, 1, 2), scene)[1].abs().max() == 0


def test_scenes_do_not_mix():
    maps = SceneMaps(
        torch.tensor([1.0, 2.0, 3.0])[:, None, None, None].expand(3, 1, 4, 5).contiguous(),
        torch.zeros(3, 2),
        0.5,
    )
    points = torch.rand(3, 50, 2) * 6 - 2  # beyond the border too
    values = maps.sample(points, torch.tensor([2, 0, 1]))
    assert torch.allclose(values[..., 0], torch.tensor([[3.0], [1.0], [2.0]]).expand(3, 50))


def test_rows_grow_with_y_and_origin_is_the_first_cell():
    field = torch.arange(12.0).reshape(1, 1, 3, 4)
    maps = SceneMaps(field, torch.tensor([[10.0, 20.0]]), 0.5)
    points = torch.tensor([[[10.0, 20.0], [10.5, 20.0], [10.0, 20.5], [11.25, 21.0]]])
    assert maps.sample(points, torch.tensor([0]))[0, :, 0].tolist() == pytest.approx([0, 1, 4, 10.5])


def test_layers_are_selected_and_walkable_is_implied():
    maps = disc_map()
    both = maps.select(("walkable", "obstacle"))
    assert both.layers == ("walkable", "obstacle")
    assert torch.equal(both.distance[:, 0], -both.distance[:, 1])
    with pytest.raises(ValueError, match="no layer 'road'"):
        maps.layer("road")
    with pytest.raises(ValueError, match="1 layers"):
        SceneMaps(torch.zeros(1, 2, 3, 3), torch.zeros(1, 2), 0.1)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"resolution": 0.0}, "resolution of a map must be above 0"),
        ({"resolution": float("nan")}, "resolution of a map must be above 0"),
        ({"origin": (5.0,)}, "origin of a map must be two"),
        ({"origin": (float("nan"), 0.0)}, "origin of a map must be two"),
        ({"layers": {}}, "must be grids"),
        ({"layers": {"obstacle": np.zeros(5)}}, "layers obstacle must be grids"),
        ({"layers": {"obstacle": np.zeros((0, 5))}}, "layers obstacle must be grids"),
    ],
)
def test_what_is_no_map_is_refused(changed, text):
    whole = {"layers": {"obstacle": np.zeros((4, 5), bool)}, "resolution": 0.1, "origin": (0.0, 0.0)}
    with pytest.raises(ValueError, match=text):
        SceneMaps.from_raster(**whole | changed)


@pytest.mark.parametrize(("filled", "sign"), [(False, 1), (True, -1)])
def test_uniform_masks_are_far_from_any_border(filled, sign):
    distance = signed_distance(np.full((4, 3), filled), 0.5)
    assert np.all(sign * distance >= 2.5)


def test_a_view_reads_what_sampling_at_world_points_reads():
    generator = torch.Generator().manual_seed(0)
    distance = torch.randn((3, 2, 12, 9), generator=generator)
    maps = SceneMaps(distance, torch.tensor([[0.0, 0.0], [-3.0, 2.0], [5.0, 1.0]]), 0.5, ("a", "b"))
    pose = 4 * torch.randn((7, 3), generator=generator)
    scene = torch.randint(3, (7,), generator=generator)
    positions, star = torch.randn((7, 5, 2), generator=generator), torch.randn((4, 2), generator=generator)
    points = (positions[:, :, None] + star).flatten(1, 2)
    expected = maps.sample(from_frame(points, pose), scene)
    assert torch.allclose(maps.view(pose, scene).around(positions, star), expected, atol=1e-4)
    alone = SceneMaps(distance[:1], maps.origin[:1], 0.5, maps.layers)
    first = torch.zeros_like(scene)
    expected = alone.sample(from_frame(points, pose), first)
    assert torch.allclose(alone.view(pose, first).around(positions, star), expected, atol=1e-4)
