"""What people are asked in messages, as objectives of TRACE."""

import logging
from dataclasses import dataclass, field

import numpy as np
import torch

from ..models.crowd.planning import PLAN_DT, PLAN_STEPS
from ..models.crowd.routes import Routes
from ..models.trace.objectives import Objective
from .planner_moment import Moment

log = logging.getLogger(__name__)

TOLERANCE = 0.1
"""Nobody is held closer to a timed way than this [m]."""
PUNCTUAL = 0.9
"""Urgency of who has a time of arrival."""
ROOM = 0.1
"""Kept from obstacles beyond all margins, so that what guidance leaves over is no touch [m]."""
STANDING = 0.25
"""Who is slower can turn on the spot [m/s]; and does so for a way that is longer than this [m]."""
TURN_STEPS = 10
"""Points of the way that one looks ahead for it."""
HURRY = 1.3
"""Fastest speed over the one asked, to make way or to catch up."""
HORIZON = PLAN_DT * PLAN_STEPS


@dataclass
class Surroundings:
    """Ways around what stands in the way, and how far the map reaches."""

    routes: Routes
    low: np.ndarray
    """(2,) lower left corner [m]."""
    high: np.ndarray
    """(2,) upper right corner [m]."""
    told: set[tuple[float, float]] = field(default_factory=set)
    """Goals outside the map that have been complained about."""


def objectives_of(
    moment: Moment, way: np.ndarray, slack: np.ndarray, surroundings: Surroundings, margin: float
) -> list[Objective]:
    """Objectives of everybody; the last to correct a future is the avoidance of obstacles.

    Goals are followed along the shortest way, timed by the walking speed, since a straight line may lead through
    a house; urgency says how far one may lag behind (eq 15, 18). Within the horizon a time of arrival is exact.

    Args:
        moment: Everybody and what they are asked.
        way: (N, T, 2) and
        slack: (N, T) of `timed_way` [m].
        surroundings: Of the map.
        margin: Added to every body's radius [m].
    """
    asked, weights = moment.asked, moment.asked.weights
    if not len(moment.ids):
        return []
    _complain(moment, surroundings)
    pull = np.where(asked.aimless, 0.0, _or_one(weights["Waypoint"]))
    wishes = [Objective("follow", {"way": _tensor(way), "slack": _tensor(slack)}, _tensor(pull))]
    if (due := (asked.at <= HORIZON) & (weights["Waypoint"] > 0)).any():
        goal = np.where(due[:, None], np.clip(asked.goal, surroundings.low, surroundings.high), np.nan)
        timed = {"goal": _tensor(goal), "time": _tensor(np.where(due, asked.at, np.nan))}
        wishes.append(Objective("waypoint_at", timed, _tensor(np.nan_to_num(weights["Waypoint"]))))
    if (paced := asked.aimless & (weights["TargetSpeed"] > 0)).any():
        speed = {"speed": _tensor(np.where(paced, asked.speed, np.nan))}
        wishes.append(Objective("target_speed", speed, _tensor(np.nan_to_num(weights["TargetSpeed"]))))
    if (weights["MinimumSpeed"] > 0).any():
        least = {"speed": _tensor(asked.minimum)}
        wishes.append(Objective("minimum_speed", least, _tensor(np.nan_to_num(weights["MinimumSpeed"]))))
    if asked.groups:
        wishes.append(_together(moment))
    fastest = HURRY * np.maximum(asked.speed, np.nan_to_num(asked.minimum))
    wishes.append(Objective("maximum_speed", {"speed": _tensor(np.maximum(fastest, 0.3))}))
    gap = {"buffer": _tensor(asked.gap + 2 * margin)}
    wishes.append(Objective("agent_avoid", gap, _tensor(_or_one(weights["SocialDistance"]))))
    room = {"buffer": _tensor(asked.margin + margin + ROOM)}
    wishes.append(Objective("obstacle_avoid", room, _tensor(_or_one(weights["ObstacleAvoidance"]))))
    return wishes


def timed_way(moment: Moment, routes: Routes) -> tuple[np.ndarray, np.ndarray]:
    """Where everybody would be, walking the shortest way at their speed, and how far they may be from there.

    Returns:
        (N, T, 2) and (N, T), both in m.
    """
    asked, here = moment.asked, moment.states[:, :2].copy()
    points = np.empty((len(here), PLAN_STEPS, 2))
    if not len(here):
        return points, points[..., 0]
    follow = routes.follow(here, asked.goal)
    for step in range(PLAN_STEPS):
        here = here + follow(here, asked.speed) * PLAN_DT
        points[:, step] = here
    steps = np.diff(np.concatenate([moment.states[:, None, :2], points], axis=1), axis=1)
    walked = np.linalg.norm(steps, axis=-1).cumsum(axis=1)
    urgency = np.where(np.isfinite(asked.at), PUNCTUAL, asked.urgency)
    least = (urgency * asked.speed)[:, None] * PLAN_DT * np.arange(1, PLAN_STEPS + 1)
    return points, np.maximum(walked - least, TOLERANCE)


def facing_the_way(states: np.ndarray, way: np.ndarray) -> np.ndarray:
    """States (N, 4) in which who stands faces where the way (N, T, 2) leads.

    People turn on the spot, a unicycle at rest does not: without this nobody would ever walk back.
    """
    arm = way[:, TURN_STEPS - 1] - states[:, :2]
    turns = (states[:, 3] < STANDING) & (np.linalg.norm(arm, axis=1) > STANDING)
    turned = states.copy()
    turned[turns, 2] = np.arctan2(arm[turns, 1], arm[turns, 0])
    return turned


def _together(moment: Moment) -> Objective:
    """Social groups; who is in none walks alone."""
    ids = moment.ids.tolist()
    group, weight = np.full(len(ids), -1), np.zeros(len(ids))
    distance, cohesion = np.ones(len(ids)), np.zeros(len(ids))
    leader = np.zeros(len(ids), bool)
    for number, social in enumerate(moment.asked.groups):
        rows = np.isin(moment.ids, social.members)
        group[rows], weight[rows] = number, social.weight
        distance[rows], cohesion[rows] = social.distance, social.cohesion
        leader |= moment.ids == social.leader
    parameters = {
        "group": torch.from_numpy(group),
        "distance": _tensor(distance),
        "cohesion": _tensor(cohesion),
        "leader": torch.from_numpy(leader),
    }
    return Objective("social_group", parameters, _tensor(weight))


def _complain(moment: Moment, surroundings: Surroundings) -> None:
    """Say once of each goal that it is outside the map; people go as near as they can."""
    asked, low, high = moment.asked, surroundings.low, surroundings.high
    outside = ((asked.goal < low) | (asked.goal > high)).any(axis=1) & (asked.weights["Waypoint"] > 0)
    for row in np.flatnonzero(outside):
        x, y = (float(v) for v in asked.goal[row])
        if (x, y) not in surroundings.told:
            surroundings.told.add((x, y))
            log.warning(
                "the waypoint of person %d, (%.1f, %.1f), lies outside the map, which reaches from (%.1f, %.1f) "
                "to (%.1f, %.1f); the nearest place that can be reached is taken",
                *(moment.ids[row], x, y, *low, *high),
            )


def _or_one(weight: np.ndarray) -> np.ndarray:
    """Weights; 1 where nothing was said."""
    return np.nan_to_num(weight, nan=1.0)


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
