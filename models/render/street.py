"""What obstacles look like: their colour by their name, and the crowns of trees."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

Colour = tuple[float, float, float]

PLAIN: Colour = (0.64, 0.62, 0.60)
"""Of obstacles whose names say nothing."""
_BY_WORD: tuple[tuple[str, tuple[Colour, ...]], ...] = (
    ("tree|trunk", ((0.50, 0.43, 0.36),)),
    ("hedge|bush|shrub|planter", ((0.36, 0.50, 0.29),)),
    ("pond|pool|fountain|water", ((0.36, 0.55, 0.66),)),
    ("car|van|bus|truck|taxi", ((0.66, 0.27, 0.24), (0.27, 0.38, 0.54), (0.78, 0.79, 0.80))),
    ("bench|table|crate|seat", ((0.58, 0.43, 0.28),)),
    ("bin|bollard|post|light|lamp|pole|pillar|sign|stand|rail|fence|cabinet", ((0.36, 0.38, 0.41),)),
    ("shelter|kiosk|timetable|booth", ((0.34, 0.45, 0.50),)),
    ("house|shop|shops|store|cafe|building|tower", ((0.78, 0.70, 0.60), (0.70, 0.62, 0.58), (0.74, 0.74, 0.70))),
    ("wall|stair|stairs|step", ((0.70, 0.67, 0.62),)),
)  # fmt: skip
_CROWN = (0.33, 0.50, 0.25)
_FURNITURE = ("shelter", "stop")
"""Words after which `bus` is not a vehicle."""


def colour_of_obstacle(name: str, number: int = 0) -> Colour:
    """The colour of an obstacle, sRGB; those of one kind take turns by `number`."""
    words = set(re.findall(r"[a-z]+", name.lower()))
    if words & set(_FURNITURE):
        words.discard("bus")
    for kind, colours in _BY_WORD:
        if words & set(kind.split("|")):
            return colours[number % len(colours)]
    return PLAIN


def crown(
    name: str, outline: NDArray[np.float64], height: float
) -> tuple[NDArray[np.float64], Colour] | None:
    """The crown of a tree: points of its convex hull, and its colour; None for anything but a tree.

    Args:
        name: of the obstacle.
        outline: (K, 2) m.
        height: of the obstacle, m.

    Returns:
        Points (P, 3) m; heights above the foot of the trunk.
    """
    if "tree" not in re.findall(r"[a-z]+", name.lower()):
        return None
    middle = np.asarray(outline, dtype=float).mean(axis=0)
    draw = np.random.default_rng(np.abs(middle * 100).astype(np.uint32).tolist())
    up = np.linspace(-1, 1, 7)
    angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    level = np.sqrt(np.maximum(1 - up**2, 0.02))
    ball = np.stack(
        [level[:, None] * np.cos(angle), level[:, None] * np.sin(angle), up[:, None] + 0 * angle], -1
    ).reshape(-1, 3)
    size = np.array([0.36, 0.36, 0.30]) * height * draw.uniform(0.9, 1.1)
    points = ball * size * draw.uniform(0.88, 1.0, (len(ball), 1))
    tone = float(draw.uniform(0.88, 1.1))
    red, green, blue = _CROWN
    return points + np.array([*middle, 0.88 * height]), (red * tone, green * tone, blue * tone)
