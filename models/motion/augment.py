"""More motion from the clips at hand: mirror images, walks bent on to arcs, other bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ..body import Body
from .clip import Clip
from .recording import about
from .retarget import refit

_STRAIGHT = np.radians(12.0)  # rad/s: walks that turn less may be bent
_LEAN = 0.8  # share of the lean that balances the centripetal acceleration; people lean a little less
_GRAVITY = 9.81


def bend(clip: Clip, turn_rate: float, body: Body) -> Clip:
    """Return a walk that turns by `turn_rate`, rad/s (left positive), more than it did.

    The path is bent in proportion to the distance covered, the person leans into the curve, and the feet are
    planted anew.
    """
    steps = np.diff(clip.root[:, :2], axis=0, prepend=clip.root[:1, :2])
    covered = np.cumsum(np.linalg.norm(steps, axis=1))
    angle = turn_rate * clip.duration * covered / max(covered[-1], 1e-6)
    middle = angle - 0.5 * np.diff(angle, prepend=angle[0])
    turned = about(2, middle).apply(np.pad(steps, ((0, 0), (0, 1))))
    root = clip.root.copy()
    root[:, :2] = root[0, :2] + np.cumsum(turned[:, :2], axis=0)
    lean = np.full(len(clip), -_LEAN * np.arctan(clip.speed * turn_rate / _GRAVITY))
    heading = clip.heading()
    turn = about(2, angle + heading) * about(0, lean)
    turn = turn * about(2, -heading)
    quaternion = (turn * Rotation.from_quat(root[:, 3:], scalar_first=True)).as_quat(scalar_first=True)
    flips = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], -1) < 0, -1.0, 1.0))
    root[:, 3:] = quaternion * np.concatenate([[1.0], flips])[:, None]
    degrees = round(float(np.degrees(turn_rate)))
    tags = {"parent": clip.name, "augmentation": f"bend {degrees:+d} deg/s"}
    return refit(clip, root, body, f"{clip.name}_bend{degrees:+d}", tags).centred()


def fit_to(clip: Clip, owner: Body, body: Body) -> Clip:
    """Return a clip of `owner` as `body` would do it: its path scaled by leg length, feet planted anew."""
    root = clip.root.copy()
    root[:, :3] *= (body.thigh + body.shank) / (owner.thigh + owner.shank)
    return refit(clip, root, body, clip.name, {})


def augment(
    clips: Sequence[Clip], body: Body, turn_rates_deg: Sequence[float] = (15, 30, 50), mirror: bool = True
) -> list[Clip]:
    """Return clips with their arcs and mirror images.

    Straight walks of at least 2 s are bent by each rate, alternately to the left and to the right; with
    mirror images every one turns both ways.
    """
    out = list(clips)
    straight = [c for c in clips if abs(c.turn_rate) < _STRAIGHT and c.duration >= 2.0 and c.speed < 2.2]
    for i, clip in enumerate(straight):
        rate = np.radians(turn_rates_deg[i % len(turn_rates_deg)])
        out.append(bend(clip, rate if i % 2 else -rate, body))
    return out + [clip.mirrored() for clip in out] if mirror else out
