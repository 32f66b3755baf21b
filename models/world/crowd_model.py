"""Compiles a crowd and its stage into one MuJoCo model, with a view per person into its arrays."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from ..body.body import Body
from ..body.skeleton import N_BODIES
from .contacts import GROUND
from .humanoid import Actuation, add_humanoid, agent_mask
from .inputs import WorldError
from .stage import add_ground, add_obstacles

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

_PARKING = np.array([0.0, 3.0, -100.0])  # m; the absent lie in a row far below the ground
_SLEEP = mujoco.mjtSleepPolicy
_CROWDED = 50  # people from whom on a second thread for collisions and islands gains more than it costs


class CrowdModel:
    """A compiled world of N people, all parked: weightless, untouchable and, in physics, asleep.

    The static body comes first, then 24 bodies for each person, so each of MuJoCo's arrays has a view of
    shape (N, ...).

    Args:
        bodies: the N people.
        obstacles: vertical prisms.
        terrain: ground heights, or None for flat ground at z = 0.
        powered: whether joints have PD actuators and people may sleep.
        actuation: which hinges exist.
        timestep: physics step, s.

    Raises:
        WorldError: the time step is not positive.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        obstacles: Sequence[Obstacle],
        terrain: Terrain | None,
        *,
        powered: bool,
        actuation: Actuation,
        timestep: float,
    ):
        spec = _options(len(bodies), powered, timestep)
        add_ground(spec, terrain)
        pieces = add_obstacles(spec, obstacles, terrain)
        for i, body in enumerate(bodies):
            add_humanoid(spec, body, f"{i}_", actuation, agent_mask(i), powered=powered)
            pelvis = spec.body(f"{i}_Pelvis")
            pelvis.pos = _PARKING * [1, i + 1, 1]
            if powered:
                pelvis.sleep = _SLEEP.mjSLEEP_INIT
        for part in spec.bodies[1:]:
            part.gravcomp = 1.0
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        if powered and len(bodies) >= _CROWDED and (os.cpu_count() or 1) > 1:
            mujoco.mju_threadpool(self.data, 1)  # beside the caller's; the same bytes come out
        self.n_obstacles = len(pieces)
        self.geom_obstacle = np.full(self.model.ngeom, GROUND, dtype=np.intp)
        for i, geoms in enumerate(pieces):
            self.geom_obstacle[[geom.id for geom in geoms]] = i
        self._view(len(bodies), powered)
        for i in range(len(bodies)):
            self.set_solid(i, False)

    def _view(self, n: int, powered: bool) -> None:
        model, data = self.model, self.data
        self._powered = powered
        self._geoms = np.array_split(np.flatnonzero(model.geom_bodyid > 0), n)
        self._masks = model.geom_contype.copy(), model.geom_conaffinity.copy()
        self._body_masks = model.body_contype.copy(), model.body_conaffinity.copy()
        self.qpos = data.qpos.reshape(n, -1)
        self.qvel = data.qvel.reshape(n, -1)
        self.ctrl = data.ctrl.reshape(n, -1)
        self.warmstart = data.qacc_warmstart.reshape(n, -1)
        self.wrench = data.xfrc_applied[1:].reshape(n, N_BODIES, 6)
        self.xpos = data.xpos[1:].reshape(n, N_BODIES, 3)
        self.xquat = data.xquat[1:].reshape(n, N_BODIES, 4)
        self.cvel = data.cvel[1:].reshape(n, N_BODIES, 6)
        self.centre = data.subtree_com[1:].reshape(n, N_BODIES, 3)[:, :1]
        self.parked = self.qpos.copy()

    def set_solid(self, agent: int, solid: bool) -> None:
        """Let a person weigh and touch, or park them: at rest without weight they fall asleep."""
        model, geoms, first = self.model, self._geoms[agent], 1 + agent * N_BODIES
        bodies = slice(first, first + N_BODIES)
        model.geom_contype[geoms] = self._masks[0][geoms] if solid else 0
        model.geom_conaffinity[geoms] = self._masks[1][geoms] if solid else 0
        model.body_contype[bodies] = self._body_masks[0][bodies] if solid else 0
        model.body_conaffinity[bodies] = self._body_masks[1][bodies] if solid else 0
        model.body_gravcomp[bodies] = 0.0 if solid else 1.0
        if self._powered:
            model.tree_sleep_policy[agent] = _SLEEP.mjSLEEP_NEVER if solid else _SLEEP.mjSLEEP_ALLOWED

    def park(self, agent: int) -> None:
        """Put a person back into the parking place."""
        self.qpos[agent] = self.parked[agent]
        for array in (self.qvel, self.ctrl, self.warmstart, self.wrench):
            array[agent] = 0.0
        self.set_solid(agent, False)

    def set_obstacle(self, index: int, there: bool) -> None:
        """Make an obstacle solid or let everybody pass through it."""
        geoms = np.flatnonzero(self.geom_obstacle == index)
        self.model.geom_contype[geoms] = self._masks[0][geoms] if there else 0


def _options(n: int, powered: bool, timestep: float) -> mujoco.MjSpec:
    if not timestep > 0:
        raise WorldError(f"The physics step must be positive, not {timestep} s.")
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.memory = (64 + 2 * n) << 20
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # Newton stops when it has converged, after 5 iterations on average; cut off at that number, a heap of limbs on
    # the ground explodes now and then.
    option.iterations, option.ls_iterations = 30, 10
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if powered:
        option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        option.sleep_tolerance = 1e-9  # only the parked, weightless and at rest, are ever this slow
    return spec
