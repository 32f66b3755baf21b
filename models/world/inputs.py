"""Checks what callers hand to a `World`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class WorldError(ValueError):
    """A call the world cannot obey: an unknown or absent person, a malformed array, the wrong mode."""


def checked_array(name: str, value: ArrayLike | None, *shape: int) -> NDArray[np.float64]:
    """Return `value` as finite numbers of that shape; None stands for zeros.

    Raises:
        WorldError: another shape, or a number that is not finite.
    """
    array = np.zeros(shape) if value is None else np.asarray(value, dtype=float)
    if array.shape != shape:
        raise WorldError(f"{name} has shape {array.shape}; it must be {shape}.")
    if not np.isfinite(array).all():
        raise WorldError(f"{name} holds a number that is not finite.")
    return array


def checked_root(value: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return pelvis poses (count, 7), [x y z qw qx qy qz], with their quaternions normalised.

    Raises:
        WorldError: malformed numbers, or a quaternion whose length is off by more than 0.001.
    """
    root = checked_array("root", value, count, 7)
    norm = np.linalg.norm(root[:, 3:], axis=1, keepdims=True)
    if (abs(norm - 1) > 1e-3).any():
        worst = float(norm[np.argmax(abs(norm - 1))][0])
        raise WorldError(f"A root's rotation is a unit quaternion wxyz, but one has length {worst:.4g}.")
    return np.concatenate([root[:, :3], root[:, 3:] / norm], axis=1)


def check_agent(agent: int, present: NDArray[np.bool_], wanted: bool) -> None:
    """Make sure that a person exists and is in the world, or is not.

    Raises:
        WorldError: no such person, or already there, or not there.
    """
    if not 0 <= agent < len(present):
        raise WorldError(f"There is no person {agent}; the world knows 0 to {len(present) - 1}.")
    if present[agent] != wanted:
        raise WorldError(f"Person {agent} is {'not' if wanted else 'already'} in the world.")


def checked_agents(agents: ArrayLike, present: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the indices (n,) of people who are all in the world.

    Raises:
        WorldError: not a list of integers, a repeated one, or someone unknown or absent.
    """
    ids = np.asarray(agents)
    if ids.shape == (0,):
        return ids.astype(np.intp)
    if ids.ndim != 1 or not np.issubdtype(ids.dtype, np.integer):
        raise WorldError(f"People are named by a list of integers, not by {ids.dtype} of shape {ids.shape}.")
    if len(np.unique(ids)) != len(ids):
        raise WorldError("A person is named twice in one call.")
    known = (ids >= 0) & (ids < len(present))
    if not known.all() or not present[ids].all():
        for agent in ids:
            check_agent(int(agent), present, True)
    return ids.astype(np.intp)
