"""Draws a crowd off screen from the world poses of its bodies, live or logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body.body import Body
from ..body.skeleton import N_BODIES
from ..world.stage import add_ground, add_obstacles
from .camera import FIELD_OF_VIEW_DEG, Camera
from .gl import RenderError, create_context, find_gl_backend
from .looks import Colour, dress

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

__all__ = ["Camera", "CrowdRenderer", "GroundPicture", "RenderError", "find_gl_backend"]

_AWAY = (0.0, 0.0, -50.0)  # m; where people who are not drawn wait
_MAX_GEOMS = 40_000
_PEOPLE_GROUP = 1
_STAGE_ONLY = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)  # geom groups
_SUN = np.array([-0.45, -0.35, -1.0])  # direction of its light


@dataclass(frozen=True, slots=True, eq=False)
class GroundPicture:
    """A picture painted on flat ground."""

    pixels: NDArray[np.uint8]
    """(H, W, 3); row 0 has the smallest y, column 0 the smallest x."""
    resolution: float
    """m per pixel."""
    origin: tuple[float, float]
    """World x, y (m) of the picture's corner of smallest x and y."""


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
        spec = _stage(obstacles, terrain, ground, (width, height), antialias)
        for i, body in enumerate(bodies):
            _add_person(spec, body, i, None if shirts is None else shirts[i])
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
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

    def render(self, poses: ArrayLike, camera: Camera, agents: ArrayLike | None = None) -> NDArray[np.uint8]:
        """Draw one picture.

        Args:
            poses: (n, 24, 7 or more) world poses of the bodies, [x y z qw qx qy qz ...], m; the rows of
                `World.joint_states` and of logged states serve as they are.
            camera: where from.
            agents: (n,) whose poses these are; 0 to n-1 when left out. Nobody else is drawn.

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
        self.model.light_pos[0] = np.array(camera.target) - 20 * _SUN  # shadows are sharp where one looks
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

        view = mujoco.MjvCamera()
        view.lookat[:] = camera.target
        view.distance = self._free_distance(camera) if camera.before_walls else camera.distance
        view.azimuth, view.elevation = camera.azimuth_deg, camera.elevation_deg
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        self._gl.make_current()
        mujoco.mjv_updateScene(self.model, self.data, mujoco.MjvOption(), None, view, everything, self._scene)
        frame = mujoco.MjrRect(0, 0, *self._size)
        mujoco.mjr_render(frame, self._scene, self._context)
        pixels = np.empty((self._size[1], self._size[0], 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, frame, self._context)
        return pixels[::-1]

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


def _stage(
    obstacles: Sequence[Obstacle],
    terrain: Terrain | None,
    picture: GroundPicture | None,
    size: tuple[int, int],
    antialias: bool,
) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = size
    visual.global_.fovy = FIELD_OF_VIEW_DEG
    visual.quality.shadowsize = 4096
    visual.quality.offsamples = 4 if antialias else 0
    visual.headlight.ambient = [0.42, 0.43, 0.46]
    visual.headlight.diffuse = [0.22, 0.22, 0.22]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.haze = [0.80, 0.87, 0.93, 1.0]
    visual.map.znear, visual.map.zfar = 0.01, 20  # in units of the extent
    visual.map.shadowclip = 3.0  # smaller speckles what is nearest the sun
    spec.stat.extent, spec.stat.center = 12.0, [0.0, 0.0, 1.0]
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=_SUN,
        pos=-20 * _SUN,
        castshadow=True,
        diffuse=[0.62, 0.60, 0.55],
        specular=[0.1, 0.1, 0.1],
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.80, 0.87, 0.93],
        rgb2=[0.45, 0.62, 0.82],
        width=64,
        height=384,
    )
    ground = add_ground(spec, terrain)
    ground.material = _paving(spec)
    ground.castshadow = False  # it would speckle itself
    if picture is not None and terrain is None:
        ground.pos = [0.0, 0.0, -0.02]  # below the picture
        _paint(spec, picture)
    for geoms in add_obstacles(spec, obstacles, terrain):
        for geom in geoms:
            geom.rgba = [0.74, 0.71, 0.66, 1.0]
    return spec


def _paving(spec: mujoco.MjSpec) -> str:
    spec.add_texture(
        name="paving",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.62, 0.62, 0.61],
        rgb2=[0.66, 0.66, 0.65],
        markrgb=[0.55, 0.55, 0.54],
        width=512,
        height=512,
    )
    paving = spec.add_material(name="paving", texrepeat=[1.0, 1.0], texuniform=True)  # tiles of 1 m
    paving.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "paving"
    return "paving"


def _paint(spec: mujoco.MjSpec, picture: GroundPicture) -> None:
    height, width = picture.pixels.shape[:2]
    texture = spec.add_texture(
        name="picture", type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height
    )
    texture.nchannel = 3
    texture.data = picture.pixels[::-1].tobytes()  # textures start at the far edge
    material = spec.add_material(name="picture")
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "picture"
    half = 0.5 * picture.resolution * np.array([width, height])
    spec.worldbody.add_geom(
        name="picture",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[*half, 1.0],
        pos=[*(np.asarray(picture.origin) + half), 0.0],
        material="picture",
        castshadow=False,
        contype=0,
        conaffinity=0,
    )


def _add_person(spec: mujoco.MjSpec, body: Body, agent: int, shirt: Colour | None) -> None:
    parts = [spec.worldbody.add_body(mocap=True, pos=_AWAY) for _ in range(N_BODIES)]
    for k, piece in enumerate(dress(body, agent, shirt)):
        name = f"{agent}_{k}"
        spec.add_mesh(name=name, uservert=piece.points.ravel(), smoothnormal=True)
        parts[piece.body].add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            rgba=[*piece.colour, 1.0],
            group=_PEOPLE_GROUP,
            contype=0,
            conaffinity=0,
        )
