"""A point that walks after a path the way a person can: it starts, brakes and turns in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..gait.footholds import HeightAt
from .manners import Manners

Array = NDArray[np.float64]

_BEND_TIME = 0.2  # s
_FELT = np.arange(-0.3, 0.91, 0.2)  # m along the way: where the ground's rise is looked at
_CAREFUL = 1.5  # exponent by which a slope, rise over run, slows turns and changes of velocity
_AROUND: Array = np.array([[0.3, 0.0], [-0.3, 0.0], [0.0, 0.3], [0.0, -0.3]])  # m, where slopes are felt
_UPHILL = 2.0  # exponent by which a rise over run, up or down, slows people, in the form of Tobler (1993)


@dataclass(frozen=True)
class FollowerLimits:
    """What a walking person can do."""

    preview: float = 0.5
    """s: the follower aims at where the path is by then."""
    response: float = 0.2
    """s in which it takes on the velocity it wants."""
    acceleration: float = 2.5
    """m/s^2."""
    turn_rate: float = 3.0
    """rad/s."""
    turn_response: float = 0.2
    """s in which it faces where it wants to go."""
    fastest: float = 2.4
    """m/s."""
    sideways: float = 0.4
    """m/s: fastest side and back step."""
    pull: float = 0.15
    """m: the farthest that people are told the path is from the follower."""
    leash: float = 0.25
    """m: how far the person may be from the follower before it comes along."""
    leash_rate: float = 3.0
    """1/s at which the distance beyond the leash closes."""


class PathFollower:
    """N followers.

    Args:
        count: N.
        limits: what they can do.
        manners: how they keep clear of obstacles and each other; left out, they look at nothing but the path.
    """

    def __init__(self, count: int, limits: FollowerLimits | None = None, manners: Manners | None = None):
        self.limits = limits or FollowerLimits()
        self.manners = manners
        self.height_at: HeightAt | None = None
        """Ground height (m,), m, at world points (m, 2); None is level ground."""
        self.radius: Array = np.full(count, 0.3)
        """(N,) m: room that the people need."""
        self.position: Array = np.zeros((count, 2))
        """(N, 2) m, world."""
        self.velocity: Array = np.zeros((count, 2))
        """(N, 2) m/s, world."""
        self.heading: Array = np.zeros(count)
        """(N,) rad."""
        self.turn_rate: Array = np.zeros(count)
        """(N,) rad/s."""
        self.bend: NDArray[np.complex128] = np.ones(count, dtype=complex)
        """(N,) by which ground and manners multiply what is wanted, x + iy."""

    @property
    def speed(self) -> Array:
        """Speed (N,), m/s."""
        return np.linalg.norm(self.velocity, axis=-1)

    def place(self, ids: NDArray[np.intp], position: Array, heading: Array, speed: Array) -> None:
        """Put followers (n,) at positions (n, 2), walking at speeds (n,) along headings (n,)."""
        self.position[ids], self.heading[ids], self.turn_rate[ids] = position, heading, 0.0
        self.bend[ids] = 1.0
        self.velocity[ids] = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)

    def near(self, targets: Array) -> Array:
        """Where people (N, 2), m, are told that their paths are now, so that they follow this point if need be.

        Obstacles and others keep the follower from the path; who then went by the path would run into them. It is
        moved towards the follower until it is no farther than `FollowerLimits.pull` from it.

        Args:
            targets: (N, 2) m, world: where the paths are now.
        """
        gap = self.position - targets
        distance = np.linalg.norm(gap, axis=-1, keepdims=True)
        return targets + gap * np.maximum(1.0 - self.limits.pull / np.maximum(distance, 1e-9), 0.0)

    def told(self, targets: Array, waypoints: Array) -> Array:
        """Waypoints (N, W, 2), m, world, as people are told them: turned and slowed as manners turn and slow now.

        Args:
            targets: (N, 2) m, world: where the paths are now.
            waypoints: (N, W, 2) m, world: where they lead.
        """
        ahead = (waypoints - targets[:, None]) @ np.array([1.0, 1.0j]) * self.bend[:, None]
        return self.near(targets)[:, None] + np.stack([ahead.real, ahead.imag], -1)

    def _bend(self, wanted: Array, chosen: Array, dt: float) -> None:
        """Remember by what factor and angle manners change velocities, smoothed."""
        before, after = wanted @ np.array([1.0, 1.0j]), chosen @ np.array([1.0, 1.0j])
        slow = np.abs(before) < 0.1
        bend = np.where(slow, 1.0, after / np.where(slow, 1.0, before))
        self.bend = self.bend + (bend - self.bend) * min(dt / _BEND_TIME, 1.0)

    def advance(self, aims: Array, people: Array, dt: float) -> None:
        """Walk on for `dt` s.

        Args:
            aims: (N, 2) m, world: where the path is `FollowerLimits.preview` from now.
            people: (N, 2) m, world: where the people are, whom the followers wait for.
            dt: s.
        """
        limits = self.limits
        gap = people - self.position
        distance = np.linalg.norm(gap, axis=-1, keepdims=True)
        beyond = np.maximum(distance - limits.leash, 0.0) / np.maximum(distance, 1e-9)
        self.position = self.position + min(limits.leash_rate * dt, 1.0) * beyond * gap

        wanted = (aims - self.position) / limits.preview
        pace = np.linalg.norm(wanted, axis=-1, keepdims=True)
        wanted *= np.minimum(1.0, limits.fastest / np.maximum(pace, 1e-9))
        chosen = self._unhurried(wanted, people)
        if self.manners:
            bend = self.bend.imag
            chosen = self.manners.choose(chosen, people, self.velocity, self.radius, limits.fastest, bend)
        self._bend(wanted, chosen, dt)
        wanted = chosen
        care = self._care(people)
        self._turn(wanted, care[:, 0], dt)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        ahead = cos * wanted[:, 0] + sin * wanted[:, 1]
        aside = np.clip(cos * wanted[:, 1] - sin * wanted[:, 0], -limits.sideways, limits.sideways)
        ahead = np.maximum(ahead, -limits.sideways)
        able = np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], -1)
        change = (able - self.velocity) * min(dt / limits.response, 1.0)
        size = np.linalg.norm(change, axis=-1, keepdims=True)
        change *= np.minimum(1.0, care * limits.acceleration * dt / np.maximum(size, 1e-9))
        self.velocity = self.velocity + change
        self.position = self.position + self.velocity * dt

    def _unhurried(self, wanted: Array, people: Array) -> Array:
        """Velocities (N, 2), m/s, as fast as the ground that rises or falls ahead lets people walk."""
        if self.height_at is None:
            return wanted
        pace = np.linalg.norm(wanted, axis=-1, keepdims=True)
        way = wanted / np.maximum(pace, 1e-9)
        spots = people[:, None] + way[:, None] * _FELT[:, None]
        heights = self.height_at(spots.reshape(-1, 2)).reshape(len(people), -1)
        slope = np.ptp(heights, axis=1)[:, None] / (_FELT[-1] - _FELT[0])
        return wanted * np.minimum(
            1.0, self.limits.fastest * np.exp(-_UPHILL * slope) / np.maximum(pace, 1e-9)
        )

    def _care(self, people: Array) -> Array:
        """Shares (N, 1) of what people can do on level ground that they dare on the slope they stand on.

        Who turns about on stairs as on a pavement falls; people do not.
        """
        if self.height_at is None:
            return np.ones((len(people), 1))
        heights = self.height_at((people[:, None] + _AROUND).reshape(-1, 2)).reshape(-1, 4)
        slope = np.hypot(heights[:, 0] - heights[:, 1], heights[:, 2] - heights[:, 3]) / np.ptp(_AROUND[:, 0])
        return np.exp(-_CAREFUL * np.minimum(slope, 1.0))[:, None]

    def _turn(self, wanted: Array, care: Array, dt: float) -> None:
        """Face the wanted velocity, the more so the faster it is, with a share (N,) of the usual turn rate."""
        limits = self.limits
        error = np.arctan2(wanted[:, 1], wanted[:, 0]) - self.heading
        error = (error + np.pi) % (2.0 * np.pi) - np.pi
        pace = np.linalg.norm(wanted, axis=-1)
        resolve = np.clip((pace - 0.15) / 0.25, 0.0, 1.0)
        fastest = care * limits.turn_rate
        rate = np.clip(resolve * error / limits.turn_response, -fastest, fastest)
        self.turn_rate = self.turn_rate + (rate - self.turn_rate) * min(dt / 0.08, 1.0)
        self.heading = self.heading + self.turn_rate * dt
