"""What people are drawn before: sky, sun, ground, obstacles and trees as a MuJoCo model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..world.stage import add_ground, add_obstacles
from .camera import FIELD_OF_VIEW_DEG
from .street import colour_of_obstacle, crown

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

PEOPLE_GROUP, CROWN_GROUP = 1, 2
"""Geom groups of what a following camera may pass through."""
SUN = np.array([0.55, 0.35, -1.0])
"""Direction of the sun's light."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundPicture:
    """A picture painted on flat ground."""

    pixels: NDArray[np.uint8]
    """(H, W, 3); row 0 has the smallest y, column 0 the smallest x."""
    resolution: float
    """m per pixel."""
    origin: tuple[float, float]
    """World x, y (m) of the picture's corner of smallest x and y."""


def stage(
    obstacles: Sequence[Obstacle],
    terrain: Terrain | None,
    picture: GroundPicture | None,
    size: tuple[int, int],
    antialias: bool,
) -> mujoco.MjSpec:
    """A model of sky, sun, ground and obstacles, without people; `size` is the picture's, px."""
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
        dir=SUN,
        pos=-20 * SUN,
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
    seen: Counter[str] = Counter()
    for obstacle, geoms in zip(obstacles, add_obstacles(spec, obstacles, terrain), strict=True):
        for geom in geoms:
            geom.rgba = [*colour_of_obstacle(obstacle.name, seen[obstacle.name]), 1.0]
        seen[obstacle.name] += 1
    _plant(spec, obstacles, terrain)
    return spec


def _plant(spec: mujoco.MjSpec, obstacles: Sequence[Obstacle], terrain: Terrain | None) -> None:
    """Give trees their crowns."""
    for i, obstacle in enumerate(obstacles):
        outline = np.asarray(obstacle.polygon, dtype=float)
        if (found := crown(obstacle.name, outline, obstacle.height)) is None:
            continue
        points, colour = found
        if terrain is not None:
            points[:, 2] += float(terrain.height_at(outline).mean())
        spec.add_mesh(name=f"crown_{i}", uservert=points.ravel(), smoothnormal=True)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"crown_{i}",
            rgba=[*colour, 1.0],
            group=CROWN_GROUP,
            contype=0,
            conaffinity=0,
        )


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
