"""What the gait remembers of each walker: one structured array, a row an agent, left foot before right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..body.body import BODY_INDEX, Body

State = NDArray[Any]

_REACH = 0.15  # m
MEASURES = ("hip", "thigh", "shank", "toe", "heel", "tip", "pelvis_height")
"""Fields that tell the body."""

STATE = np.dtype(
    [
        ("id", "i8"),
        # Body, zero pose: m.
        ("hip", "f8", (2, 3)),  # pelvis to hip
        ("thigh", "f8", (2, 3)),  # hip to knee
        ("shank", "f8", (2, 3)),  # knee to ankle
        ("toe", "f8", (2, 3)),  # ankle to toe joint
        ("heel", "f8", (2, 3)),  # ankle to the heel's middle, on the sole
        ("tip", "f8", (2, 3)),  # ankle to the toe's tip, on the sole
        ("pelvis_height", "f8"),
        ("reach", "f8"),  # m by which feet may be shifted so as to stand on one tread
        # Motion of the root.
        ("position", "f8", (2,)),  # world, m
        ("velocity", "f8", (2,)),  # world, m/s, smoothed
        ("acceleration", "f8"),  # along the way, m/s^2, smoothed
        ("turn_rate", "f8"),  # rad/s, smoothed
        ("speed", "f8"),  # m/s, smoothed
        ("grade", "f8"),  # steepness of the way ahead, smoothed
        ("climb", "f8"),  # the same with its sign: > 0 uphill
        ("offset", "f8", (2,)),  # m, world: from the root to a body that walks after it; ground is felt there
        ("time", "f8"),  # s since entering
        # Rhythm.
        ("phase", "f8"),  # of the stride, [0, 1), 0 at the left heel strike
        ("held", "?"),  # both feet stand and no step is due
        ("crouch", "f8"),  # m the pelvis is below where it would like to be
        ("vigour", "f8"),  # 0 standing, 1 at a free walk
        # Feet: the place of a flat foot is the point of the sole below the ankle, x y z yaw pitch roll.
        ("planted", "?", (2,)),
        ("swing", "f8", (2,)),  # progress of the swing, [0, 1]
        ("place", "f8", (2, 6)),
        ("left_from", "f8", (2, 6)),  # place at the last toe-off
        ("target", "f8", (2, 6)),  # place of the next landing
        ("shift", "f8", (2,)),  # m forward, chosen to keep the foot on one tread
        ("aside", "f8", (2,)),  # m outwards, chosen to keep the foot off an edge beside it
        ("goal", "f8", (2, 3)),  # (x, y, yaw) the foot stands for, before it was shifted
        ("roll_off", "f8", (2,)),  # pitch at the last toe-off, rad
        ("landing", "f8", (2,)),  # pitch at the last or next landing, rad
        ("roll", "f8", (2,)),  # pitch now, rad: > 0 on the ball, < 0 on the heel
    ]
)


def describe_walker(row: np.void, body: Body) -> None:
    """Write the body's measures into one row."""
    heel, tip = body.sole[:, :2].mean(1), body.sole[:, 4]
    for side, prefix in enumerate(("L_", "R_")):
        for field, joint in (("hip", "Hip"), ("thigh", "Knee"), ("shank", "Ankle"), ("toe", "Toe")):
            row[field][side] = body.offsets[BODY_INDEX[prefix + joint]]
        row["heel"][side], row["tip"][side] = heel[side], tip[side]
    row["pelvis_height"], row["reach"] = body.pelvis_height, _REACH
