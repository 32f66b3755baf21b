"""What the walker sees, from plain arrays: the same code in training and in a running crowd."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..body import BODY_INDEX, Body
from ..gait.footholds import HeightAt
from ..motion.clip import MIRROR_JOINTS, MIRROR_SIGNS
from .gait_reference import GaitReference
from .hinges import hinges_from_states
from .mathops import heading, rotate, to_heading, two_axes, within

Array = NDArray[np.float64]

KEY_BODIES = [BODY_INDEX[n] for n in ("L_Ankle", "R_Ankle", "L_Wrist", "R_Wrist", "Head")]
FEET = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
TOUCHING = 0.008
"""m above the ground at which a sole point counts as standing."""
LIMIT = 8.0
"""Observations are clipped to this."""


@dataclass(frozen=True)
class People:
    """How N people are built, as arrays."""

    soles: Array
    """(N, 2, 5, 3) m: `Body.sole`."""
    shape: Array
    """(N, 12): the shape vector, stature and mass, each about unit size."""
    pelvis_height: Array
    """(N,) m, standing."""
    head_height: Array
    """(N,) m, standing."""
    mass: Array
    """(N,) kg."""

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> People:
        """Arrays of bodies."""
        sizes = [[*b.shape, (b.stature - 1.7) / 0.1, (b.mass - 75.0) / 15.0] for b in bodies]
        return cls(
            np.array([b.sole for b in bodies]),
            np.array(sizes),
            np.array([b.pelvis_height for b in bodies]),
            np.array([b.measurements.head_height for b in bodies]),
            np.array([b.mass for b in bodies]),
        )

    def take(self, rows: NDArray[np.intp]) -> People:
        """Those of people (n,)."""
        return People(*(getattr(self, field.name)[rows] for field in fields(self)))

    def join(self, other: People) -> People:
        """These, and the others behind them."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return People(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Motion:
    """How N people are and move; world frame, SI."""

    positions: Array
    """(N, 24, 3) m."""
    quaternions: Array
    """(N, 24, 4) wxyz."""
    velocity: Array
    """(N, 3) m/s, of the pelvis."""
    spin: Array
    """(N, 3) rad/s, of the pelvis."""
    joints: Array
    """(N, H) rad, of the actuated hinges."""
    rates: Array
    """(N, H) rad/s."""

    @classmethod
    def of_states(cls, states: ArrayLike, hinges: NDArray[np.intp]) -> Motion:
        """That of body states (N, 24, 13), keeping the hinges (H,) that exist."""
        states = np.asarray(states, dtype=float)
        angles, rates = hinges_from_states(states)
        return cls(
            states[..., :3],
            states[..., 3:7],
            states[:, 0, 7:10],
            states[:, 0, 10:13],
            angles[:, hinges],
            rates[:, hinges],
        )

    def take(self, rows: NDArray[np.intp]) -> Motion:
        """That of people (n,)."""
        return Motion(*(getattr(self, field.name)[rows] for field in fields(self)))

    def sole_points(self, soles: Array) -> Array:
        """World places (N, 2, 5, 3) of the sole points, m."""
        turned = np.broadcast_to(self.quaternions[:, FEET, None], (*soles.shape[:-1], 4))
        return self.positions[:, FEET, None] + rotate(turned, soles)


def clearance(points: Array, height_at: HeightAt) -> Array:
    """Heights (...) of points (..., 3) above the ground, m."""
    return points[..., 2] - height_at(points[..., :2].reshape(-1, 2)).reshape(points.shape[:-1])


def standing(clear: Array) -> NDArray[np.bool_]:
    """Whether heel and ball stand (N, 2, 2), from the sole points' clearances (N, 2, 5)."""
    low = clear < TOUCHING
    return np.stack([low[..., :2].any(-1), low[..., 2:].any(-1)], -1)


def touching(clear: Array) -> NDArray[np.bool_]:
    """Whether feet (N, 2) touch the ground, from the sole points' clearances (N, 2, 5)."""
    return np.asarray((clear < TOUCHING).any(-1))


