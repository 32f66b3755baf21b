"""Meshes: hulls, dressed people, grounds, obstacles."""

import numpy as np
import pytest
import shapely
from scipy.spatial import ConvexHull

from footfall.messages.map import Obstacle
from footfall.messages.topics import BODIES
from footfall.models.body import describe
from footfall.models.render.convex_hull import convex_hull
from footfall.models.render.ground_paint import BARE, LAYER_COLOURS
from footfall.models.render.ground_paint import paint as paint_layers
from footfall.models.render.looks import dress
from footfall.models.render.street import PLAIN, colour_of_obstacle, crown
from footfall.nodes.viewer_ground import ground_mesh, obstacles_mesh, paint, triangulate
from footfall.nodes.viewer_people import dressed
from footfall.nodes.viewer_picture import heights_at


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("seed", range(5))
def test_hulls_are_those_of_qhull(seed):
    points = np.random.default_rng(seed).standard_normal((80, 3)) * [1, 0.3, 5]
    faces = convex_hull(points)
    assert volume(points, faces) == pytest.approx(ConvexHull(points).volume)  # outwards, else negative
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    assert len(edges) == 3 * len(faces) and all((b, a) in edges for a, b in edges)  # closed


def test_points_in_one_plane_of_a_box_make_no_holes():
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 3), axis=-1).reshape(-1, 3)
    assert volume(grid, convex_hull(grid)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    "points", [np.zeros((3, 3)), np.zeros((5, 3)), np.eye(4, 3)[:, [0, 1, 0]] * [1, 1, 0]]
)
def test_flat_points_have_no_hull(points):
    with pytest.raises(ValueError, match="a hull"):
        convex_hull(points)


def test_everybody_is_dressed_to_their_own_measure(messages):
    bodies = next(item.message for _, item in messages() if item.topic is BODIES)
    parts = dressed(bodies)
    for row, agent in enumerate(bodies.ids.tolist()):
        own = dress(describe(bodies.shapes[row].astype(np.float64)), agent)
        assert [part.body for part in parts] == [piece.body for piece in own]
        for part, piece in zip(parts, own, strict=True):
            assert part.colours[row] == pytest.approx(np.round(255 * np.array(piece.colour)), abs=1)
            low, high = piece.points.min(axis=0), piece.points.max(axis=0)
            stretched = part.vertices * part.scales[row]
            assert stretched.min(axis=0) == pytest.approx(low, abs=0.03)
            assert stretched.max(axis=0) == pytest.approx(high, abs=0.03)


def test_the_ground_has_the_map_s_heights_and_colours(yard):
    for slope in (0.0, 0.2):
        place = yard(slope)
        mesh = ground_mesh(place)
        assert mesh.bounds[:, :2] == pytest.approx(np.array([[-5, -5], [5, 5]]))
        assert (mesh.face_normals[:, 2] > 0.9).all()
        if place.terrain is not None:
            points = np.asarray(mesh.vertices)
            assert points[:, 2] == pytest.approx(heights_at(place.terrain, points[:, :2]), abs=1e-6)
        picture = paint(place, 3, grain=False)
        assert picture.shape == (150, 150, 3)
        assert (picture[:, 75] == LAYER_COLOURS["road"]).all()
        assert (picture[:, :50] == LAYER_COLOURS["walkable"]).all()


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (2, 0), (2, 1), (0, 1)],
        [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)],
        [(np.cos(a), np.sin(a)) for a in np.linspace(0, 6, 15)],
    ],
)
def test_roofs_cover_their_outline(outline):
    outline = np.array(outline, dtype=float)
    triangles = triangulate(outline)
    assert len(triangles) == len(outline) - 2
    pieces = [shapely.Polygon(outline[t]) for t in triangles]
    assert shapely.union_all(pieces).symmetric_difference(shapely.Polygon(outline)).area < 1e-9
    assert sum(p.area for p in pieces) == pytest.approx(shapely.Polygon(outline).area)
    box = Obstacle("box", outline, 2.0)
    vertices, faces = obstacles_mesh([box], [1.0])
    assert vertices[:, 2].max() == 3.0
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    roof = np.abs(normals[:, 2]) > 1e-9
    assert (normals[roof, 2] > 0).all() and roof.sum() == len(outline) - 2
    walls = (a + b + c)[~roof] / 3 + 1e-3 * normals[~roof] / np.linalg.norm(normals[~roof], axis=1)[:, None]
    assert not shapely.contains_xy(shapely.Polygon(outline), walls[:, 0], walls[:, 1]).any()  # face outwards


def test_painted_edges_are_smooth_and_stay_where_they_were():
    y, x = np.mgrid[:40, :40] + 0.5
    disk = np.hypot(x - 20, y - 20) < 12
    picture = paint_layers({"walkable": np.ones((40, 40)), "road": disk}, 0.1, 6, grain=False)
    fine_y, fine_x = (np.mgrid[:240, :240] + 0.5) / 6
    low, high = (np.array(LAYER_COLOURS[name], float).sum() for name in ("road", "walkable"))
    cover = (high - picture.sum(axis=2)) / (high - low)
    away = np.hypot(fine_x - 20, fine_y - 20)
    assert cover.sum() / 36 == pytest.approx(np.pi * 12**2, rel=0.02)
    assert cover[away < 11.2].min() > 0.99 and cover[away > 12.8].max() < 0.01
    nearest = disk.repeat(6, 0).repeat(6, 1)
    true = np.clip((12 - away) * 6 + 0.5, 0, 1)
    assert np.abs(cover - true).mean() < 0.6 * np.abs(nearest - true).mean()  # than the cells' steps


def test_grain_keeps_the_mean_colour_and_unknown_layers_are_left_out():
    layers = {"road": np.ones((60, 60))}
    picture = paint_layers(layers, 0.1, 4)
    assert picture.reshape(-1, 3).mean(axis=0) == pytest.approx(LAYER_COLOURS["road"], abs=4)
    assert picture.std() > 1
    assert (paint_layers({"lava": np.ones((3, 4))}, 0.1, 2) == BARE).all()


def test_obstacles_look_like_what_they_are_called():
    assert colour_of_obstacle("thing 7") == PLAIN
    assert colour_of_obstacle("bus shelter") != colour_of_obstacle("bus")
    assert colour_of_obstacle("parked car", 0) != colour_of_obstacle("parked car", 1)
    assert colour_of_obstacle("Hedge") == colour_of_obstacle("low hedge")
    outline = np.array([[2.0, 3.0], [3.0, 3.0], [3.0, 4.0], [2.0, 4.0]])
    assert crown("street", outline, 4.0) is None
    found = crown("tree", outline, 4.0)
    assert found is not None
    points, _ = found
    assert points[:, :2].mean(axis=0) == pytest.approx([2.5, 3.5], abs=0.15)
    assert points[:, 2].min() > 1.9 and points[:, 2].max() > 4.0
    assert volume(points, convex_hull(points)) > 5.0
