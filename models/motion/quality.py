"""How well a clip stands on its feet and stays within its joints' limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..body import BODY_INDEX, JOINT_LIMITS, Body
from ..body.skeleton import LITE_JOINTS, forward_kinematics
from .clip import Clip
from .feet import FootMotion, heel_and_ball

_AT_LIMIT = np.radians(0.1)


@dataclass(frozen=True, slots=True)
class Quality:
    """Measures of one clip; medians and quantiles over frames."""

    skate_median: float
    """m/s: horizontal speed of heels and balls while they stand."""
    skate_p95: float
    """m/s."""
    roll_p95_deg: float
    """Roll of soles that stand flat, 95th percentile."""
    sink_max: float
    """m: deepest point of a sole below the ground."""
    hover_max: float
    """m: highest lowest point of a sole that should stand."""
    limit_share: float
    """Share of frames x actuated (lite) hinges that lie on a limit."""
    joint_speed_max: float
    """rad/s."""
    stance_share: float
    """Share of frames in which any foot stands."""


def measure(clip: Clip, body: Body) -> Quality:
    """Return the measures of a clip made for `body`."""
    positions, rotations = forward_kinematics(body.offsets, clip.root, clip.joints)
    ankles = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
    feet = FootMotion(positions[:, ankles], rotations[:, ankles])
    soles = feet.soles(body)
    points = heel_and_ball(soles)
    both = clip.contacts[1:] & clip.contacts[:-1]
    slip = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1)[both] * clip.rate_hz
    flat = clip.contacts.all(-1)
    roll = np.degrees(np.abs(np.arctan2(rotations[:, ankles, 2, 1], rotations[:, ankles, 2, 2])))[flat]
    standing = clip.contacts.any(-1)
    lowest = soles[..., 2].min(-1)
    low, high = JOINT_LIMITS[LITE_JOINTS].T
    joints = clip.joints[:, LITE_JOINTS]
    on_limit = (joints < low + _AT_LIMIT) | (joints > high - _AT_LIMIT)
    _, speeds = clip.velocities()
    return Quality(
        skate_median=_quantile(slip, 0.5),
        skate_p95=_quantile(slip, 0.95),
        roll_p95_deg=_quantile(roll, 0.95),
        sink_max=float(max(-lowest.min(), 0.0)),
        hover_max=float(lowest[standing].max()) if standing.any() else float("nan"),
        limit_share=float(on_limit.mean()),
        joint_speed_max=float(np.abs(speeds).max()),
        stance_share=float(standing.any(-1).mean()),
    )


def _quantile(values: np.ndarray, q: float) -> float:
    return float(np.quantile(values, q)) if values.size else float("nan")
