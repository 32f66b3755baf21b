"""Who stops in a plan: who hardly moves any more, and who would walk into an obstacle."""

from dataclasses import replace

import numpy as np
import torch

from ..models.crowd.planning import PLAN_DT
from ..models.trace.scene_map import SceneMaps
from ..models.trace.scene_planner import TraceFutures

STILL = 0.25
"""Who moves no further than this, for `STANDS` at least, stands [m]."""
STANDS = 1.0
"""[s]."""
BRAKING = 2.0
"""At which people stop in time [m/s^2]."""
GRAZE = 0.01
"""Of a body in an obstacle is no reason to stop [m]."""


def settled(futures: TraceFutures, now: np.ndarray, still: float = STILL) -> TraceFutures:
    """Futures in which who hardly moves any more stands.

    From the first state on that is no further than `still` [m] from the middle of the last `STANDS`, as all between
    are, nobody moves, if that is so long before the end: samples of a person who waits tremble, and a body that
    follows them would shuffle.

    Args:
        futures: (A, S, T).
        now: (A, 4) states before the first one.
        still: [m].
    """
    count, samples = futures.speeds.shape[:2]
    first = np.broadcast_to(now[:, None, None, :], (count, samples, 1, 4))
    rest = [futures.positions, futures.headings[..., None], futures.speeds[..., None]]
    states = np.concatenate([first, np.concatenate(rest, axis=-1)], axis=2)  # (A, S, 1 + T, 4)
    while_standing = round(STANDS / PLAN_DT)
    end = states[..., -while_standing:, :2].mean(axis=2, keepdims=True)
    far = np.linalg.norm(states[..., :2] - end, axis=-1) > still
    steps = np.arange(states.shape[2])
    arrival = np.where(far, steps + 1, 0).max(axis=2)[..., None]  # (A, S, 1)
    arrival = np.where(arrival > steps[-1] - while_standing, steps[-1], arrival)
    index = np.minimum(steps, arrival)[..., None]
    held = np.take_along_axis(states, np.broadcast_to(index, states.shape), axis=2)[:, :, 1:]
    speeds = np.where(steps[1:] > arrival, 0.0, held[..., 3])
    return replace(futures, positions=held[..., :2], headings=held[..., 2], speeds=speeds)


def halted(
    futures: TraceFutures, now: np.ndarray, maps: SceneMaps | None, radius: np.ndarray, heeds: np.ndarray
) -> TraceFutures:
    """Futures in which who would walk into an obstacle stops before it, on the same way.

    Guidance leads round obstacles, but not where the way leads round the other side and there is no more room to
    turn. Who stands can turn on the spot, and the next plan leads on. Who is in an obstacle may leave it.

    Args:
        futures: (A, S, T).
        now: (A, 4) states before the first one.
        maps: Distances from obstacles; without them nobody stops.
        radius: (A,) of the bodies [m].
        heeds: (A,) whether obstacles are to be avoided at all.

    Returns:
        The futures; their losses are still those of what was planned.
    """
    count, samples, steps = futures.speeds.shape
    if maps is None or not count:
        return futures
    first = np.broadcast_to(now[:, None, None, :2], (count, samples, 1, 2))
    places = np.concatenate([first, futures.positions], axis=2)  # (A, S, 1 + T, 2)
    points = torch.from_numpy(places.reshape(1, -1, 2).astype(np.float32))
    room = maps.layer("obstacle").sample(points, torch.zeros(1, dtype=torch.long))
    room = room.numpy().reshape(places.shape[:3]) - radius[:, None, None]
    inside = (room < np.minimum(room[..., :1], 0.0) - GRAZE) & heeds[:, None, None]
    if not inside.any():
        return futures
    positions, headings, speeds = (a.copy() for a in (futures.positions, futures.headings, futures.speeds))
    for agent, sample in np.argwhere(inside.any(axis=2)):
        way = places[agent, sample]
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum()])
        end = along[inside[agent, sample].argmax() - 1]
        marks, here = np.empty(steps), 0.0
        for step, wanted in enumerate(speeds[agent, sample]):
            in_time = BRAKING * (np.sqrt(PLAN_DT**2 + 2.0 * (end - here) / BRAKING) - PLAN_DT)
            here = marks[step] = min(here + min(wanted, in_time) * PLAN_DT, end)
        turns = np.unwrap(np.concatenate([now[agent, 2:3], headings[agent, sample]]))
        for axis in range(2):
            positions[agent, sample, :, axis] = np.interp(marks, along, way[:, axis])
        headings[agent, sample] = np.interp(marks, along, turns)
        speeds[agent, sample] = np.diff(marks, prepend=0.0) / PLAN_DT
    return replace(futures, positions=positions, headings=headings, speeds=speeds)
