"""Who or what a click in the scene means."""

import numpy as np

from .viewer_picture import Picture

BODY_HEIGHT = 1.7
"""A person is an upright line this long for somebody who clicks [m]."""
BODY_RADIUS = 0.25
"""A click's ray so near to that line hits the person [m]."""
REACH = 0.45
"""Farthest distance of a ray from that line that still means somebody [m]."""
FAR = 500.0
"""How far away ground is looked for [m]."""
STEP = 0.25
"""Distance at which a ray is compared with uneven ground [m]."""


def pick_person(picture: Picture, origin: np.ndarray, direction: np.ndarray) -> int | None:
    """Who is first hit by a ray, or nearest to it if near enough.

    Args:
        picture: Who is where.
        origin: Where the ray begins (3,) [m].
        direction: Where it goes (3,).
    """
    ids, xy = picture.places()
    if not ids:
        return None
    low = picture.on_ground(xy)
    steps = np.linspace(0.0, BODY_HEIGHT, 12)
    points = low[:, None] + steps[:, None] * np.array([0.0, 0.0, 1.0])  # (N, 12, 3)
    unit = np.asarray(direction) / np.linalg.norm(direction)
    arms = points - np.asarray(origin)
    along = np.maximum(arms @ unit, 0.0)
    distance = np.linalg.norm(arms - along[..., None] * unit, axis=-1).min(axis=1)
    reach = (arms @ unit).max(axis=1)
    distance[reach <= 0] = np.inf
    hit = np.where(distance <= BODY_RADIUS, reach, np.inf)  # who is hit hides who stands behind
    best = int(hit.argmin()) if np.isfinite(hit).any() else int(distance.argmin())
    return ids[best] if distance[best] <= REACH else None


def pick_ground(picture: Picture, origin: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
    """Where a ray meets the ground, world x, y [m]; None if it goes into the sky."""
    origin, unit = np.asarray(origin, float), np.asarray(direction, float) / np.linalg.norm(direction)
    if picture.place is None or picture.place.terrain is None:
        if unit[2] > -1e-6:
            return None
        reach = -origin[2] / unit[2]
        if not 0 <= reach <= FAR:
            return None
        x, y = (origin + reach * unit)[:2].tolist()
        return x, y
    marks = np.arange(0.0, FAR, STEP)
    points = origin + marks[:, None] * unit
    below = points[:, 2] <= picture.height_at(points[:, :2])
    if not below.any():
        return None
    first = int(below.argmax())
    if first == 0:
        return None
    above, under = points[first - 1], points[first]
    for _ in range(20):
        middle = 0.5 * (above + under)
        if middle[2] <= picture.height_at(middle[:2]):
            under = middle
        else:
            above = middle
    return float(under[0]), float(under[1])
