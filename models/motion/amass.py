"""Reads AMASS motions: npz of SMPL pose parameters (Mahmood et al. 2019); needs no body model."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from scipy.spatial.transform import Rotation

from ..body import BODY_INDEX, Body
from .recording import AXES_FROM_Y_UP_FACING_Z, MotionFormatError, Recording, global_rotations

SMPL_JOINTS: tuple[str, ...] = tuple(
    [
        "Pelvis",
        "L_Hip",
        "R_Hip",
        "Torso",
        "L_Knee",
        "R_Knee",
        "Spine",
        "L_Ankle",
        "R_Ankle",
        "Chest",
        "L_Toe",
        "R_Toe",
        "Neck",
        "L_Thorax",
        "R_Thorax",
        "Head",
        "L_Shoulder",
        "R_Shoulder",
        "L_Elbow",
        "R_Elbow",
        "L_Wrist",
        "R_Wrist",
    ]
)
"""SMPL's joints in SMPL's order, under the names of `skeleton.BODY_NAMES`."""
_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)


def read_amass(path: Path | str, body: Body) -> Recording:
    """Read SMPL pose parameters: axis-angle rotations of 22 body joints (fingers are left out).

    The bone lengths of the recorded person are not in the file but in the body model; those of `body` stand
    in, so that joint rotations carry over as they are.

    Args:
        path: npz with ``poses`` (T, 66 or more), ``trans`` (T, 3) and ``mocap_framerate`` (or
            ``mocap_frame_rate``).
        body: the person whose proportions stand in.

    Raises:
        MotionFormatError: the file lacks one of these or they have the wrong shape.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            rate_key = "mocap_framerate" if "mocap_framerate" in file else "mocap_frame_rate"
            poses, trans, rate = file["poses"], file["trans"], float(file[rate_key])
    except (KeyError, ValueError, BadZipFile, EOFError, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise MotionFormatError(
            f"{path} is no AMASS motion: it needs poses, trans and mocap_framerate ({error})."
        ) from error
    if poses.ndim != 2 or poses.shape[1] < 66 or trans.shape != (len(poses), 3) or not rate > 0:
        raise MotionFormatError(
            f"{path}: poses have shape {poses.shape} and trans {trans.shape}; "
            "(T, 66 or more) and (T, 3) are needed."
        )
    axes = AXES_FROM_Y_UP_FACING_Z
    local = Rotation.from_rotvec(poses[:, :66].reshape(-1, 3)).as_matrix().reshape(-1, 22, 3, 3)
    local = axes @ local @ axes.T
    local[:, 0] = axes.T @ local[:, 0]  # AMASS' world is z up already: only the body's own axes change
    places = body.zero_positions[[BODY_INDEX[name] for name in SMPL_JOINTS]]
    offsets = places - places[list(_PARENTS)]
    offsets[0] = 0.0
    return Recording(
        path.stem,
        "smpl",
        SMPL_JOINTS,
        _PARENTS,
        offsets,
        trans.astype(float),
        global_rotations(local, _PARENTS),
        rate,
    )