def observe(
    motion: Motion,
    people: People,
    reference: GaitReference,
    waypoints: Array,
    clear: Array,
    hinges: NDArray[np.intp],
    body_aware: bool = True,
    maps: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Observations (N, size), in each person's heading frame.

    Own state: pelvis height above the feet, rotation (6), velocity, spin; hinge angles and rates; ankles,
    wrists and head from the pelvis; clearance of the sole points, which of them stand. The body's shape. The
    reference, one step ahead: phase, feet, footholds, and how pelvis and hinges differ from it. Last the
    waypoints, so that a critic can be asked about other plans (`WAYPOINTS`).

    Args:
        motion: of N people.
        people: their bodies.
        reference: their gaits.
        waypoints: (N, 10, 2) m, world: the path from 0.5 s to 5 s ahead.
        clear: (N, 2, 5) `clearance` of the sole points, m.
        hinges: (H,) which hinges exist.
        body_aware: whether to tell the shape; zeros otherwise.
        maps: (N, cells, cells, 3) of the surroundings, if they are seen.
    """
    count = len(motion.positions)
    pelvis, quaternion = motion.positions[:, 0], motion.quaternions[:, 0]
    way = heading(quaternion)
    axes = two_axes(quaternion)
    keys = to_heading(way, motion.positions[:, KEY_BODIES] - pelvis[:, None])
    lowest = motion.positions[:, FEET, 2].min(1)
    steps = reference.steps
    cycle = 2.0 * np.pi * steps["phase"]
    vigour = steps["vigour"]
    feet = to_heading(way, np.concatenate([steps["place"], steps["target"]], 1)[..., :3] - pelvis[:, None])
    there = two_axes(reference.root[:, 3:])
    ahead = to_heading(way, waypoints - pelvis[:, None, :2])
    whole = np.concatenate(
        [
            (pelvis[:, 2] - lowest)[:, None],
            to_heading(way, axes[:, :3]),
            to_heading(way, axes[:, 3:]),
            to_heading(way, motion.velocity),
            0.3 * to_heading(way, motion.spin),
            motion.joints,
            0.1 * motion.rates,
            keys.reshape(count, -1),
            5.0 * np.clip(clear, -0.3, 0.3).reshape(count, -1),
            standing(clear).reshape(count, -1),
            people.shape if body_aware else np.zeros_like(people.shape),
            (np.sin(cycle) * vigour)[:, None],
            (np.cos(cycle) * vigour)[:, None],
            vigour[:, None],
            steps["held"][:, None],
            steps["planted"],
            steps["swing"],
            feet.reshape(count, -1),
            np.clip(3.0 * to_heading(way, reference.root[:, :3] - pelvis), -3.0, 3.0),
            to_heading(way, there[:, :3]),
            to_heading(way, there[:, 3:]),
            to_heading(way, reference.velocity),
            reference.follower.turn_rate[:, None],
            2.0 * (reference.joints[:, hinges] - motion.joints),
            0.1 * reference.rates[:, hinges],
            np.zeros((count, 0)) if maps is None else (maps * MAP_SCALES).reshape(count, -1),
            ahead.reshape(count, -1),
        ],
        axis=1,
        dtype=np.float32,
        casting="unsafe",
    )
    return within(whole, LIMIT)


MAP_SCALES: NDArray[np.float32] = np.array([5.0, 0.5, 0.5], dtype=np.float32)
"""Factors of the maps' heights and velocities: 5 is PACER's."""
WAYPOINTS = slice(-20, None)
"""Columns of the observation that hold the waypoints, x y each, m, heading frame."""


def driven_hinges(hinges: NDArray[np.intp], arms: bool) -> NDArray[np.intp]:
    """Which (A,) of the hinges (H,) actions shift: all, or all but those of the arms."""
    return np.flatnonzero(arms | (1 + hinges // 3 <= BODY_INDEX["Head"]))


class Mirror:
    """Left and right exchanged, in observations and in what the hinges are told.

    A walker whose right foot leads is shown to the policy in a mirror, so that it only ever learns one half
    of the stride and both halves are the same (phase-based mirroring, Abdolhosseini et al. 2019).

    Args:
        hinges: (H,) which of the 69 hinges exist.
        driven: (A,) which of those H an action shifts; all when left out.
        cells: along each side of the maps; 0 without.
    """

    def __init__(self, hinges: NDArray[np.intp], driven: NDArray[np.intp] | None = None, cells: int = 0):
        place = np.full(len(MIRROR_JOINTS), -1)
        place[hinges] = np.arange(len(hinges))
        self.hinges: NDArray[np.intp] = place[MIRROR_JOINTS[hinges]]
        """(H,) counterpart of each hinge."""
        self.signs: Array = MIRROR_SIGNS[hinges]
        """(H,) sign its angle takes."""
        driven = np.arange(len(hinges)) if driven is None else driven
        self._actions = np.searchsorted(driven, self.hinges[driven])
        self._action_signs = self.signs[driven]
        polar, axial = [1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]  # vectors, and turns
        count = len(hinges)
        parts: list[tuple[Sequence[int] | NDArray[np.intp], Sequence[float] | Array]] = [
            ([0], [1.0]),
            *[(range(3), polar)] * 3,
            (range(3), axial),
            *[(self.hinges, self.signs)] * 2,
            (_swapped([1, 0, 3, 2, 4], 3), polar * 5),
            (_swapped([1, 0], 5), [1.0] * 10),
            (_swapped([1, 0], 2), [1.0] * 4),
            (range(12), [1.0] * 12),
            (range(4), [-1.0, -1.0, 1.0, 1.0]),
            ([1, 0], [1.0] * 2),
            ([1, 0], [1.0] * 2),
            (_swapped([1, 0, 3, 2], 3), polar * 4),
            *[(range(3), polar)] * 4,
            ([0], [-1.0]),
            *[(self.hinges, self.signs)] * 2,
            (_swapped_map(cells), [1.0, 1.0, -1.0] * cells**2),
            (range(20), [1.0, -1.0] * 10),
        ]
        starts = np.cumsum([0] + [len(signs) for _, signs in parts])
        self.columns: NDArray[np.intp] = np.concatenate(
            [
                start + np.asarray(order, dtype=np.intp)
                for start, (order, _) in zip(starts, parts, strict=False)
            ]
        )
        """(size,) counterpart of each column of an observation."""
        self.column_signs: NDArray[np.float32] = np.concatenate([signs for _, signs in parts]).astype(
            np.float32
        )
        """(size,) sign it takes."""
        assert len(self.columns) == starts[-1] and len(self.hinges) == count

    def observations(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mirror images of observations (n, size)."""
        return observations[:, self.columns] * self.column_signs

    def actions(self, actions: NDArray) -> NDArray:
        """Mirror images of actions (n, A)."""
        return actions[:, self._actions] * self._action_signs


def _swapped(order: list[int], width: int) -> NDArray[np.intp]:
    """Columns of groups of `width` in another order."""
    return (width * np.array(order)[:, None] + np.arange(width)).ravel()


def _swapped_map(cells: int) -> NDArray[np.intp]:
    """Columns of a map (cells, cells, 3) whose second axis runs from right to left, mirrored."""
    return np.arange(3 * cells**2).reshape(cells, cells, 3)[:, ::-1].ravel()
