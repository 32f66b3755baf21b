"""Where the picture is taken from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..body.rotations import matrix_from_quaternion

FIELD_OF_VIEW_DEG = 45.0
"""Vertical angle of view of every camera."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera `distance` m from the point it looks at; angles of the viewing direction, world frame."""

    target: tuple[float, float, float]
    distance: float
    azimuth_deg: float
    """0 looks along +x, 90 along +y."""
    elevation_deg: float
    """-90 looks straight down."""
    before_walls: bool = False
    """Come nearer where an obstacle or the ground would stand between camera and target."""

    @property
    def forward(self) -> tuple[float, float, float]:
        """Unit viewing direction, world."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        level = np.cos(elevation)
        return float(level * np.cos(azimuth)), float(level * np.sin(azimuth)), float(np.sin(elevation))

    @classmethod
    def top(cls, centre: ArrayLike, height: float) -> Camera:
        """Look straight down, north up, at a strip `height` m high around `centre` (2,) m."""
        x, y = np.asarray(centre, dtype=float)
        distance = 0.5 * height / np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
        return cls((float(x), float(y), 0.0), float(distance), 90.0, -90.0)

    @classmethod
    def follow(cls, pose: ArrayLike, distance: float = 4.5, side_deg: float = 0.0) -> Camera:
        """Follow a person from behind (`side_deg` 180: from the front).

        Args:
            pose: pelvis pose (7,), world, [x y z qw qx qy qz], m, or a person's states (24, 7 or more).
            distance: m.
            side_deg: angle around the person, counter-clockwise.
        """
        x, y, z, *quaternion = np.atleast_2d(np.asarray(pose, dtype=float))[0, :7]
        forward = matrix_from_quaternion(quaternion)[:, 0]
        heading = np.degrees(np.arctan2(forward[1], forward[0]))
        return cls((float(x), float(y), float(z)), distance, float(heading + side_deg), -12.0, True)

    @classmethod
    def street(cls, target: ArrayLike, distance: float = 12.0, azimuth_deg: float = 60.0) -> Camera:
        """Look over a place (2,) or (3,), m, as somebody slightly raised at its side would."""
        x, y, z = (*np.asarray(target, dtype=float), 1.0)[:3]
        return cls((float(x), float(y), float(z)), distance, azimuth_deg, -18.0)
