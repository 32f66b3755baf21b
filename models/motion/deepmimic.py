"""Reads motions of DeepMimic's 13-link humanoid (JSON; Peng et al. 2018): Y up, facing +X."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from .recording import (
    AXES_FROM_Y_UP_FACING_X,
    MotionFormatError,
    Recording,
    about,
    global_rotations,
    in_our_axes,
)

# Joint, parent, offset (m, Y up, facing +X) and numbers a frame, in the order of a frame: DeepMimic's
# humanoid3d.
_JOINTS = (
    ("root", "", (0.0, 0.0, 0.0), 4),
    ("chest", "root", (0.0, 0.236151, 0.0), 4),
    ("neck", "chest", (0.0, 0.223894, 0.0), 4),
    ("right_hip", "root", (0.0, 0.0, 0.084887), 4),
    ("right_knee", "right_hip", (0.0, -0.421546, 0.0), 1),
    ("right_ankle", "right_knee", (0.0, -0.409870, 0.0), 4),
    ("right_shoulder", "chest", (-0.02405, 0.24350, 0.18311), 4),
    ("right_elbow", "right_shoulder", (0.0, -0.274788, 0.0), 1),
    ("left_hip", "root", (0.0, 0.0, -0.084887), 4),
    ("left_knee", "left_hip", (0.0, -0.421546, 0.0), 1),
    ("left_ankle", "left_knee", (0.0, -0.409870, 0.0), 4),
    ("left_shoulder", "chest", (-0.02405, 0.24350, -0.18311), 4),
    ("left_elbow", "left_shoulder", (0.0, -0.274788, 0.0), 1),
)
# Ends of bones without a joint, so that bones have a direction: wrists, and toes before and below the ankles.
_TIPS = (
    ("right_wrist", "right_elbow", (0.0, -0.258947, 0.0)),
    ("left_wrist", "left_elbow", (0.0, -0.258947, 0.0)),
    ("right_toe", "right_ankle", (0.13, -0.05, 0.0)),
    ("left_toe", "left_ankle", (0.13, -0.05, 0.0)),
)
_WIDTH = 4 + sum(width for *_, width in _JOINTS)


def read_deepmimic(path: Path | str, rate_hz: float = 60.0) -> Recording:
    """Read a DeepMimic motion, brought to a uniform rate: its frames carry durations of their own.

    Raises:
        MotionFormatError: the file is not JSON with rows of 44 numbers under ``Frames``.
    """
    path = Path(path)
    try:
        frames = np.array(json.loads(path.read_text())["Frames"], dtype=float)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise MotionFormatError(
            f"{path} is no DeepMimic motion: it needs rows of numbers under 'Frames'."
        ) from error
    if frames.ndim != 2 or frames.shape[1] != _WIDTH or len(frames) < 2:
        raise MotionFormatError(
            f"{path} has rows of shape {frames.shape[1:]}; DeepMimic's have {_WIDTH} numbers."
        )
    times = np.concatenate([[0.0], np.cumsum(frames[:-1, 0])])  # the last frame's own duration is not used
    if not (np.diff(times) > 0).all():
        raise MotionFormatError(f"{path}: frame durations (the first number of each row) must be positive.")
    wanted = np.arange(int(times[-1] * rate_hz + 1e-6) + 1) / rate_hz

    joints = [name for name, *_ in (*_JOINTS, *_TIPS)]
    parents = tuple(joints.index(parent) if parent else -1 for _, parent, *_ in (*_JOINTS, *_TIPS))
    local = np.tile(np.eye(3), (len(wanted), len(joints), 1, 1))
    column = 4
    for i, (_, _, _, width) in enumerate(_JOINTS):
        values = frames[:, column : column + width]
        column += width
        quaternions = width == 4  # the others, elbows and knees, bend about z
        turns = Rotation.from_quat(values, scalar_first=True) if quaternions else about(2, values[:, 0])
        local[:, i] = Slerp(times, turns)(wanted).as_matrix()
    axes = AXES_FROM_Y_UP_FACING_X
    root = CubicSpline(times, frames[:, 1:4])(wanted)
    root, rotations = in_our_axes(axes, root, global_rotations(local, parents))
    offsets = np.array([offset for _, _, offset, *_ in (*_JOINTS, *_TIPS)]) @ axes.T
    name = path.stem.removeprefix("humanoid3d_")
    return Recording(name, "deepmimic", tuple(joints), parents, offsets, root, rotations, rate_hz)
