"""What a planning method sees: everybody and what they are asked, as arrays; and the place."""

from dataclasses import dataclass, replace

import numpy as np

from ..messages.agents import AgentStates
from ..messages.map import SemanticMap
from ..messages.objectives import (
    MinimumSpeed,
    Objectives,
    ObstacleAvoidance,
    SocialDistance,
    SocialGroup,
    TargetSpeed,
    Waypoint,
)
from ..models.crowd.orca_planner import Place
from ..models.crowd.planning import PLAN_DT, Crowd
from ..models.scene import ROAD_COST

DEFAULT_SPEED = 1.34
"""Free walking speed where no objective names one [m/s] (Weidmann 1993)."""


@dataclass(frozen=True)
class Asked:
    """What N people are asked; a row each."""

    goal: np.ndarray
    """(N, 2) world [m]; who has none wants to be where they are."""
    at: np.ndarray
    """(N,) time left until they are to be at the goal [s]; infinite for any time."""
    urgency: np.ndarray
    """(N,) 0 strolls, 1 hurries."""
    speed: np.ndarray
    """(N,) walking speed [m/s]."""
    minimum: np.ndarray
    """(N,) least speed [m/s]; NaN for none."""
    gap: np.ndarray
    """(N,) to keep between bodies [m]."""
    margin: np.ndarray
    """(N,) to keep from obstacles [m]."""
    aimless: np.ndarray
    """(N,) true for who is to walk at a speed, with nowhere to go."""
    weights: dict[str, np.ndarray]
    """(N,) by type of objective; NaN where it is not asked."""
    groups: list[SocialGroup]
    """Who walks together."""


@dataclass(frozen=True)
class Moment:
    """N pedestrians now."""

    now: float
    """Simulation time [s]."""
    ids: np.ndarray
    """(N,)."""
    states: np.ndarray
    """(N, 4) world x, y [m], heading [rad], speed [m/s], where plans begin."""
    history: np.ndarray
    """(N, 31, 7) the past as it was seen; see `STATE_COLUMNS`."""
    radius: np.ndarray
    """(N,) disc of the body [m]."""
    asked: Asked

    def crowd(self, margin: float) -> Crowd:
        """The same for planners that know no past; `margin` is added to the bodies [m]."""
        heading, asked = self.states[:, 2], self.asked
        group = np.full(len(self.ids), -1)
        for social in asked.groups:
            group[np.isin(self.ids, social.members)] = social.id
        return Crowd(
            position=self.states[:, :2],
            velocity=self.states[:, 3:] * np.column_stack([np.cos(heading), np.sin(heading)]),
            heading=heading,
            radius=self.radius + margin + asked.gap / 2,
            goal=asked.goal,
            speed=asked.speed,
            group=group,
        )


def moment_of(
    agents: AgentStates, radii: dict[int, float], objectives: Objectives, now: float, starts: np.ndarray
) -> Moment:
    """Put together what everybody is asked.

    Args:
        agents: Who is there.
        radii: Of the bodies [m], by id.
        objectives: Everybody's.
        now: Simulation time [s].
        starts: (N, 4) states in which plans begin.
    """
    ids = agents.ids.tolist()
    own = np.array([radii[agent] for agent in ids]).reshape(len(ids))
    asked = _asked(ids, starts[:, :2], objectives, now)
    return Moment(now, agents.ids, starts, agents.history.astype(np.float64), own, asked)


def _asked(ids: list[int], here: np.ndarray, objectives: Objectives, now: float) -> Asked:
    count = len(ids)
    kinds = (Waypoint, TargetSpeed, MinimumSpeed, SocialDistance, ObstacleAvoidance)
    asked = Asked(
        goal=here.copy(),
        at=np.full(count, np.inf),
        urgency=np.full(count, Waypoint((0, 0)).urgency),
        speed=np.full(count, DEFAULT_SPEED),
        minimum=np.full(count, np.nan),
        gap=np.zeros(count),
        margin=np.zeros(count),
        aimless=np.zeros(count, bool),
        weights={kind.__name__: np.full(count, np.nan) for kind in kinds},
        groups=objectives.groups,
    )
    wishes = {wish.id: wish.objectives for wish in objectives.agents}
    for row, agent in enumerate(ids):
        for wish in wishes.get(agent, ()):
            asked.weights[type(wish).__name__][row] = wish.weight
            match wish:
                case TargetSpeed() if wish.weight:
                    asked.speed[row] = wish.speed
                case MinimumSpeed():
                    asked.minimum[row] = wish.speed
                case SocialDistance():
                    asked.gap[row] = wish.gap
                case ObstacleAvoidance():
                    asked.margin[row] = wish.margin
                case Waypoint() if wish.weight:
                    asked.goal[row], asked.urgency[row] = wish.position, wish.urgency
                    if wish.at is not None:
                        asked.at[row] = max(wish.at - now, PLAN_DT)
    timed = np.isfinite(asked.at)
    distance = np.linalg.norm(asked.goal - here, axis=1)
    asked.speed[timed] = distance[timed] / asked.at[timed]
    paced = (asked.weights["TargetSpeed"] > 0) & (asked.speed > 0)
    walks = paced | ((asked.weights["MinimumSpeed"] > 0) & (asked.minimum > 0))
    return replace(asked, aimless=walks & ~(asked.weights["Waypoint"] > 0))


def place_of(semantic_map: SemanticMap) -> Place:
    """What a map means for somebody who looks for a way."""
    layers = {name: layer > 0 for name, layer in zip(semantic_map.layers, semantic_map.raster, strict=True)}
    cost = np.ones(semantic_map.raster.shape[1:])
    if "road" in layers:
        crosswalk = layers.get("crosswalk", np.zeros_like(layers["road"]))
        cost[layers["road"] & ~crosswalk] = ROAD_COST
    return Place(
        blocked=blocked_of(semantic_map),
        cost=cost,
        resolution=semantic_map.resolution,
        origin=semantic_map.origin,
        obstacles=[np.array(obstacle.polygon) for obstacle in semantic_map.obstacles],
    )


def blocked_of(semantic_map: SemanticMap) -> np.ndarray:
    """(H, W) cells where nobody can walk; none where the map has neither `walkable` nor `obstacle`."""
    layers = {name: layer > 0 for name, layer in zip(semantic_map.layers, semantic_map.raster, strict=True)}
    blocked = np.zeros(semantic_map.raster.shape[1:], bool)
    if "walkable" in layers:
        blocked |= ~layers["walkable"]
    if "obstacle" in layers:
        blocked |= layers["obstacle"]
    return blocked
