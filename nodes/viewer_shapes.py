"""Small meshes of a viewer: rings, disks, pins, knobs; vertices (V, 3) [m] and triangles (F, 3)."""

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]


def ring(inner: float = 0.86, around: int = 28) -> Mesh:
    """A flat ring of outer radius 1."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    here, after = np.arange(around), (np.arange(around) + 1) % around
    faces = np.concatenate(
        [
            np.stack([here, after, around + after], axis=1),
            np.stack([here, around + after, around + here], axis=1),
        ]
    )
    return np.concatenate([circle, circle * inner]).astype(np.float32), faces.astype(np.uint32)


def double_cone(radius: float, low: float, middle: float, high: float) -> Mesh:
    """Eight-sided: a point below, a belt, a point above [m]."""
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    belt = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(8, middle)])
    here, after = np.arange(8), (np.arange(8) + 1) % 8
    bottom, top = np.full(8, 8), np.full(8, 9)
    faces = np.concatenate([np.stack([after, here, bottom], axis=1), np.stack([here, after, top], axis=1)])
    vertices = np.concatenate([belt, [[0, 0, low], [0, 0, high]]])
    return vertices.astype(np.float32), faces.astype(np.uint32)


RING = ring()
SPOT = ring(0.0, 16)
PIN = double_cone(0.16, 0.0, 0.75, 0.95)
KNOB = double_cone(0.07, -0.07, 0.0, 0.07)
