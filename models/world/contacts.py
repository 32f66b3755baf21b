"""Who touches whom and what: MuJoCo's contacts, in terms of people, body parts and obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..body.skeleton import N_BODIES

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

GROUND = -1
"""Stands for the ground in `Contacts.other_part`."""
NOBODY = -1
"""Stands for the ground or an obstacle in `Contacts.other`."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """K touching pairs, each listed once; of two people the lower number comes first."""

    agent: NDArray[np.intp]
    """(K,) the person."""
    part: NDArray[np.intp]
    """(K,) which of their 24 bodies."""
    other: NDArray[np.intp]
    """(K,) the other person, or `NOBODY`."""
    other_part: NDArray[np.intp]
    """(K,) the other person's body; for `NOBODY` the obstacle's index, or `GROUND`."""
    position: NDArray[np.float64]
    """(K, 3) m, world: midway between the surfaces."""
    normal: NDArray[np.float64]
    """(K, 3) unit, world: from the other towards the person."""
    distance: NDArray[np.float64]
    """(K,) m: negative where the surfaces overlap."""
    force: NDArray[np.float64]
    """(K,) N: normal force; zero in a kinematic world."""

    def __len__(self) -> int:
        return len(self.agent)

    def select(self, keep: NDArray[np.bool_]) -> Contacts:
        """Return the contacts marked in `keep` (K,)."""
        return Contacts(*(getattr(self, name)[keep] for name in self.__slots__))


def read_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, geom_obstacle: NDArray[np.intp], forces: bool
) -> Contacts:
    """Translate the contacts of a world whose bodies are the static one, then 24 for each person.

    Args:
        model: the compiled world.
        data: its state after collision detection (and, with `forces`, after the constraint solver).
        geom_obstacle: (ngeom,) obstacle index of each static geom, or `GROUND`.
        forces: whether contact forces have been solved for.
    """
    found = data.contact
    geoms = np.array(found.geom, dtype=np.intp).reshape(-1, 2)
    body = model.geom_bodyid[geoms].astype(np.intp) - 1  # (K, 2); -1 is the static body
    swap = (body[:, 0] < 0) | ((body[:, 1] >= 0) & (body[:, 1] < body[:, 0]))
    geoms[swap] = geoms[swap, ::-1]
    body[swap] = body[swap, ::-1]
    static = body[:, 1] < 0
    # MuJoCo's normal points from the first geom to the second.
    normal = np.array(found.frame, dtype=float).reshape(-1, 9)[:, :3] * np.where(swap, 1.0, -1.0)[:, None]
    force = _normal_forces(found, data.efc_force) if forces else np.zeros(len(geoms))
    return Contacts(
        agent=body[:, 0] // N_BODIES,
        part=body[:, 0] % N_BODIES,
        other=np.where(static, NOBODY, body[:, 1] // N_BODIES),
        other_part=np.where(static, geom_obstacle[geoms[:, 1]], body[:, 1] % N_BODIES),
        position=np.array(found.pos, dtype=float).reshape(-1, 3),
        normal=normal,
        distance=np.array(found.dist, dtype=float),
        force=force,
    )


def _normal_forces(found: Any, efc_force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normal force of each contact: with pyramidal friction, the sum over the pyramid's edges."""
    address = np.array(found.efc_address, dtype=np.intp)
    dim = np.array(found.dim, dtype=np.intp)
    edges = np.where(dim == 1, 1, 2 * (dim - 1)) * (address >= 0)
    force = np.zeros(len(address))
    for edge in range(int(edges.max(initial=0))):
        active = edge < edges
        force[active] += efc_force[address[active] + edge]
    return force
