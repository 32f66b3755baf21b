"""Draws a crowd off screen from the world poses of its bodies, live or logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body.body import Body
from ..body.skeleton import N_BODIES
from .camera import Camera
from .gl import RenderError, create_context, find_gl_backend
from .looks import Colour, dress
from .scenery import CROWN_GROUP, PEOPLE_GROUP, SUN, GroundPicture, stage

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

__all__ = ["Camera", "CrowdRenderer", "GroundPicture", "RenderError", "Stroke", "find_gl_backend"]

_AWAY = (0.0, 0.0, -50.0)  # m; where people who are not drawn wait
_MAX_GEOMS = 40_000
_NEAR, _STEEP, _OPENED = (
    0.75,
    -60.0,
    0.3,
)  # share of the camera's distance; deg; opacity of crowns before people
_STAGE_ONLY = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # geom groups


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """A line through points, as round as a rope."""

    points: NDArray[np.float64]
    """(K, 3) m, world."""
    colour: Colour
    radius: float = 0.03
    """m"""


class CrowdRenderer:
    """Draws people of given bodies on a stage, wherever their 24 body poses say.

    It needs no joint angles: what a `World` or a log holds, positions and rotations, is enough. Use it as a
    context manager, or `close` it.

    Args:
        bodies: the N people who may be drawn.
        obstacles: vertical prisms.
        terrain: ground heights; None is flat ground.
        width: of the picture, px.
        height: of the picture, px.
        shadows: whether the sun casts shadows (twice as slow without a GPU).
        antialias: whether edges are smoothed (twice as slow without a GPU).
        shirts: (N,) shirt colours, sRGB in [0, 1]; chosen by number when left out.
        ground: picture on flat ground; a grid of metres when left out.

    Raises:
        RenderError: this machine has no OpenGL; says what to install.
        ObstacleError: an obstacle's outline is not a simple polygon.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        obstacles: Sequence[Obstacle] = (),
        terrain: Terrain | None = None,
        *,
        width: int = 960,
        height: int = 540,
        shadows: bool = True,
        antialias: bool = True,
        shirts: Sequence[Colour] | None = None,
        ground: GroundPicture | None = None,
    ):
        spec = stage(obstacles, terrain, ground, (width, height), antialias)
        for i, body in enumerate(bodies):
            _add_person(spec, body, i, None if shirts is None else shirts[i])
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._crowns = np.flatnonzero(self.model.geom_group == CROWN_GROUP)
        self._poses = (
            self.data.mocap_pos.reshape(len(bodies), N_BODIES, 3),
            self.data.mocap_quat.reshape(len(bodies), N_BODIES, 4),
        )
        self._gl = create_context(width, height)
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(self.model, maxgeom=_MAX_GEOMS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        self._size = (width, height)

    def render(
        self,
        poses: ArrayLike,
        camera: Camera,
        agents: ArrayLike | None = None,
        strokes: Sequence[Stroke] = (),
    ) -> NDArray[np.uint8]:
        """Draw one picture.

        Args:
            poses: (n, 24, 7 or more) world poses of the bodies, [x y z qw qx qy qz ...], m; the rows of
                `World.joint_states` and of logged states serve as they are.
            camera: where from.
            agents: (n,) whose poses these are; 0 to n-1 when left out. Nobody else is drawn.
            strokes: lines drawn into the scene.

        Returns:
            (height, width, 3) sRGB.

        Raises:
            ValueError: poses of another shape.
        """
        poses = np.asarray(poses, dtype=float)
        if poses.ndim != 3 or poses.shape[1] != N_BODIES or poses.shape[2] < 7:
            raise ValueError(f"Poses have shape {poses.shape}; they must be (people, {N_BODIES}, 7).")
        ids = np.arange(len(poses)) if agents is None else np.asarray(agents, dtype=int)
        self._poses[0][:] = _AWAY
        self._poses[0][ids] = poses[..., :3]
        self._poses[1][ids] = poses[..., 3:7]
        self.model.light_pos[0] = np.array(camera.target) - 20 * SUN  # shadows are sharp where one looks
        self._open_crowns(camera)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

        view = mujoco.MjvCamera()
        view.lookat[:] = camera.target
        view.distance = self._free_distance(camera) if camera.before_walls else camera.distance
        view.azimuth, view.elevation = camera.azimuth_deg, camera.elevation_deg
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        self._gl.make_current()
        mujoco.mjv_updateScene(self.model, self.data, mujoco.MjvOption(), None, view, everything, self._scene)
        for stroke in strokes:
            self._draw_stroke(stroke)
        frame = mujoco.MjrRect(0, 0, *self._size)
        mujoco.mjr_render(frame, self._scene, self._context)
        pixels = np.empty((self._size[1], self._size[0], 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, frame, self._context)
        return pixels[::-1]

    def _open_crowns(self, camera: Camera) -> None:
        """Make crowns of trees see-through where somebody may be behind them."""
        eye = np.array(camera.target) - camera.distance * np.array(camera.forward)
        places = self.model.geom_pos[self._crowns]
        near = np.linalg.norm(places - eye, axis=1) < _NEAR * camera.distance
        before = near | (camera.elevation_deg < _STEEP)
        self.model.geom_rgba[self._crowns, 3] = np.where(before, _OPENED, 1.0)

    def _draw_stroke(self, stroke: Stroke) -> None:
        """Add one geom a segment; what finds no room is left out."""
        colour = np.array([*stroke.colour, 1.0], dtype=np.float32)
        points = np.asarray(stroke.points, dtype=np.float64)
        for start, end in pairwise(points):
            if self._scene.ngeom >= self._scene.maxgeom:
                return
            geom = self._scene.geoms[self._scene.ngeom]
            mujoco.mjv_initGeom(
                geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour
            )
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, stroke.radius, start, end)
            geom.emission = 0.35
            self._scene.ngeom += 1

    def _free_distance(self, camera: Camera) -> float:
        """Distance at which nothing of the stage stands between the target and the camera."""
        hit = mujoco.mj_ray(
            self.model,
            self.data,
            np.array(camera.target),
            -np.array(camera.forward),
            geomgroup=_STAGE_ONLY,
            flg_static=1,
            bodyexclude=-1,
            geomid=np.empty(1, dtype=np.int32),
        )
        return camera.distance if hit < 0 else min(camera.distance, 0.9 * hit)

    def close(self) -> None:
        """Free the OpenGL context; the renderer cannot be used afterwards."""
        self._context.free()
        self._gl.free()

    def __enter__(self) -> CrowdRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _add_person(spec: mujoco.MjSpec, body: Body, agent: int, shirt: Colour | None) -> None:
    parts = [spec.worldbody.add_body(mocap=True, pos=_AWAY) for _ in range(N_BODIES)]
    for k, piece in enumerate(dress(body, agent, shirt)):
        name = f"{agent}_{k}"
        spec.add_mesh(name=name, uservert=piece.points.ravel(), smoothnormal=True)
        parts[piece.body].add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            rgba=[*piece.colour, 1.0],
            group=PEOPLE_GROUP,
            contype=0,
            conaffinity=0,
        )
