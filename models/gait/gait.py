"""A physics-free walk for crowds: roots glide along plans, feet stay where they stand, legs follow by IK.

>>> gait = Gait()
>>> gait.enter([7], [describe(shape_for(1.75, 75.0))], position=[[0, 0]], heading=[0.0], speed=[1.4])
>>> root, joints = gait.update(Command.of(position=[[1.4 / 30, 0]], heading=[0.0], speed=[1.4]), dt=1 / 30)
>>> root.shape, joints.shape
((1, 7), (1, 69))

Everything is vectorised over agents. The root's ground position is the plan's, but for the natural sway.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body import BODY_INDEX, JOINT_LIMITS, Body
from ..body.skeleton import matrix_from_quaternion
from . import footsteps, pose
from .footsteps import HeightAt
from .leg_ik import Legs
from .state import STATE, State, describe_walker

Array = NDArray[np.float64]

_FIRST_LEG_JOINT = tuple(BODY_INDEX[name] - 1 for name in ("L_Hip", "R_Hip"))
_MISPLACED = 0.03  # m above or below where it was meant to stand: a foot farther from there stays where it is
_YIELD = 0.4  # share of what is beyond by which the gait gives way, per update
_TRUSTED = 0.45  # of the stride since its landing until a standing foot's heel may be off the ground
_TELEPORT = 1.0  # m: a root that jumps farther in one update is put there anew


class GaitError(ValueError):
    """A walker that is unknown, entered twice, or commanded with arrays of the wrong shape or non-finite."""


@dataclass(frozen=True)
class Command:
    """What the plan wants of each walker now, in the order of `Gait.ids`."""

    position: Array
    """(n, 2) m, world: where the root is to be, above the ground."""
    heading: Array
    """(n,) rad, world."""
    speed: Array
    """(n,) m/s, forwards."""
    turn_rate: Array
    """(n,) rad/s, left positive."""

    @classmethod
    def of(
        cls, position: ArrayLike, heading: ArrayLike, speed: ArrayLike, turn_rate: ArrayLike | None = None
    ) -> Command:
        """Make a command of anything array-like; without turn rates the walkers go straight."""
        heading = np.asarray(heading, dtype=float)
        turn = np.zeros_like(heading) if turn_rate is None else np.asarray(turn_rate, dtype=float)
        return cls(np.asarray(position, dtype=float), heading, np.asarray(speed, dtype=float), turn)

    def check(self, count: int) -> None:
        """Raise GaitError unless all arrays are finite and made for ``count`` walkers."""
        for name, shape in (
            ("position", (count, 2)),
            ("heading", (count,)),
            ("speed", (count,)),
            ("turn_rate", (count,)),
        ):
            array = getattr(self, name)
            if array.shape != shape:
                raise GaitError(
                    f"The command's {name} has shape {array.shape}; {count} walkers need {shape}."
                )
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                raise GaitError(f"The command's {name} of walker {row} is not finite.")


def flat_ground(xy: Array) -> Array:
    """Height (m,) of level ground at z = 0."""
    return np.zeros(len(xy))


class Gait:
    """Walkers on one ground; `copy` and the bytes of `state` make it replayable."""

    def __init__(self, height_at: HeightAt = flat_ground) -> None:
        """Take the ground: height (m,) in m at world points (m, 2)."""
        self.height_at = height_at
        self.state: State = np.zeros(0, STATE)

    @property
    def ids(self) -> NDArray[np.int64]:
        """(n,) walkers in the order of commands and poses."""
        return self.state["id"].copy()

    def copy(self) -> Gait:
        """Return an independent gait in the same state on the same ground."""
        other = copy.copy(self)
        other.state = self.state.copy()
        return other

    def enter(
        self,
        ids: Sequence[int],
        bodies: Sequence[Body],
        position: ArrayLike,
        heading: ArrayLike,
        speed: ArrayLike | None = None,
    ) -> None:
        """Add walkers behind those present: standing, or in mid-stride where ``speed`` (n,) in m/s says so.

        Raises:
            GaitError: an id is present already or given twice, or the arrays do not fit.
        """
        command = Command.of(position, heading, np.zeros(len(ids)) if speed is None else speed)
        command.check(len(ids))
        if len(bodies) != len(ids):
            raise GaitError(f"{len(ids)} walkers need as many bodies, not {len(bodies)}.")
        taken = set(self.state["id"].tolist())
        for agent in ids:
            if agent in taken:
                raise GaitError(f"Walker {agent} is here already; it cannot enter again.")
            taken.add(agent)
        new = np.zeros(len(ids), STATE)
        new["id"] = ids
        for row, body in zip(new, bodies, strict=True):
            describe_walker(row, body)
        new["phase"] = (new["id"] * 0.6180339887498949) % 1.0  # golden ratio: neighbours out of step
        footsteps.stand(new, command.position, command.heading, command.speed, self.height_at)
        self.state = np.concatenate([self.state, new])

    def leave(self, ids: Sequence[int]) -> None:
        """Remove walkers; the others keep their order.

        Raises:
            GaitError: an id is not here.
        """
        missing = set(ids) - set(self.state["id"].tolist())
        if missing:
            raise GaitError(f"Walker {min(missing)} is not here and cannot leave.")
        self.state = self.state[~np.isin(self.state["id"], list(ids))]

    def update(self, command: Command, dt: float) -> tuple[Array, Array]:
        """Move all walkers on by ``dt`` s.

        Returns:
            Root poses (n, 7), [x y z qw qx qy qz] of the pelvis in the world, m, and joint angles (n, 69)
            in rad, in the order of `skeleton.JOINT_NAMES`, within `skeleton.JOINT_LIMITS`.

        Raises:
            GaitError: the command does not fit the walkers present, or ``dt`` is not positive.
        """
        s = self.state
        command.check(len(s))
        if not dt > 0.0:
            raise GaitError(f"A time step must be positive, not {dt} s.")
        jumped = np.linalg.norm(command.position - s["position"], axis=-1) > _TELEPORT
        if jumped.any():
            rows = s[jumped]
            footsteps.stand(
                rows, command.position[jumped], command.heading[jumped], command.speed[jumped], self.height_at
            )
            s[jumped] = rows
        footsteps.advance(
            s, command.position, command.heading, command.speed, command.turn_rate, dt, self.height_at
        )
        return self._pose(command.heading, dt)

    def feel(self, people: Array, ankles: Array, touching: NDArray[np.bool_]) -> None:
        """Take in where a body is that walks after this gait on uneven ground.

        The ground is felt where the body is rather than where it should be, and a foot that stands on another
        tread than it was meant to stays at that height.

        Args:
            people: (n, 2) m, world: where the body's pelvises are.
            ankles: (n, 2, 3) m, world: where its ankles are.
            touching: (n, 2) whether its feet touch the ground.
        """
        s = self.state
        s["offset"] = people - s["position"]
        error = (ankles - pose.ankle_positions(s, pose.sole_rotation(s["place"])))[..., 2]
        beyond = error - np.clip(error, -_MISPLACED, _MISPLACED)
        stands = s["planted"] & touching & (footsteps.foot_phases(s) < _TRUSTED)
        s["place"][..., 2] += np.where(stands, _YIELD * beyond, 0.0)

    def _pose(self, heading: Array, dt: float) -> tuple[Array, Array]:
        s = self.state
        turn, sway, height = pose.pelvis_motion(s)
        lean = pose.lean(s)
        quaternion = _quaternion(heading + turn[:, 2], turn[:, 0] + lean[:, 0], turn[:, 1] + lean[:, 1])
        rotation = matrix_from_quaternion(quaternion)
        pelvis = np.empty((len(s), 3))
        pelvis[:, 0] = s["position"][:, 0] - sway * np.sin(heading)
        pelvis[:, 1] = s["position"][:, 1] + sway * np.cos(heading)
        pelvis[:, 2] = self._ground_line(heading) + height

        legs = Legs(s["thigh"], s["shank"])
        hip = (rotation[:, None] @ s["hip"][..., None])[..., 0]
        sole = pose.sole_rotation(s["place"])
        pose.fit_legs(s, pelvis, hip, sole, legs, dt)
        legs_angles = pose.solve_legs(s, pelvis, rotation, hip, sole, legs)

        joints = np.zeros((len(s), 23, 3))
        toes = pose.toe_bend(s)
        for side, first in enumerate(_FIRST_LEG_JOINT):
            joints[:, first : first + 3] = legs_angles[:, side]
            joints[:, first + 3, 1] = toes[:, side]
        pose.upper_body(s, turn, lean, joints)
        root = np.concatenate([pelvis, quaternion], axis=-1)
        return root, np.clip(joints.reshape(len(s), 69), JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1])

    def _ground_line(self, heading: Array) -> Array:
        """Ground height (n,) under the root, averaged over a step's length so that stairs are a ramp."""
        s = self.state
        reach = 0.3 + 0.08 * np.minimum(s["speed"], 2.0)
        ahead = reach[:, None] * np.linspace(-1.0, 1.0, 7)
        direction = np.stack([np.cos(heading), np.sin(heading)], -1)
        xy = (s["position"] + s["offset"])[:, None] + ahead[..., None] * direction[:, None]
        return self.height_at(xy.reshape(-1, 2)).reshape(ahead.shape).mean(-1)


def _quaternion(yaw: Array, roll: Array, pitch: Array) -> Array:
    """Unit quaternions (n, 4), wxyz, of a turn about z, then the new x, then the new y."""
    (cz, cx, cy), (sz, sx, sy) = (f(0.5 * np.array([yaw, roll, pitch])) for f in (np.cos, np.sin))
    w, x, y, z = cz * cx, cz * sx, sz * sx, sz * cx
    return np.stack([w * cy - y * sy, x * cy - z * sy, w * sy + y * cy, x * sy + z * cy], -1)
