"""One MuJoCo world of many people of different shape among obstacles, kinematic or physical."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body.body import LOWER_LEG_BODIES, Body
from ..body.rotations import rotation_vector
from ..body.skeleton import BODY_INDEX, N_BODIES, N_JOINTS
from .contacts import GROUND, NOBODY, Contacts, read_contacts
from .crowd_model import CrowdModel
from .humanoid import MAX_AGENTS, Actuation, actuated_joints
from .inputs import WorldError, check_agent, checked_agents, checked_array, checked_root
from .pushes import Push, Pushes

if TYPE_CHECKING:
    from ..scene.scene import Obstacle, Terrain

# pyright: reportAttributeAccessIssue=false
# (mujoco names most of its classes at run time only)

__all__ = ["Mode", "World", "WorldError"]

Mode = Literal["kinematic", "physics"]

_FALLEN_PELVIS, _FALLEN_HEAD = 0.55, 0.60  # of the standing heights
_FALL_FORCE = 50.0  # N on the ground (PACER, app. B)
_MAY_PRESS = np.isin(np.arange(N_BODIES), LOWER_LEG_BODIES)
# People in a heap may be pressed into each other faster than 120 Hz can undo; without limits, as PhysX has them
# (64 rad/s), one of them explodes now and then, and the simulator with them. Nobody walks, falls or kicks as fast.
_FASTEST_ROOT, _FASTEST_HINGE = (15.0, 15.0, 15.0, 30.0, 30.0, 30.0), 64.0  # m/s and rad/s; rad/s
_JUDGED = [BODY_INDEX["Pelvis"], BODY_INDEX["Head"]]


class World:
    """N people on a stage; each enters and leaves at will, and while absent costs next to nothing.

    In ``kinematic`` mode people are put where `set_pose` says and MuJoCo finds what touches. In ``physics``
    mode PD actuators pull their joints towards `set_targets`. Both keep one layout of arrays: 24 bodies, 69
    joints (see `skeleton`); in a ``lite`` physics world the joints that do not exist stay at zero. The same
    calls give the same bytes.

    Args:
        bodies: the N people who may enter.
        obstacles: vertical prisms; a non-convex outline is cut into convex pieces.
        terrain: ground heights; None is flat ground at z = 0.
        mode: ``kinematic`` or ``physics``.
        actuation: ``full`` or ``lite``; a kinematic world is always full.
        timestep: physics step, s.

    Raises:
        WorldError: no or too many people, an unknown mode, or no positive time step.
        ObstacleError: an obstacle's outline is not a simple polygon.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        obstacles: Sequence[Obstacle] = (),
        terrain: Terrain | None = None,
        *,
        mode: Mode = "kinematic",
        actuation: Actuation = "full",
        timestep: float = 1 / 120,
    ):
        if not 0 < len(bodies) <= MAX_AGENTS:
            raise WorldError(f"A world holds 1 to {MAX_AGENTS} people, not {len(bodies)}.")
        if mode not in ("kinematic", "physics"):
            raise WorldError(f"The mode is either 'kinematic' or 'physics', not {mode!r}.")
        self.bodies = tuple(bodies)
        self.obstacles = tuple(obstacles)
        self.terrain = terrain
        self.mode: Mode = mode
        self.timestep = timestep
        self._physics = mode == "physics"
        actuation = actuation if self._physics else "full"
        self._hinges = actuated_joints(actuation)
        self._fastest = np.array([*_FASTEST_ROOT, *[_FASTEST_HINGE] * len(self._hinges)])
        self._crowd = CrowdModel(
            bodies, obstacles, terrain, powered=self._physics, actuation=actuation, timestep=timestep
        )
        self._next = self._crowd.qpos.copy()
        self._states = np.zeros((len(bodies), N_BODIES, 13))
        self._present = np.zeros(len(bodies), dtype=bool)
        self._pushes = Pushes()
        self._standing = np.array([[b.pelvis_height, b.measurements.head_height] for b in bodies])

    @property
    def present(self) -> NDArray[np.bool_]:
        """(N,) bool: who is in the world."""
        return self._present.copy()

    def enter(
        self,
        agent: int,
        root: ArrayLike,
        joints: ArrayLike,
        root_velocity: ArrayLike | None = None,
        joint_velocities: ArrayLike | None = None,
    ) -> None:
        """Put a person into the world.

        Args:
            agent: index into `bodies`.
            root: pelvis pose (7,), world, [x y z qw qx qy qz], m.
            joints: hinge angles (69,), rad; in physics also the first PD targets.
            root_velocity: the pelvis' linear m/s and angular rad/s velocity (6,), world; default zero.
            joint_velocities: (69,) rad/s; default zero.

        Raises:
            WorldError: no such person, already there, or malformed numbers.
        """
        check_agent(agent, self._present, False)
        joints = checked_array("joints", joints, N_JOINTS)
        pose = np.append(checked_root(np.asarray(root)[None], 1)[0], joints[self._hinges])
        twist = checked_array("root_velocity", root_velocity, 6)
        rates = checked_array("joint_velocities", joint_velocities, N_JOINTS)

        crowd = self._crowd
        crowd.qpos[agent] = self._next[agent] = pose
        spin = np.empty(3)  # MuJoCo keeps the pelvis' angular velocity in the pelvis' frame
        mujoco.mju_rotVecQuat(spin, twist[3:], pose[3:7] * [1, -1, -1, -1])
        crowd.qvel[agent] = np.concatenate([twist[:3], spin, rates[self._hinges]])
        if self._physics:
            crowd.ctrl[agent] = joints[self._hinges]
        crowd.set_solid(agent, True)
        self._present[agent] = True
        self._read_poses()
        self._read_velocities([agent])

    def leave(self, agent: int) -> None:
        """Take a person out of the world.

        Raises:
            WorldError: no such person, or not there.
        """
        check_agent(agent, self._present, True)
        self._crowd.park(agent)
        self._next[agent] = self._crowd.parked[agent]
        self._pushes.cancel(agent)
        self._present[agent] = False
        self._read_poses()

    def set_pose(self, agents: ArrayLike, root: ArrayLike, joints: ArrayLike) -> None:
        """Say where people will be after the next `advance` (kinematic mode).

        Args:
            agents: (n,) indices of people who are there.
            root: (n, 7) pelvis poses, world, [x y z qw qx qy qz], m.
            joints: (n, 69) hinge angles, rad.

        Raises:
            WorldError: a physics world, someone absent, or malformed numbers.
        """
        if self._physics:
            raise WorldError(
                "set_pose needs a kinematic world; in a physics world people move by set_targets."
            )
        ids = checked_agents(agents, self._present)
        joints = checked_array("joints", joints, len(ids), N_JOINTS)
        self._next[ids] = np.concatenate([checked_root(root, len(ids)), joints[:, self._hinges]], axis=1)

    def set_targets(self, agents: ArrayLike, joints: ArrayLike) -> None:
        """Set the angles (n, 69), rad, that the joints of people (n,) are pulled to (physics mode).

        Raises:
            WorldError: a kinematic world, someone absent, or malformed numbers.
        """
        if not self._physics:
            raise WorldError(
                "set_targets needs a physics world; in a kinematic world people move by set_pose."
            )
        ids = checked_agents(agents, self._present)
        self._crowd.ctrl[ids] = checked_array("joints", joints, len(ids), N_JOINTS)[:, self._hinges]

    def push(self, agent: int, force: ArrayLike, duration: float, part: str = "Chest") -> None:
        """Push a body part with a force (3,), N, world, for the next `duration` s (physics mode).

        Raises:
            WorldError: a kinematic world, someone absent, an unknown part, or malformed numbers.
        """
        if not self._physics:
            raise WorldError("Only people in a physics world can be pushed; this one is kinematic.")
        check_agent(agent, self._present, True)
        if part not in BODY_INDEX:
            raise WorldError(f"There is no body part {part!r}; the parts are {', '.join(BODY_INDEX)}.")
        self._pushes.add(
            Push(agent, BODY_INDEX[part], checked_array("force", force, 3), self._steps(duration))
        )

    def set_obstacle(self, index: int, there: bool) -> None:
        """Make an obstacle solid, or let everybody pass through it; all are solid at first.

        Raises:
            WorldError: no such obstacle.
        """
        if not 0 <= index < len(self.obstacles):
            raise WorldError(f"There is no obstacle {index}; the world has {len(self.obstacles)}.")
        self._crowd.set_obstacle(index, there)

    def advance(self, dt: float) -> None:
        """Let `dt` seconds pass; in physics mode a whole number of time steps.

        Raises:
            WorldError: `dt` is not positive or not a whole number of steps, or the physics became unstable.
        """
        model, data = self._crowd.model, self._crowd.data
        if self._physics:
            for _ in range(self._steps(dt)):
                self._pushes.apply(self._crowd.wrench)
                mujoco.mj_step(model, data)
                np.clip(self._crowd.qvel, -self._fastest, self._fastest, out=self._crowd.qvel)
            if not np.isfinite(data.qacc).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                raise WorldError("The physics became unstable: use a smaller timestep or milder targets.")
            self._read_poses()
            self._read_velocities(slice(None))
            return
        if not (np.isfinite(dt) and dt > 0):
            raise WorldError(f"Time advances by a positive number of seconds, not {dt}.")
        before = self._states[..., :7].copy()
        self._crowd.qvel[:, 6:] = (self._next[:, 7:] - self._crowd.qpos[:, 7:]) / dt
        self._crowd.qpos[:] = self._next
        self._read_poses()
        self._states[..., 7:10] = (self._states[..., :3] - before[..., :3]) / dt
        self._states[..., 10:13] = rotation_vector(self._states[..., 3:7], before[..., 3:7]) / dt
        mujoco.mj_collision(model, data)

    def height_at(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Ground height (...,) m at world points (..., 2) m."""
        xy = np.asarray(xy, dtype=float)
        return np.zeros(xy.shape[:-1]) if self.terrain is None else self.terrain.height_at(xy)

    def joint_states(self, agents: ArrayLike) -> NDArray[np.float32]:
        """State (n, 24, 13) of the bodies of people (n,), world frame.

        Position of the joint that carries the body (3, m), rotation (4, wxyz), velocity of that point
        (3, m/s), angular velocity (3, rad/s).

        Raises:
            WorldError: someone absent.
        """
        return self._states[checked_agents(agents, self._present)].astype(np.float32)

    def joint_angles(self, agents: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Hinge angles, rad, and velocities, rad/s, of people (n,): two arrays (n, 69).

        Raises:
            WorldError: someone absent.
        """
        ids = checked_agents(agents, self._present)
        angles, rates = np.zeros((2, len(ids), N_JOINTS))
        angles[:, self._hinges] = self._crowd.qpos[ids, 7:]
        rates[:, self._hinges] = self._crowd.qvel[ids, 6:]
        return angles, rates

    def contacts(self) -> Contacts:
        """Return what touches; in physics mode as solved in the last time step."""
        crowd = self._crowd
        touch = read_contacts(crowd.model, crowd.data, crowd.geom_obstacle, forces=self._physics)
        gone = ~self._present[touch.agent] | ((touch.other != NOBODY) & ~self._present[touch.other])
        return touch.select(~gone) if gone.any() else touch

    def fallen(self, agents: ArrayLike) -> NDArray[np.bool_]:
        """Whether people (n,) have fallen.

        True when pelvis or head is low above the ground for that person's size, or when parts other than feet
        and shanks press on the ground with more than 50 N.

        Raises:
            WorldError: someone absent.
        """
        ids = checked_agents(agents, self._present)
        joints = self._states[ids][:, _JUDGED, :3]
        height = joints[..., 2] - self.height_at(joints[..., :2])
        low = (height < self._standing[ids] * [_FALLEN_PELVIS, _FALLEN_HEAD]).any(axis=1)
        touch = self.contacts()
        lying = (touch.other == NOBODY) & (touch.other_part == GROUND) & ~_MAY_PRESS[touch.part]
        load = np.bincount(touch.agent[lying], touch.force[lying], minlength=len(self.bodies))
        return low | (load[ids] > _FALL_FORCE)

    def _read_poses(self) -> None:
        mujoco.mj_kinematics(self._crowd.model, self._crowd.data)
        self._states[..., :3] = self._crowd.xpos
        self._states[..., 3:7] = self._crowd.xquat

    def _read_velocities(self, agents: slice | list[int]) -> None:
        """Take velocities from MuJoCo's, which are about the centre of mass of each person."""
        crowd = self._crowd
        mujoco.mj_comPos(crowd.model, crowd.data)
        mujoco.mj_comVel(crowd.model, crowd.data)
        spin, linear = crowd.cvel[agents, :, :3], crowd.cvel[agents, :, 3:]
        self._states[agents, :, 7:10] = linear + np.cross(spin, crowd.xpos[agents] - crowd.centre[agents])
        self._states[agents, :, 10:13] = spin

    def _steps(self, dt: float) -> int:
        steps = round(dt / self.timestep) if np.isfinite(dt) else 0
        if steps < 1 or abs(steps * self.timestep - dt) > 1e-6:
            raise WorldError(f"{dt} s is not a whole number of physics steps of {self.timestep:.6g} s.")
        return steps
