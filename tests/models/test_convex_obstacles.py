"""Convex pieces, distances and velocity obstacles against shapely."""

import numpy as np
import pytest
import shapely

from footfall.models.crowd.convex_obstacles import ConvexObstacles, ObstacleError, convex_pieces

RADIUS = 0.4


def star(rng: np.random.Generator, corners: int) -> np.ndarray:
    """A simple polygon, usually not convex."""
    angle = (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) * 2 * np.pi / corners
    return rng.uniform(0.5, 3.0, (corners, 1)) * np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def convex(rng: np.random.Generator, corners: int) -> np.ndarray:
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    return np.stack((2 * np.cos(angle), np.sin(angle)), axis=-1)


@pytest.mark.parametrize("corners", [4, 6, 9, 20])
@pytest.mark.parametrize("winding", [1, -1])
def test_pieces_are_convex_and_make_up_the_polygon(corners: int, winding: int):
    rng = np.random.default_rng(corners)
    for _ in range(20):
        polygon = star(rng, corners)
        pieces = [shapely.Polygon(piece) for piece in convex_pieces(polygon[::winding])]
        whole = shapely.Polygon(polygon)
        assert len(pieces) <= corners - 2
        assert all(piece.exterior.is_ccw for piece in pieces)
        assert all(piece.convex_hull.area == pytest.approx(piece.area, rel=1e-6) for piece in pieces)
        assert sum(piece.area for piece in pieces) == pytest.approx(whole.area)
        assert shapely.union_all(pieces).symmetric_difference(whole).area < 1e-9


@pytest.mark.parametrize(
    "polygon",
    [
        [
            [0, 0],
            [7, 0],
            [7, 2],
            [6, 2],
            [6, 1],
            [4, 1],
            [4, 2],
            [3, 2],
            [3, 1],
            [1, 1],
            [1, 2],
            [0, 2],
        ],  # comb
        [[0, 0], [1, 0], [1, 1], [2, 1], [2, 2], [3, 2], [3, 3], [0, 3], [0, 2], [0, 1]],  # stairs
        [[0, 0], [1, 0], [2, 0], [3, 0], [3, 3], [0, 3], [0, 2], [2, 2], [2, 1], [1, 1], [0, 1]],  # C
    ],
)
def test_aligned_corners_do_no_harm(polygon: list):
    pieces = [shapely.Polygon(piece) for piece in convex_pieces(polygon)]
    assert all(piece.area > 0.1 for piece in pieces)
    assert shapely.union_all(pieces).symmetric_difference(shapely.Polygon(polygon)).area < 1e-9
    assert sum(piece.area for piece in pieces) == pytest.approx(shapely.Polygon(polygon).area)


def test_a_convex_polygon_stays_whole_and_an_l_needs_two_pieces():
    assert len(convex_pieces([[0, 0], [2, 0], [2, 1], [0, 1]])) == 1
    assert len(convex_pieces([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]])) == 2


@pytest.mark.parametrize(
    ("polygon", "sentence"),
    [
        ([[0, 0]], "two or more points"),
        ([[1, 1], [1, 1]], "single point"),
        ([[0, 0], [1, 1], [2, 2]], "no area"),
        ([[0, 0], [1, np.inf], [2, 0]], "not finite"),
        ([[0, 0], [4, 4], [4, 0], [0, 3]], "crosses itself"),
        ([[0, 3], [2, -3], [-3, 1], [3, 1], [-2, -3]], "crosses itself"),
    ],
)
def test_bad_polygons_are_named(polygon: list, sentence: str):
    with pytest.raises(ObstacleError, match=f"scene 0, polygon 1.*{sentence}"):
        ConvexObstacles.from_polygons([[[[0, 0], [1, 0], [0, 1]], polygon]])


def everything_against_everything(seed: int, wall: bool) -> tuple:
    rng = np.random.default_rng(seed)
    polygons = [convex(rng, k) for k in range(4, 10)]
    if wall:
        polygons.append(np.array([[-1.0, 0.5], [1.0, -0.5]]))
    obstacles = ConvexObstacles.from_polygons([polygons])
    shapes = [shapely.LineString(p) if len(p) == 2 else shapely.Polygon(p) for p in polygons]
    points = rng.uniform(-4, 4, (150, 2))
    piece = np.arange(len(points)) % len(polygons)
    return obstacles, shapes, points, piece, np.zeros_like(piece)


def test_signed_distance_agrees_with_shapely():
    obstacles, shapes, points, piece, scene = everything_against_everything(0, wall=True)
    distance, away = obstacles.signed_distance(points, scene, piece)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0)
    for point, k, found, normal in zip(points, piece, distance, away, strict=True):
        shape, here = shapes[k], shapely.Point(point)
        inside = shape.contains(here)
        expected = -shape.exterior.distance(here) if inside else shape.distance(here)
        assert found == pytest.approx(expected, abs=1e-9)
        edge = shapely.Point(point - found * normal)
        assert shape.distance(edge) < 1e-9


def test_velocity_obstacle_agrees_with_a_swept_polygon():
    obstacles, shapes, points, piece, scene = everything_against_everything(1, wall=True)
    gap = obstacles.signed_distance(points, scene, piece)[0] - RADIUS
    far = gap > 0.01
    points, piece, scene = points[far], piece[far], scene[far]
    rng = np.random.default_rng(2)
    velocity, horizon = rng.uniform(-2, 2, points.shape), rng.uniform(1, 5, len(points))
    signed, normal = obstacles.velocity_obstacle(
        points, velocity, np.full(len(points), RADIUS), horizon, scene, piece
    )
    assert (signed < 0).sum() > 15 and (signed > 0).sum() > 15
    for q in range(len(points)):
        shape = shapely.affinity.translate(shapes[piece[q]], *-points[q]).buffer(RADIUS, quad_segs=256)
        near = shapely.affinity.scale(shape, 1 / horizon[q], 1 / horizon[q], origin=(0, 0))
        cone = near.union(shapely.affinity.scale(near, 100, 100, origin=(0, 0))).convex_hull
        tip = shapely.Point(velocity[q])
        expected = cone.exterior.distance(tip) * (-1 if cone.contains(tip) else 1)
        assert signed[q] == pytest.approx(expected, abs=1e-3)
        assert cone.exterior.distance(shapely.Point(velocity[q] - signed[q] * normal[q])) < 1e-3


def test_a_triangle_padded_next_to_an_octagon_keeps_its_answers():
    rng = np.random.default_rng(5)
    triangle, octagon = convex(rng, 3), convex(rng, 8)
    alone = ConvexObstacles.from_polygons([[triangle]])
    padded = ConvexObstacles.from_polygons([[triangle, octagon]])
    points, velocity = rng.uniform(4, 6, (50, 2)), rng.uniform(-2, 2, (50, 2))
    zero = np.zeros(50, int)
    radius, horizon = np.full(50, RADIUS), np.full(50, 3.0)
    for a, b in zip(
        alone.velocity_obstacle(points, velocity, radius, horizon, zero, zero)
        + alone.signed_distance(points, zero, zero),
        padded.velocity_obstacle(points, velocity, radius, horizon, zero, zero)
        + padded.signed_distance(points, zero, zero),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, atol=1e-12)
