"""Writes what does not move, ground and obstacles, into a MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..crowd.convex_obstacles import convex_pieces
from .humanoid import FOOT_FRICTION, GROUND_BIT, OBSTACLE_BIT

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

_FLOOR_HALF_SIZE = 100.0  # m; drawn only, MuJoCo's planes have no end
_HFIELD_BASE = 1.0  # m of solid ground below the lowest point
_WALL_THICKNESS = 0.05  # m given to an obstacle of two points
_SUNK = 0.2  # m that obstacles reach into the ground, so that no gap opens on a slope


def add_ground(spec: mujoco.MjSpec, terrain: Terrain | None) -> mujoco.MjsGeom:
    """Add a flat floor at z = 0, or the height field `terrain`."""
    ground = spec.worldbody.add_geom(
        name="ground", contype=GROUND_BIT, conaffinity=0, friction=[FOOT_FRICTION, 0.005, 0.0001]
    )
    if terrain is None:
        ground.type = mujoco.mjtGeom.mjGEOM_PLANE
        ground.size = [_FLOOR_HALF_SIZE, _FLOOR_HALF_SIZE, 1.0]
        return ground
    heights = np.asarray(terrain.heights, dtype=float)
    rows, columns = heights.shape
    low, span = float(heights.min()), float(np.ptp(heights))
    half = 0.5 * terrain.resolution * np.array([columns - 1, rows - 1])
    spec.add_hfield(
        name="ground",
        nrow=rows,
        ncol=columns,
        size=[*half, max(span, 1e-3), _HFIELD_BASE],
        userdata=((heights - low) / max(span, 1e-3)).ravel(),
    )
    ground.type = mujoco.mjtGeom.mjGEOM_HFIELD
    ground.hfieldname = "ground"
    ground.pos = [*(np.asarray(terrain.origin) + half), low]
    return ground


def add_obstacles(
    spec: mujoco.MjSpec, obstacles: Sequence[Obstacle], terrain: Terrain | None
) -> list[list[mujoco.MjsGeom]]:
    """Add each obstacle as prisms over its convex pieces; return the geoms of each.

    Raises:
        ObstacleError: an outline has fewer than two points, no area, or crosses itself.
    """
    geoms: list[list[mujoco.MjsGeom]] = []
    for i, obstacle in enumerate(obstacles):
        outline = np.asarray(obstacle.polygon, dtype=float)
        ground = np.zeros(1) if terrain is None else terrain.height_at(outline)
        bottom, top = float(ground.min()) - _SUNK, float(ground.mean()) + obstacle.height
        pieces = convex_pieces(outline, f"obstacle {i} ({obstacle.name})")
        geoms.append(
            [_prism(spec, f"obstacle_{i}_{k}", piece, bottom, top) for k, piece in enumerate(pieces)]
        )
    return geoms


def _prism(
    spec: mujoco.MjSpec, name: str, outline: NDArray[np.float64], bottom: float, top: float
) -> mujoco.MjsGeom:
    geom = spec.worldbody.add_geom(
        name=name, contype=OBSTACLE_BIT, conaffinity=0, rgba=[0.62, 0.6, 0.57, 1.0]
    )
    if len(outline) == 2:
        outline = _thicken(outline)
    sides = np.roll(outline, -1, axis=0) - outline
    if len(outline) == 4 and abs(sides[0] @ sides[1]) + abs(sides[0] @ sides[3]) < 1e-6:  # a rectangle
        length, width = np.linalg.norm(sides[0]), np.linalg.norm(sides[1])
        turn = 0.5 * np.arctan2(sides[0, 1], sides[0, 0])
        geom.type = mujoco.mjtGeom.mjGEOM_BOX
        geom.size = [length / 2, width / 2, (top - bottom) / 2]
        geom.pos = [*outline.mean(axis=0), (top + bottom) / 2]
        geom.quat = [np.cos(turn), 0.0, 0.0, np.sin(turn)]
        return geom
    corners = [[x, y, z] for z in (bottom, top) for x, y in outline]
    spec.add_mesh(name=name, uservert=np.ravel(corners))
    geom.type = mujoco.mjtGeom.mjGEOM_MESH
    geom.meshname = name
    return geom


def _thicken(wall: NDArray[np.float64]) -> NDArray[np.float64]:
    along = wall[1] - wall[0]
    across = np.array([-along[1], along[0]]) * (0.5 * _WALL_THICKNESS / np.linalg.norm(along))
    return np.array([wall[0] - across, wall[1] - across, wall[1] + across, wall[0] + across])
