"""The half-planes of ORCA: one a neighbour, one a static obstacle, for all agents of a batch of crowds.

van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (2011), sections 4 and 5.4. Agents
of all scenes are flattened to M = B N rows; lists are padded with constraints that always hold.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .convex_obstacles import ConvexObstacles
from .half_plane_lp import Array, dot, perpendicular

SEPARATION_TIME = 0.25  # s in which an initial overlap shrinks to 1/e
MAX_OBSTACLES = 16  # nearest obstacle pieces that constrain an agent's velocity


class AgentArrays(NamedTuple):
    """Parameters of every agent, each (B, N); see `models.orca.OrcaParams`."""

    radius: Array
    max_speed: Array
    neighbor_dist: Array
    max_neighbors: Array
    time_horizon: Array
    time_horizon_obst: Array


class Neighbors(NamedTuple):
    """Half-planes of the K nearest agents of each of M agents, and what the safety step needs of them."""

    normal: Array  # (M, K, 2)
    offset: Array  # (M, K)
    other: NDArray[np.intp]  # (M, S) flat index of the neighbour
    towards: Array  # (M, S, 2) relative position
    distance: Array  # (M, S)
    reach: Array  # (M, S) sum of radii
    away: Array  # (M, S, 2) unit vector
    near: NDArray[np.bool_]  # (M, S) could touch within dt

    @classmethod
    def find(
        cls, position: Array, velocity: Array, agents: AgentArrays, present: NDArray[np.bool_], dt: float
    ) -> "Neighbors":
        """Sort neighbours by free gap and build their half-planes (section 4.1 and 4.2)."""
        scenes, count = position.shape[:2]
        towards = position[:, None] - position[:, :, None]  # (B, N, N, 2), [b, i, j] from i to j
        distance = np.sqrt(dot(towards, towards))
        reach = agents.radius[:, :, None] + agents.radius[:, None]
        pair = present[:, :, None] & present[:, None] & ~np.eye(count, dtype=bool)
        gap = np.where(pair, distance - reach, np.inf)
        near = gap < dt * (agents.max_speed[:, :, None] + agents.max_speed[:, None])
        kept = int(max(near.sum(axis=2).max(), min(agents.max_neighbors.max(), count - 1)))
        order = np.argsort(gap, axis=2, kind="stable")[..., :kept]  # (B, N, K)

        rows = np.arange(scenes * count)[:, None]
        order = order.reshape(scenes * count, kept)
        flat = rows // count * count + order
        towards = towards.reshape(-1, count, 2)[rows, order]
        distance, reach, gap = (a.reshape(-1, count)[rows, order] for a in (distance, reach, gap))
        near = near.reshape(-1, count)[rows, order]
        away = -towards / np.maximum(distance, 1e-9)[..., None]
        coincident = np.nonzero(distance < 1e-9)
        if coincident[0].size:
            away[coincident] = _parting(coincident[0], flat[coincident])
        counts = (np.arange(kept) < agents.max_neighbors.reshape(-1, 1)) & np.isfinite(gap)
        counts &= distance < agents.neighbor_dist.reshape(-1, 1)

        own = velocity.reshape(-1, 2)
        relative = own[:, None] - own[flat]
        signed, normal = _disc_velocity_obstacle(
            towards, distance, reach, relative, agents.time_horizon.reshape(-1, 1), away
        )
        offset = dot(normal, own[:, None]) - signed / 2  # each takes half of the change
        normal = np.where(counts[..., None], normal, 0.0)
        offset = np.where(counts, offset, -1.0)
        close = int(near.sum(axis=1).max())
        return cls(
            normal,
            offset,
            flat[:, :close],
            towards[:, :close],
            distance[:, :close],
            reach[:, :close],
            away[:, :close],
            near[:, :close],
        )


def _disc_velocity_obstacle(
    towards: Array, distance: Array, reach: Array, relative: Array, horizon: Array, away: Array
) -> tuple[Array, Array]:
    """Signed distance and outward normal of relative velocities (M, K, 2) to the truncated cone of a disc.

    The largest of three supporting half-planes, as in `ConvexObstacles.velocity_obstacle`. Discs that overlap
    must part so that the overlap decays with `SEPARATION_TIME`.
    """
    center, radius = towards / horizon[..., None], reach / horizon
    w = relative - center
    length = np.sqrt(dot(w, w))
    out = w / np.maximum(length, 1e-12)[..., None]
    front = dot(out, center) + radius <= 0
    sine = np.minimum(reach / np.maximum(distance, 1e-9), 1.0)[..., None]
    cosine = np.sqrt(1.0 - sine**2)
    side = perpendicular(away)
    left, right = away * sine - side * cosine, away * sine + side * cosine
    signed, normal = dot(left, relative), left
    for distance_to, candidate in (
        (dot(right, relative), right),
        (np.where(front, length - radius, -np.inf), out),
    ):
        better = distance_to > signed
        signed = np.where(better, distance_to, signed)
        normal = np.where(better[..., None], candidate, normal)
    overlap = reach - distance
    signed = np.where(overlap > 0, dot(away, relative) - overlap / SEPARATION_TIME, signed)
    return signed, np.where((overlap > 0)[..., None], away, normal)


def _parting(one: NDArray[np.intp], other: NDArray[np.intp]) -> Array:
    """Unit vectors along which one of two coincident agents leaves; each index has its own direction."""
    angle = 2.399963 * np.stack((one, other))  # the golden angle never repeats
    apart = np.stack((np.cos(angle[0]) - np.cos(angle[1]), np.sin(angle[0]) - np.sin(angle[1])), axis=-1)
    return apart / np.maximum(np.sqrt(dot(apart, apart)), 1e-12)[:, None]


class ObstaclePieces(NamedTuple):
    """Half-planes of the nearest O obstacle pieces of each of M agents."""

    normal: Array  # (M, O, 2) around the current velocity
    offset: Array  # (M, O)
    normal_at_rest: Array  # (M, O, 2) around zero velocity: away from the nearest point
    offset_at_rest: Array  # (M, O) never above zero
    offset_step: Array  # (M, O) the same for one time step

    @classmethod
    def find(
        cls,
        position: Array,
        velocity: Array,
        agents: AgentArrays,
        present: NDArray[np.bool_],
        dt: float,
        obstacles: ConvexObstacles | None,
    ) -> "ObstaclePieces":
        """Sort pieces by free gap and build their half-planes (section 5.4)."""
        count = position.shape[1]
        rows = position.shape[0] * count
        if obstacles is None:
            none = np.zeros((rows, 0))
            return cls(np.zeros((rows, 0, 2)), none, np.zeros((rows, 0, 2)), none, none)
        sight = agents.max_speed * np.maximum(agents.time_horizon_obst, dt)
        scene, agent, piece = obstacles.pairs_within(
            position, np.where(present, agents.radius + sight, -np.inf)
        )
        distance, away = obstacles.signed_distance(position[scene, agent], scene, piece)
        row = scene * count + agent
        gap = distance - agents.radius.reshape(-1)[row]
        order = np.lexsort((gap, row))
        order = order[gap[order] < sight.reshape(-1)[row[order]]]
        start = np.searchsorted(row[order], np.arange(rows))
        rank = np.arange(len(order)) - start[row[order]]
        order, rank = order[rank < MAX_OBSTACLES], rank[rank < MAX_OBSTACLES]
        scene, agent, piece, row = (a[order] for a in (scene, agent, piece, row))
        gap, away = gap[order], away[order]

        horizon, max_speed = agents.time_horizon_obst.reshape(-1)[row], agents.max_speed.reshape(-1)[row]
        radius, own = agents.radius.reshape(-1)[row], velocity.reshape(-1, 2)[row]
        signed, normal = obstacles.velocity_obstacle(
            position[scene, agent], own, radius, horizon, scene, piece
        )
        overlap = gap <= 0
        normal = np.where(overlap[:, None], away, normal)
        offset = np.where(overlap, np.minimum(-gap / SEPARATION_TIME, max_speed), dot(normal, own) - signed)

        most = int(rank.max()) + 1 if rank.size else 0
        free = -np.maximum(gap, 0.0)
        normals, normals_at_rest = np.zeros((2, rows, most, 2))
        offsets, offsets_at_rest, offsets_step = np.full((3, rows, most), -1.0)
        normals[row, rank], normals_at_rest[row, rank] = normal, away
        offsets[row, rank], offsets_at_rest[row, rank], offsets_step[row, rank] = (
            offset,
            free / horizon,
            free / dt,
        )
        return cls(normals, offsets, normals_at_rest, offsets_at_rest, offsets_step)
