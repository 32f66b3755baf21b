"""A synthetic straight walk, for benches and tests that have no recordings at hand."""

from __future__ import annotations

import numpy as np

from ..body import BODY_INDEX, LITE_JOINTS, Body, forward_kinematics
from ..gait.gait import Command, Gait
from .clip import Clip
from .feet import FootMotion, find_contacts

_WARM_UP = 2.0  # s the gait takes to find its rhythm


def walk_cycle(body: Body, speed: float, duration: float = 4.0, rate_hz: float = 30.0) -> Clip:
    """Return a straight walk at `speed`, m/s, made by the kinematic gait; hinges of the lite body only."""
    gait = Gait()
    gait.enter([0], [body], position=[[0.0, 0.0]], heading=[0.0], speed=[speed])
    roots, poses = [], []
    for k in range(1, round((_WARM_UP + duration) * rate_hz) + 1):
        position = [[speed * k / rate_hz, 0.0]]
        root, joints = gait.update(Command.of(position=position, heading=[0.0], speed=[speed]), 1 / rate_hz)
        roots.append(root[0])
        poses.append(joints[0])
    first = round(_WARM_UP * rate_hz)
    root, joints = np.array(roots)[first:], np.array(poses)[first:] * LITE_JOINTS
    positions, rotations = forward_kinematics(body.offsets, root, joints)
    ankles = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
    contacts = find_contacts(FootMotion(positions[:, ankles], rotations[:, ankles]).soles(body), rate_hz)
    return Clip(f"walk_{speed:.1f}", rate_hz, root, joints, contacts, {"source": "gait"}).centred()
