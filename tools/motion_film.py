"""Films of motion clips, and strips that show a clip in one picture."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..models.body import Body
from ..models.render.renderer import Camera, CrowdRenderer
from ..models.render.video import write_video

_LANE = 1.3  # m between clips filmed side by side
_FRAMES = 9  # of a strip
_SPREAD = 0.75  # m at least between the figures of a strip


def film(path: Path, states: Sequence[NDArray[np.float32]], body: Body, rate_hz: float) -> None:
    """Film clips side by side, seen from the side; shorter ones wait at their end.

    Args:
        path: the film.
        states: body states (T, 24, 7 or more) of each clip, starting at the origin along +x.
        body: who moves.
        rate_hz: frames per second.
    """

    def frames() -> Iterator[NDArray[np.uint8]]:
        with CrowdRenderer([body] * len(states), width=960, height=540, antialias=False) as renderer:
            for t in range(max(map(len, states))):
                poses = np.array([s[min(t, len(s) - 1)] for s in states])
                poses[:, :, 1] += _LANE * np.arange(len(states))[:, None]
                x, y = poses[:, 0, 0].mean(), poses[:, 0, 1].mean()
                yield renderer.render(
                    poses, Camera((float(x), float(y), 0.9), 4.5 + _LANE * len(states), 60.0, -12.0)
                )

    write_video(path, frames(), rate_hz)


def draw_strips(path: Path, states: Sequence[NDArray[np.float32]], body: Body, rate_hz: float) -> None:
    """Draw each clip as a row of figures, from left to right in time, seen from its right side."""
    del rate_hz
    rows = []
    with CrowdRenderer([body] * _FRAMES, width=1400, height=330) as renderer:
        for state in states:
            chosen = np.linspace(0, len(state) - 1, _FRAMES).round().astype(int)
            poses = state[chosen, :, :7].copy()
            way = np.maximum(np.diff(poses[:, 0, 0], prepend=poses[0, 0, 0]), 0.0)
            place = np.cumsum(np.maximum(way, _SPREAD))
            poses[..., 0] += (place - poses[:, 0, 0])[:, None]
            poses[..., 1] -= poses[:, :1, 1]
            middle = float(place.mean())
            width = float(np.ptp(place)) + 1.6
            rows.append(renderer.render(poses, Camera((middle, 0.0, 0.85), 0.32 * width + 0.3, 90.0, -6.0)))
    Image.fromarray(np.concatenate(rows)).save(path)
