"""Static polygons as padded convex pieces, with batched distance and velocity-obstacle queries."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .half_plane_lp import dot, perpendicular

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class ObstacleError(ValueError):
    """A polygon cannot serve as an obstacle."""


@dataclass(frozen=True)
class ConvexObstacles:
    """Convex solids of B scenes, padded to P pieces of V vertices; world frame, m.

    Attributes:
        vertices: (B, P, V, 2) counter-clockwise; the last vertex is repeated as padding.
        to_next: (B, P, V, 2) edge from each vertex to the next distinct one.
        to_previous: (B, P, V, 2) edge from each vertex to the previous distinct one.
        normals: (B, P, V, 2) outward unit normal of the edge to the next vertex; zero on padding.
        solid: (B, P) piece has an inside (three vertices or more; two make a wall without thickness).
        valid: (B, P) piece exists.
        center: (B, P, 2) middle of the bounding circle.
        extent: (B, P) radius of the bounding circle.
    """

    vertices: Array
    to_next: Array
    to_previous: Array
    normals: Array
    solid: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    center: Array
    extent: Array

    @classmethod
    def from_polygons(cls, scenes: Sequence[Sequence[ArrayLike]]) -> "ConvexObstacles":
        """Cut the polygons of each scene into convex pieces.

        Args:
            scenes: for each scene its simple polygons, each (V, 2) in either winding; a polygon of two points
                is a wall.

        Raises:
            ObstacleError: a polygon has fewer than two points, no area, a non-finite number, or crosses
            itself.
        """
        pieces = [
            [
                piece
                for k, polygon in enumerate(scene)
                for piece in convex_pieces(polygon, f"scene {b}, polygon {k}")
            ]
            for b, scene in enumerate(scenes)
        ]
        most = max((len(scene) for scene in pieces), default=0)
        corners = max((len(piece) for scene in pieces for piece in scene), default=2)
        vertices, to_next, to_previous = np.zeros((3, len(scenes), most, corners, 2))
        solid, valid = np.zeros((2, len(scenes), most), bool)
        for b, scene in enumerate(pieces):
            for k, piece in enumerate(scene):
                padding = ((0, corners - len(piece)), (0, 0))
                vertices[b, k] = np.pad(piece, padding, mode="edge")
                to_next[b, k] = np.pad(np.roll(piece, -1, axis=0) - piece, padding, mode="edge")
                to_previous[b, k] = np.pad(np.roll(piece, 1, axis=0) - piece, padding, mode="edge")
                solid[b, k], valid[b, k] = len(piece) > 2, True
        repeated = np.zeros(vertices.shape[:3], bool)
        repeated[..., 1:] = (vertices[..., 1:, :] == vertices[..., :-1, :]).all(axis=-1)
        length = np.sqrt(dot(to_next, to_next))
        normals = -perpendicular(to_next) / np.where(length > 0, length, 1.0)[..., None]
        normals[repeated] = 0.0
        center = (vertices.min(axis=2) + vertices.max(axis=2)) / 2
        arm = vertices - center[:, :, None]
        extent = np.sqrt(dot(arm, arm).max(axis=2))
        return cls(vertices, to_next, to_previous, normals, solid, valid, center, extent)

    def pairs_within(self, position: Array, reach: Array) -> tuple[Index, Index, Index]:
        """List (scene, agent, piece) with the piece perhaps within `reach` (B, N) of `position` (B, N, 2)."""
        arm = position[:, :, None] - self.center[:, None]  # (B, N, P, 2)
        limit = reach[:, :, None] + self.extent[:, None]
        scene, agent, piece = np.nonzero((dot(arm, arm) < limit**2) & self.valid[:, None])
        return scene, agent, piece

    def signed_distance(self, position: Array, scene: Index, piece: Index) -> tuple[Array, Array]:
        """Distance of points (Q, 2) to one piece each, negative inside, and the unit vector away from it."""
        q = self.vertices[scene, piece] - position[:, None]  # (Q, V, 2)
        edge, normal = self.to_next[scene, piece], self.normals[scene, piece]
        square = dot(edge, edge)
        t = np.clip(-dot(q, edge) / np.where(square > 0, square, 1.0), 0.0, 1.0)
        foot = q + t[..., None] * edge
        row = np.arange(len(q))
        foot = foot[row, dot(foot, foot).argmin(axis=1)]
        outside = np.sqrt(dot(foot, foot))
        real = dot(normal, normal) > 0.5
        height = np.where(real, -dot(normal, q), -np.inf)  # (Q, V) of the point above each edge line
        face = height.argmax(axis=1)
        highest = height[row, face]
        inside = (self.solid[scene, piece] & (highest <= 0)) | (outside < 1e-9)
        away = -foot / np.maximum(outside, 1e-12)[:, None]
        return (
            np.where(inside, np.minimum(highest, 0.0), outside),
            np.where(inside[:, None], normal[row, face], away),
        )

    def velocity_obstacle(
        self, position: Array, velocity: Array, radius: Array, horizon: Array, scene: Index, piece: Index
    ) -> tuple[Array, Array]:
        """Signed distance of velocities to the velocity obstacle of one piece each.

        The obstacle `{v : t v in piece + disc for some t <= horizon}` is convex, so the signed distance is
        the largest `n . v - h(n)` over its outward unit normals: the edge normals, the direction from one
        vertex, and the normals of the two tangents (the legs) through the origin.

        Args:
            position: (Q, 2) agent centres outside the piece grown by `radius`, m.
            velocity: (Q, 2) m/s.
            radius: (Q,) agent radius, m.
            horizon: (Q,) time horizon, s.
            scene: (Q,) scene index.
            piece: (Q,) piece index within the scene.

        Returns:
            (Q,) signed distance in m/s, negative for a velocity that leads to a collision, and its (Q, 2)
            normal.
        """
        arm = self.vertices[scene, piece] - position[:, None]  # (Q, V, 2)
        normal = self.normals[scene, piece]
        q, r = arm / horizon[:, None, None], (radius / horizon)[:, None]

        support = dot(normal, q) + r  # a normal bounds the obstacle only if the origin lies beyond it
        edge = np.where(
            (dot(normal, normal) > 0.5) & (support <= 0), dot(normal, velocity[:, None]) - support, -np.inf
        )

        w = velocity[:, None] - q
        distance = np.sqrt(dot(w, w))
        out = w / np.maximum(distance, 1e-12)[..., None]
        supporting = (dot(out, self.to_next[scene, piece]) <= 0) & (
            dot(out, self.to_previous[scene, piece]) <= 0
        )
        supporting &= (dot(out, q) + r <= 0) & (distance > 1e-12)
        corner = np.where(supporting, distance - r, -np.inf)

        ahead = self.center[scene, piece] - position
        side = np.arctan2(dot(perpendicular(ahead)[:, None], arm), dot(ahead[:, None], arm))
        opening = np.arcsin(np.minimum(radius[:, None] / np.sqrt(dot(arm, arm)), 1.0))
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])
        left, right = heading + (side + opening).max(axis=1), heading + (side - opening).min(axis=1)
        left_leg = np.stack((-np.sin(left), np.cos(left)), axis=-1)
        right_leg = np.stack((np.sin(right), -np.cos(right)), axis=-1)

        row = np.arange(len(q))
        best_edge, best_corner = edge.argmax(axis=1), corner.argmax(axis=1)
        distances = np.stack(
            (
                edge[row, best_edge],
                corner[row, best_corner],
                dot(left_leg, velocity),
                dot(right_leg, velocity),
            ),
            axis=1,
        )
        normals = np.stack((normal[row, best_edge], out[row, best_corner], left_leg, right_leg), axis=1)
        best = distances.argmax(axis=1)
        return distances[row, best], normals[row, best]


def convex_pieces(polygon: ArrayLike, name: str = "polygon") -> list[Array]:
    """Cut a simple polygon (V, 2) of either winding into counter-clockwise convex pieces.

    Ears are cut off one by one; each joins the piece across its cut when the union stays convex.

    Raises:
        ObstacleError: see `ConvexObstacles.from_polygons`; `name` opens the sentence.
    """
    corners = np.asarray(polygon, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2:
        raise ObstacleError(f"{name} has shape {corners.shape}; two or more points (V, 2) make an obstacle")
    if not np.isfinite(corners).all():
        raise ObstacleError(f"{name} has a coordinate that is not finite")
    corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]
    if len(corners) < 2:
        raise ObstacleError(f"{name} is a single point; two or more distinct points make an obstacle")
    if len(corners) == 2:
        return [corners]
    area = _cross(corners, np.roll(corners, -1, axis=0)).sum() / 2
    if abs(area) < 1e-9:
        raise ObstacleError(f"{name} encloses no area; give a wall as two points")
    if area < 0:
        corners = corners[::-1]
    if _crosses_itself(corners):
        raise ObstacleError(f"{name} crosses itself; a simple polygon is needed")
    if _is_convex(corners):
        return [corners]
    ring, pieces = list(range(len(corners))), []
    while len(ring) > 3:
        ear = next((k for k in range(len(ring)) if _is_ear(corners, ring, k)), None)
        if ear is None:
            raise ObstacleError(f"{name} touches itself; a simple polygon is needed")
        pieces.append([ring[ear - 1], ring[ear], ring[(ear + 1) % len(ring)]])
        del ring[ear]
    pieces.append(ring)
    return [corners[piece] for piece in _merge(corners, pieces)]


def _merge(corners: Array, pieces: list[list[int]]) -> list[list[int]]:
    """Join pieces across shared edges while the union stays convex (Hertel and Mehlhorn 1983)."""
    merged: list[list[int]] = []
    for piece in pieces:
        k = 0
        while k < len(merged):
            joined = _join(merged[k], piece)
            if joined is not None and _is_convex(corners[joined]):
                piece = joined
                del merged[k]
                k = 0
            else:
                k += 1
        merged.append(piece)
    return merged


def _join(a: list[int], b: list[int]) -> list[int] | None:
    """Outline of two pieces that share one edge, or None."""
    for i, start in enumerate(a):
        stop = a[(i + 1) % len(a)]
        if start in b and b[b.index(start) - 1] == stop:
            j = b.index(start)
            return a[i + 1 :] + a[: i + 1] + (b[j:] + b[:j])[1:-1]
    return None


def _crosses_itself(corners: Array) -> bool:
    """Whether two edges cross at a point inside both."""
    edge = np.roll(corners, -1, axis=0) - corners
    side = _cross(edge[:, None], corners - corners[:, None])  # (V, V), [i, j]: corner j beside edge i
    parted = side * np.roll(side, -1, axis=1) < 0  # edge j has its ends on both sides of edge i
    return bool((parted & parted.T).any())


def _is_ear(corners: Array, ring: list[int], k: int) -> bool:
    """Whether cutting off corner k of the ring leaves the rest intact."""
    a, b, c = corners[ring[k - 1]], corners[ring[k]], corners[ring[(k + 1) % len(ring)]]
    if _cross(b - a, c - b) <= 0:
        return False
    others = corners[
        [j for j in ring if (corners[j] != a).any() and (corners[j] != b).any() and (corners[j] != c).any()]
    ]
    inside = (
        (_cross(b - a, others - a) >= 0) & (_cross(c - b, others - b) >= 0) & (_cross(a - c, others - c) >= 0)
    )
    return not inside.any()


def _is_convex(corners: Array) -> bool:
    """Whether a counter-clockwise outline turns left once around and never right."""
    edge = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edge, -1, axis=0)
    turn = np.arctan2(_cross(edge, following), (edge * following).sum(axis=-1))
    return bool((turn >= -1e-9).all() and abs(turn.sum() - 2 * np.pi) < 1e-6)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
