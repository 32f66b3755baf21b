"""What people look like in a viewer: one mesh a body part, stretched and coloured for each person."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..messages.body import Bodies
from ..models.body import describe
from ..models.render.convex_hull import convex_hull
from ..models.render.looks import SHIRTS, dress


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of clothing or skin that moves with one body, for all people at once."""

    body: int
    """Index of the body it is fixed to."""
    vertices: np.ndarray
    """(V, 3) [m], body frame, of a person of mean shape."""
    faces: np.ndarray
    """(F, 3) indices of vertices."""
    scales: np.ndarray
    """(N, 3) by which each person's piece is larger along x, y, z."""
    colours: np.ndarray
    """(N, 3) uint8 sRGB."""


@cache
def _mean_pieces() -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Body, all points, hull vertices and faces of each piece of a person of mean shape."""
    pieces = []
    for piece in dress(describe(np.zeros(10)), 0):
        faces = convex_hull(piece.points)
        used, index = np.unique(faces, return_inverse=True)
        pieces.append((piece.body, piece.points, piece.points[used], index.reshape(-1, 3)))
    return pieces


def dressed(bodies: Bodies, tint: np.ndarray | None = None) -> list[Part]:
    """The parts of everybody, in the order of `bodies.ids`.

    Args:
        bodies: Who there is.
        tint: One colour (3,) uint8 for all, to tell one run from another; None for everybody's own.
    """
    wardrobes = [
        dress(describe(shape), agent)
        for agent, shape in zip(bodies.ids.tolist(), bodies.shapes.astype(np.float64), strict=True)
    ]
    parts = []
    for number, (body, mean, vertices, faces) in enumerate(_mean_pieces()):
        own = np.stack([wardrobe[number].points for wardrobe in wardrobes])  # (N, K, 3)
        scales = np.einsum("nki,ki->ni", own, mean) / np.maximum(np.einsum("ki,ki->i", mean, mean), 1e-12)
        colours = np.array([wardrobe[number].colour for wardrobe in wardrobes]) * 255
        if tint is not None:
            colours = 0.25 * colours + 0.75 * tint
        parts.append(Part(body, vertices, faces, scales.astype(np.float32), colours.round().astype(np.uint8)))
    return parts


def colour_of(agent: int) -> np.ndarray:
    """The colour by which somebody's tracks and plans are known, that of the shirt (3,) uint8."""
    return np.array([round(255 * channel) for channel in SHIRTS[agent % len(SHIRTS)]], np.uint8)


def colours_of(agents: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 of agents (N,)."""
    palette = np.array(SHIRTS)[np.asarray(agents, dtype=int) % len(SHIRTS)]
    return (255 * palette).round().astype(np.uint8)
