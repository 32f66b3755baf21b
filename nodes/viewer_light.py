"""Daylight in a viser scene: a low sun, sky from above, light thrown back by the ground, haze far away."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import viser

SKY_TOP, HORIZON = (120, 165, 214), (222, 231, 238)
"""Colours of the background, sRGB."""
SUN, SUN_POWER = (255, 243, 226), 2.6
SKY, GROUND, SKY_POWER = (205, 222, 245), (190, 182, 168), 2.8
"""Light from above and from below."""
TOWARDS_SUN = (-9.0, -7.0, 16.0)
HAZE = (60.0, 260.0)
"""Distances at which things begin to fade, and have faded into the sky [m]."""


def light(server: "viser.ViserServer") -> None:
    """Replace viser's lights, which bleach colours, and its white background."""
    scene = server.scene
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", sky_color=SKY, ground_color=GROUND, intensity=SKY_POWER)
    scene.add_light_directional(
        "/light/sun", color=SUN, intensity=SUN_POWER, cast_shadow=True, position=TOWARDS_SUN
    )
    red, green, blue = in_linear_light(np.array(HORIZON)).tolist()
    scene.configure_fog(*HAZE, color=(red, green, blue))
    scene.set_background_image(sky(), "png")


def sky(rows: int = 256) -> np.ndarray:
    """A background (rows, 4, 3) uint8 that is paler towards the bottom."""
    share = np.linspace(0, 1, rows)[:, None, None] ** 0.7
    picture = (1 - share) * np.array(SKY_TOP) + share * np.array(HORIZON)
    return picture.repeat(4, axis=1).round().astype(np.uint8)


def in_linear_light(colours: np.ndarray) -> np.ndarray:
    """Colours uint8, sRGB, as viser wants those of lines, of batches of meshes and of fog."""
    return (255 * (np.asarray(colours) / 255) ** 2.2).round().astype(np.uint8)
