"""What the tracker sees: the person's own state, and how the reference ahead differs from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..body import BODY_INDEX, N_BODIES
from ..motion.library import MotionLibrary
from .batch_world import BatchWorld, Ids
from .mathops import heading, to_heading, two_axes, within

Array = NDArray[np.float64]

_KEY_BODIES = [BODY_INDEX[n] for n in ("L_Ankle", "R_Ankle", "L_Wrist", "R_Wrist", "Head")]
_FEET = [BODY_INDEX["L_Ankle"], BODY_INDEX["R_Ankle"]]
_TOUCHING = 0.008  # m above the ground at which a sole point counts as standing
_LIMIT = 8.0  # observations are clipped to this


@dataclass(frozen=True)
class Reference:
    """Which frame of the library each world follows, and what it is told of it."""

    frame: NDArray[np.intp]
    """(N,) now, among all frames of the library."""
    last: NDArray[np.intp]
    """(N,) last frame of the clip."""
    mask: NDArray[np.bool_]
    """(N, 24) bodies that are told."""

    def take(self, ids: NDArray[np.intp]) -> Reference:
        """That of worlds (n,)."""
        return Reference(self.frame[ids], self.last[ids], self.mask[ids])


def sole_heights(world: BatchWorld, ids: Ids, soles: Array) -> Array:
    """Heights (n, 2, 5) of the sole points above z = 0, m.

    Args:
        world: the worlds.
        ids: (n,) of them.
        soles: (K, 2, 5, 3) `Body.sole` of the bodies.
    """
    w, x, y, z = np.moveaxis(world.quaternions[ids][:, _FEET], -1, 0)
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)
    reach = np.einsum("nfk,nfpk->nfp", up, soles[world.body_index[ids]])
    return world.positions[ids][:, _FEET, 2][..., None] + reach


def standing(heights: Array) -> NDArray[np.bool_]:
    """Whether heel and ball stand (n, 2, 2), from sole heights (n, 2, 5)."""
    low = heights < _TOUCHING
    return np.stack([low[..., :2].any(-1), low[..., 2:].any(-1)], -1)


class TrackerObservation:
    """Builds observations (n, size), float32, all in the person's heading frame.

    Own state: pelvis height, rotation (6), velocity and angular velocity; hinge angles and velocities;
    ankles, wrists and head from the pelvis; heights of the sole points and whether heels and balls stand.
    Then, for each frame ahead: pelvis offset, rotation and velocities, its difference of hinge angles and
    joint places (only of bodies that are told), and its contacts. Last the mask.

    Args:
        world: the worlds.
        library: the reference, with the same bodies.
        lookahead: frames ahead; the first is seen in full, the others by their key bodies.
    """

    def __init__(self, world: BatchWorld, library: MotionLibrary, lookahead: tuple[int, ...]):
        self.world = world
        self.library = library
        self.lookahead = lookahead
        self._soles = np.array([body.sole for body in world.bodies])
        self._hinge_body = 1 + world.hinges // 3
        self._joints = np.ascontiguousarray(library.joints[:, :, world.hinges])
        here = np.zeros(1, int)
        probe = Reference(np.zeros(1, int), np.zeros(1, int), np.ones((1, N_BODIES), bool))
        self.size = self.build(here, probe).shape[1]
        """How many numbers an observation has."""

    def build(self, ids: Ids, reference: Reference) -> NDArray[np.float32]:
        """Observations (n, size) of worlds (n,) whose references are given, row by row."""
        world = self.world
        root, qvel = world.qpos[ids, :7], world.qvel[ids]
        quaternion = root[:, 3:]
        way = heading(quaternion)
        positions = world.positions[ids]
        keys = to_heading(way, positions[:, _KEY_BODIES] - root[:, None, :3])
        axes = two_axes(quaternion)
        spin = world.pelvis_spin(ids)
        heights = sole_heights(world, ids, self._soles)
        joints = world.qpos[ids, 7:]
        own = [
            root[:, 2:3],
            to_heading(way, axes[:, :3]),
            to_heading(way, axes[:, 3:]),
            to_heading(way, qvel[:, :3]),
            0.3 * to_heading(way, spin),
            joints,
            0.1 * qvel[:, 6:],
            keys.reshape(len(reference.frame), -1),
            5.0 * np.minimum(heights, 0.3).reshape(len(reference.frame), -1),
            standing(heights).reshape(len(reference.frame), -1),
        ]
        told = [
            part
            for k, ahead in enumerate(self.lookahead)
            for part in self._ahead(ids, reference, ahead, root, way, positions, joints, qvel, spin, k == 0)
        ]
        whole = np.concatenate([*own, *told, reference.mask], axis=1, dtype=np.float32, casting="unsafe")
        return within(whole, _LIMIT)

    def _ahead(
        self,
        ids: Ids,
        reference: Reference,
        ahead: int,
        root: Array,
        way: Array,
        positions: Array,
        joints: Array,
        qvel: Array,
        spin: Array,
        full: bool,
    ) -> list[NDArray]:
        """Differences of the reference `ahead` frames from now."""
        library, body = self.library, self.world.body_index[ids]
        frame = np.minimum(reference.frame + ahead, reference.last)
        twist = library.root_velocity[body, frame]
        states = library.states_at(body, frame)
        pelvis = states[:, 0, :7].astype(float)
        offset = to_heading(way, pelvis[:, :3] - root[:, :3])
        axes = two_axes(pelvis[:, 3:])
        bodies = slice(1, None) if full else _KEY_BODIES
        gap = to_heading(way, states[:, bodies, :3] - positions[:, bodies])
        told = reference.mask[:, bodies, None]
        return [
            np.clip(3.0 * offset, -3.0, 3.0),
            to_heading(way, axes[:, :3]),
            to_heading(way, axes[:, 3:]),
            to_heading(way, twist[:, :3] - qvel[:, :3]),
            0.3 * (to_heading(way, twist[:, 3:] - spin)),
            2.0 * (self._joints[body, frame] - joints) * reference.mask[:, self._hinge_body],
            (3.0 * gap * told).reshape(len(reference.frame), -1),
            library.contacts[frame].reshape(len(reference.frame), -1)
            * np.repeat(reference.mask[:, _FEET], 2, axis=1),
        ]
