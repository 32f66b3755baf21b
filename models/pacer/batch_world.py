"""Many independent physics worlds with one person each, stepped together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from ..body import BODY_NAMES, LOWER_LEG_BODIES, N_BODIES, N_JOINTS, Body
from ..world.humanoid import GROUND_BIT, Actuation, actuated_joints, add_humanoid
from ..world.stage import add_ground
from .mathops import cross, rotate, rotate_back

if TYPE_CHECKING:
    from ..scene import Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

Array = NDArray[np.float64]


Ids = NDArray[np.intp] | slice
"""Which worlds: their numbers (n,), or a slice, which copies nothing."""
EVERYONE = slice(None)


class BatchWorldError(ValueError):
    """A batch of worlds that cannot be built."""


@dataclass(frozen=True)
class Physics:
    """How the worlds are simulated."""

    actuation: Actuation = "lite"
    timestep: float = 1 / 120
    """s."""
    substeps: int = 4
    """Physics steps per control step: 30 Hz control, as PACER (app. B)."""
    iterations: int = 6
    """Most iterations of the constraint solver, which has mostly converged by then; with 3, feet slide on slopes."""
    threads: int = 2

    @property
    def control_period(self) -> float:
        """Time between two control steps, s."""
        return self.timestep * self.substeps


class BatchWorld:
    """N worlds, world ``i`` holding the person ``bodies[i % K]`` on the same ground.

    Only legs below the knee touch the ground: who would touch it with anything else has fallen, and looking for
    that takes a fifth of the time on terrain.

    All arrays are (N, ...) and those of the state are live: they are MuJoCo's own and change with each step.

    Args:
        bodies: the K people.
        worlds: N.
        physics: how to simulate.
        terrain: ground heights; None is flat ground at z = 0.

    Raises:
        BatchWorldError: no body, no world, or no positive time step.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        worlds: int,
        physics: Physics | None = None,
        terrain: Terrain | None = None,
    ):
        self.physics = physics or Physics()
        if not bodies or worlds < 1:
            raise BatchWorldError(f"{worlds} worlds of {len(bodies)} bodies: at least one of each is needed.")
        if not self.physics.timestep > 0 or self.physics.substeps < 1:
            raise BatchWorldError("The time step must be positive and the substeps at least 1.")
        self.bodies = tuple(bodies)
        self.body_index: NDArray[np.intp] = np.arange(worlds) % len(bodies)
        """(N,) which of the bodies each world holds."""
        self.hinges = actuated_joints(self.physics.actuation)
        """(H,) which of the 69 hinges exist."""
        models = [_compile(body, self.physics, terrain) for body in bodies]
        self._batch = Batch(models[0], worlds, self.physics.threads)
        if len(bodies) > 1:
            self._batch.set_models([models[i] for i in self.body_index])
        self.qpos: Array = self._batch.qpos
        """(N, 7 + H): root pose, then hinge angles."""
        self.qvel: Array = self._batch.qvel
        """(N, 6 + H): the root's velocity, linear in the world and angular in its own frame, then hinges'."""
        self.forces: Array = self._batch.xfrc_applied
        """(N, 25, 6): forces, N, and torques on each body, world; the static body first. They stay until changed."""
        self._ctrl = self._batch.ctrl
        self._xpos = self._batch.bind("xpos")
        self._xquat = self._batch.bind("xquat")
        self._cvel = self._batch.bind("cvel")
        self._centre = self._batch.bind("subtree_com")
        self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def positions(self) -> Array:
        """(N, 24, 3) m, world: joints that carry the bodies."""
        return self._xpos[:, 1:]

    @property
    def quaternions(self) -> Array:
        """(N, 24, 4) wxyz, world."""
        return self._xquat[:, 1:]

    @property
    def joints(self) -> Array:
        """(N, H) rad."""
        return self.qpos[:, 7:]

    @property
    def joint_velocities(self) -> Array:
        """(N, H) rad/s."""
        return self.qvel[:, 6:]

    def velocities(self) -> tuple[Array, Array]:
        """Linear m/s and angular rad/s velocities (N, 24, 3) of the bodies' joints, world."""
        spin, linear = self._cvel[:, 1:, :3], self._cvel[:, 1:, 3:]
        arm = self._xpos[:, 1:] - self._centre[:, 1:2]
        return linear + cross(spin, arm), spin

    def pelvis_spin(self, ids: Ids) -> Array:
        """Angular velocity (n, 3) of the pelvis of worlds (n,), rad/s, world."""
        return rotate(self.qpos[ids, 3:7], self.qvel[ids, 3:6])

    def reset(
        self, ids: ArrayLike, root: ArrayLike, joints: ArrayLike, root_velocity: ArrayLike, rates: ArrayLike
    ) -> None:
        """Put the people of worlds (n,) into poses.

        Args:
            ids: worlds.
            root: (n, 7) pelvis pose, world, [x y z qw qx qy qz], m.
            joints: (n, 69) rad; those that do not exist are ignored.
            root_velocity: (n, 6) linear m/s and angular rad/s, world.
            rates: (n, 69) rad/s.
        """
        ids = np.asarray(ids, dtype=np.int32)
        if not len(ids):
            return
        root, twist = np.asarray(root, dtype=float), np.asarray(root_velocity, dtype=float)
        joints, rates = np.asarray(joints, dtype=float), np.asarray(rates, dtype=float)
        if joints.shape != (len(ids), N_JOINTS) or root.shape != (len(ids), 7):
            raise BatchWorldError(f"{len(ids)} worlds need roots (n, 7) and joints (n, {N_JOINTS}).")
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self.qpos[ids] = np.concatenate([root, joints[:, self.hinges]], axis=1)
        spin = rotate_back(root[:, 3:], twist[:, 3:])
        self.qvel[ids] = np.concatenate([twist[:, :3], spin, rates[:, self.hinges]], axis=1)
        self._ctrl[ids] = joints[:, self.hinges]
        self._batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def step(self, targets: Array) -> None:
        """Pull the hinges towards angles (N, H), rad, for one control step."""
        self._ctrl[:] = targets
        self._batch.step(nstep=self.physics.substeps, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def step_bare(self, targets: Array) -> None:
        """As `step`, but positions and velocities of the bodies are left one physics step behind."""
        self._ctrl[:] = targets
        self._batch.step(nstep=self.physics.substeps)


def _compile(body: Body, physics: Physics, terrain: Terrain | None) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.memory = 4 << 20
    option = spec.option
    option.timestep = physics.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.iterations, option.ls_iterations = physics.iterations, 10
    add_ground(spec, terrain)
    add_humanoid(spec, body, actuation=physics.actuation)
    for i, name in enumerate(BODY_NAMES):
        if i not in LOWER_LEG_BODIES:
            for geom in spec.body(name).geoms:
                geom.conaffinity &= ~GROUND_BIT
    model = spec.compile()
    assert model.nbody == N_BODIES + 1
    return model
