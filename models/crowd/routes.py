"""Ways that are looked up once and followed for many steps."""

from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .navigation import Navigator

Array = NDArray[np.float64]
Follow = Callable[[Array, Array], Array]
"""From places (N, 2) [m] and speeds (N,) [m/s] to wanted velocities (N, 2) [m/s]."""

SPACING = 0.25
"""Distance of neighbouring points of a way [m]."""
AHEAD = 4
"""Points ahead of oneself one walks towards: a metre."""
WINDOW = 64
"""Points of a way that are in view: more than anybody walks in five seconds."""
STRAY = 1.2
"""Distance from a known way at which a new one is looked up [m]."""
KEPT = 512
"""Ways remembered."""
ARRIVAL_TIME = 0.4
"""The speed falls with the distance left over this time [s]."""


class Routes:
    """Shortest ways of a map, shared by everybody who is near one and has the same goal."""

    def __init__(self, navigator: Navigator) -> None:
        self._navigator = navigator
        self._ways: OrderedDict[tuple[float, float], list[Array]] = OrderedDict()

    def follow(self, start: Array, goal: Array) -> Follow:
        """What leads each of N people from `start` to `goal` (N, 2) [m]; and remembers how far each is."""
        views = np.stack([self._view(here, end) for here, end in zip(start, goal, strict=True)])  # (N, W, 2)
        rows = np.arange(len(views))
        at = np.zeros(len(views), dtype=np.intp)
        points = np.arange(WINDOW)

        def velocity(position: Array, speed: Array) -> Array:
            nonlocal at
            distance = np.linalg.norm(views - position[:, None], axis=-1)
            reachable = (points >= at[:, None]) & (points <= at[:, None] + 2 * AHEAD)
            at = np.where(reachable, distance, np.inf).argmin(axis=1)
            arm = views[rows, np.minimum(at + AHEAD, WINDOW - 1)] - position
            length = np.linalg.norm(arm, axis=1)
            pace = np.minimum(speed, length / ARRIVAL_TIME)
            return arm * (pace / np.maximum(length, 1e-9))[:, None]

        return velocity

    def _view(self, here: Array, goal: Array) -> Array:
        """The next points (W, 2) of a way to `goal`, from the one nearest to `here`; the last is repeated."""
        key = (round(float(goal[0]), 3), round(float(goal[1]), 3))
        ways = self._ways.setdefault(key, [])
        self._ways.move_to_end(key)
        for way in ways:
            distance = np.linalg.norm(way - here, axis=1)
            nearest = int(distance.argmin())
            if distance[nearest] < STRAY:
                break
        else:
            way, nearest = _resample(self._navigator.path(here, goal)), 0
            ways.append(way)
            if len(self._ways) > KEPT:
                self._ways.popitem(last=False)
        index = np.minimum(nearest + np.arange(WINDOW), len(way) - 1)
        return way[index]


def _resample(corners: Array) -> Array:
    """Points a `SPACING` apart along a polyline (K, 2), its end included."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    marks = np.append(np.arange(0.0, along[-1], SPACING), along[-1])
    return np.column_stack([np.interp(marks, along, corners[:, axis]) for axis in (0, 1)])
