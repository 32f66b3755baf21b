"""The walk a walker has in mind: the kinematic gait, led along the path and waiting for the body.

No recorded clip is needed at run time: `models/gait` knows standing, starting, turning, stairs and slopes for
any body. Physics and the policy make it real (residual control, after DReCon, Bergamin et al. 2019).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..body import JOINT_GAINS, JOINT_INDEX, N_SHAPE, Body, describe
from ..body.skeleton import GAIN_REFERENCE_MASS
from ..gait import Command, Gait, flat_ground
from ..gait.footholds import HeightAt
from ..gait.footsteps import stand
from ..gait.leg_ik import Legs
from ..gait.norms import GRAVITY, smoothstep
from ..gait.state import MEASURES, STATE, State, describe_walker
from .manners import Manners
from .path_follower import FollowerLimits, PathFollower
from .swing_dynamics import HINGES, SwingLegs, leg_angles

Array = NDArray[np.float64]

_KNEE_HINGES = [JOINT_INDEX["L_Knee_y"], JOINT_INDEX["R_Knee_y"]]
_KNEE_STIFFNESS = float(JOINT_GAINS[_KNEE_HINGES[0], 0])  # Nm/rad for people of the reference mass
_WEIGHT = GRAVITY * GAIN_REFERENCE_MASS  # N
_UPHILL = 0.1  # rise over run from which knees are stretched in full
_QUICKEST = 120.0  # rad/s^2: fastest change of a leg's swing
_COUNTER = (
    0.6  # share of a swing's hip torque that the standing leg's hip takes; the trunk's inertia has the rest
)
_TAKEN_OVER = 0.2  # share of a swing at its ends over which the leg comes off the ground and on to it
_ON_HEEL, _ON_BALL = -0.08, 0.08  # rad: pitch of a standing foot beyond which ball or heel is off the ground


_OWN = ("root", "joints", "velocity", "rates", "_share", "_support", "_leg_angles", "_leg_rates")


class GaitReference:
    """The poses N people should be in now and one control step from now.

    Args:
        bodies: the N people.
        period: control step, s.
        height_at: ground height (m,), m, at world points (m, 2).
        limits: what followers of paths can do.
        manners: how they keep clear of obstacles and each other.
        body_aware: whether they know their bodies; otherwise they walk as the average body would.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        period: float,
        height_at: HeightAt = flat_ground,
        limits: FollowerLimits | None = None,
        manners: Manners | None = None,
        body_aware: bool = True,
    ):
        count = len(bodies)
        self.period = period
        self.follower = PathFollower(count, limits, manners)
        self.follower.radius = np.array([body.radius for body in bodies])
        self._gait = Gait(height_at)
        self.ground(height_at, manners)
        self._people: State = np.zeros(count, STATE)
        self._people["id"] = np.arange(count)
        for row, body in zip(self._people, bodies, strict=True):
            describe_walker(row, body)
        self._people["reach"] = 0.0  # who is to keep their balance steps where that asks for, edge or not
        self._gait.state = self._people.copy()
        self.root: Array = np.zeros((count, 7))
        """(N, 7) pelvis pose one step ahead, world, m, wxyz."""
        self.joints: Array = np.zeros((count, 69))
        """(N, 69) rad, one step ahead."""
        self.velocity: Array = np.zeros((count, 3))
        """(N, 3) m/s of the pelvis on the way there, world."""
        self.rates: Array = np.zeros((count, 69))
        """(N, 69) rad/s on the way there."""
        self._share: Array = np.full((count, 2), 0.5)
        """(N, 2) of the weight on each leg."""
        self._support: Array = np.zeros((count, 69))
        """(N, 69) rad by which PD targets are beyond the pose, so as to hold it under load."""
        self._average: State | None = None
        if not body_aware:
            average = describe(np.zeros(N_SHAPE))
            bodies, self._average = [average] * count, np.zeros(1, STATE)
            describe_walker(self._average[0], average)
        self._legs = SwingLegs(bodies)
        self._leg_angles: Array = np.zeros((count, 2, 2))
        self._leg_rates: Array = np.zeros((count, 2, 2))

    def ground(self, height_at: HeightAt, manners: Manners | None) -> None:
        """Walk on other ground from here on, with manners that know what stands on it."""
        self._gait.height_at = height_at
        self.follower.height_at = None if height_at is flat_ground else height_at
        self.follower.manners = manners

    def keep(self, rows: NDArray[np.intp]) -> None:
        """Keep people (n,), in that order, and forget the others."""
        follower = self.follower
        self._people, self._gait.state = self._people[rows], self._gait.state[rows]
        self._legs.keep(rows)
        for owner, names in (
            (self, _OWN),
            (follower, ("position", "velocity", "heading", "turn_rate", "radius", "bend")),
        ):
            for name in names:
                setattr(owner, name, getattr(owner, name)[rows])

    def join(self, other: GaitReference) -> None:
        """Put the people of another reference, of the same ground and period, behind these."""
        self._people = np.concatenate([self._people, other._people])
        self._people["id"] = np.arange(len(self._people))
        self._gait.state = np.concatenate([self._gait.state, other._gait.state])
        self._legs.join(other._legs)
        for mine, theirs, names in (
            (self, other, _OWN),
            (
                self.follower,
                other.follower,
                ("position", "velocity", "heading", "turn_rate", "radius", "bend"),
            ),
        ):
            for name in names:
                setattr(mine, name, np.concatenate([getattr(mine, name), getattr(theirs, name)]))

    def targets(self, hinges: NDArray[np.intp], lead: float) -> Array:
        """PD targets (N, H), rad, of hinges (H,) that bring people to the next pose.

        Args:
            hinges: (H,) which exist.
            lead: s by which targets run ahead, so that damping does not hold them back.
        """
        return self.joints[:, hinges] + lead * self.rates[:, hinges] + self._support[:, hinges]

    def _bear(self) -> None:
        """Stretch the knees that carry people uphill, as far as their load would bend them.

        Bent legs sink under their load; the weight of the body times the knee's lever, by the drive's
        stiffness, is how far. On level ground legs are nearly straight, and none of this is needed.
        """
        s = self.steps
        planted = s["planted"].astype(float)
        share = planted / np.maximum(planted.sum(1, keepdims=True), 1.0)
        self._share += 0.5 * (share - self._share)
        legs = Legs(s["thigh"], s["shank"])
        sag = _WEIGHT * self._share * legs.lever(self.joints[:, _KNEE_HINGES]) / _KNEE_STIFFNESS
        self._support[:] = 0.0
        self._support[:, _KNEE_HINGES] = -sag * smoothstep(s["climb"] / _UPHILL)[:, None]

    def _swing(self) -> None:
        """Move legs that are in the air by the torque it takes, rather than by lagging behind."""
        angles = leg_angles(self.root, self.joints)
        rates = (angles - self._leg_angles) / self.period
        accelerations = np.clip((rates - self._leg_rates) / self.period, -_QUICKEST, _QUICKEST)
        progress = self.steps["swing"]
        free = smoothstep(progress / _TAKEN_OVER) * smoothstep((1.0 - progress) / _TAKEN_OVER)
        shifts = self._legs.shifts(angles, rates, accelerations) * free[..., None]
        # What swings one leg forward turns the pelvis back, but for the hip of the leg that stands.
        shifts[..., 0] -= _COUNTER * shifts[:, ::-1, 0] * self.steps["planted"]
        self._support[:, HINGES] += shifts.reshape(len(shifts), 4)
        self._leg_angles, self._leg_rates = angles, rates

    @property
    def preview(self) -> float:
        """How far ahead, s, the path is aimed at."""
        return self.follower.limits.preview

    @property
    def steps(self) -> State:
        """Stride and feet of the N people (`gait.state.STATE`), one step ahead."""
        return self._gait.state

    @property
    def contacts(self) -> NDArray[np.bool_]:
        """Whether heel and ball of left and right foot should stand (N, 2, 2), one step ahead."""
        planted, roll = self.steps["planted"], self.steps["roll"]
        return np.stack([planted & (roll < _ON_BALL), planted & (roll > _ON_HEEL)], -1)

    def place(
        self, ids: NDArray[np.intp], position: Array, heading: Array, speed: Array, phase: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Put people (n,) into mid-stride, or on their feet where the speed is zero.

        Args:
            ids: who.
            position: (n, 2) m, world.
            heading: (n,) rad.
            speed: (n,) m/s.
            phase: (n,) of the stride, [0, 1).

        Returns:
            Root pose (n, 7), joints (n, 69), velocity of the root (n, 6) and rates (n, 69): a pose from which
            physics can take over; the reference itself is one step ahead of it.
        """
        if not len(ids):
            return np.zeros((0, 7)), np.zeros((0, 69)), np.zeros((0, 6)), np.zeros((0, 69))
        part = Gait(self._gait.height_at)
        part.state = self._people[ids].copy()
        part.state["phase"] = phase
        way = np.stack([np.cos(heading), np.sin(heading)], -1)
        step = (speed * self.period)[:, None] * way
        stand(part.state, position - 2.0 * step, heading, speed, part.height_at)
        poses = [
            part.update(Command.of(position + k * step, heading, speed), self.period) for k in (-1, 0, 1)
        ]
        (before, bent), (root, joints), (after, next_joints) = poses
        if self._average is not None:
            for name in MEASURES:
                part.state[name] = self._average[name]
        self._gait.state[ids] = part.state
        self._share[ids], self._support[ids] = 0.5, 0.0
        self.follower.place(ids, position + step, heading, speed)
        self.root[ids], self.joints[ids] = after, next_joints
        self.velocity[ids] = (after[:, :3] - root[:, :3]) / self.period
        self.rates[ids] = (next_joints - joints) / self.period
        self._leg_angles[ids] = leg_angles(after, next_joints)
        self._leg_rates[ids] = (self._leg_angles[ids] - leg_angles(root, joints)) / self.period
        twist = np.zeros((len(ids), 6))
        twist[:, :3] = (root[:, :3] - before[:, :3]) / self.period
        return root, joints, twist, (joints - bent) / self.period

    def advance(self, aims: Array, people: Array, ankles: Array, touching: NDArray[np.bool_]) -> None:
        """Move the reference on by one control step.

        Args:
            aims: (N, 2) m, world: where the path is `preview` from now.
            people: (N, 2) m, world: where the pelvises are.
            ankles: (N, 2, 3) m, world: where the ankles are.
            touching: (N, 2) whether feet touch the ground.
        """
        follower = self.follower
        if follower.height_at is not None:
            self._gait.feel(people, ankles, touching)
        follower.advance(aims, people, self.period)
        command = Command.of(follower.position, follower.heading, follower.speed, follower.turn_rate)
        root, joints = self._gait.update(command, self.period)
        self.velocity = (root[:, :3] - self.root[:, :3]) / self.period
        self.rates = np.clip((joints - self.joints) / self.period, -12.0, 12.0)
        self.root, self.joints = root, joints
        self._bear()
        self._swing()
