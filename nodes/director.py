"""Directs the scene: who enters where and when, with which body, heading where.

In: agents (10 Hz). Out: population and recorded tracks (latched, at the start), admissions (when somebody
enters, leaves or arrives), objectives (latched, whenever somebody's change).
"""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..messages.agents import AgentStates
from ..messages.config import ConfigError
from ..messages.objectives import (
    AgentObjectives,
    Objectives,
    ObstacleAvoidance,
    SocialDistance,
    SocialGroup,
    TargetSpeed,
    Waypoint,
)
from ..messages.population import Admissions, Enter, Population, RecordedTracks
from ..messages.topics import ADMISSIONS, AGENTS, OBJECTIVES, POPULATION, RECORDED_TRACKS, Outgoing
from ..models.body import sample_shapes
from ..models.scene import Entry, NewGoal, RandomPopulation, Scene, SceneError, load_scene
from .node import Inbox, Node, NodeConfig
from .spin import spin


class Config(NodeConfig, frozen=True):
    """Which people, and what becomes of those who arrive."""

    scene: str = "crossing"
    """Name of a shipped scene or one in ./scenes, or a scene folder."""
    count: int | None = None
    """Number of pedestrians instead of the scene's own; of a recording the first that many."""
    until: float | None = None
    """Leave out who would enter later than this [s]; the launcher puts the run's duration here."""
    on_arrival: Literal["auto", "leave", "walk_on"] = "auto"
    """What those do who have reached their goal: leave the scene, or get a new goal. `auto`: people of a
    recording leave, others walk on."""
    arrival_radius: float = 0.6
    """Distance from the goal at which it counts as reached [m]."""
    clearance: float = 0.6
    """Distance from others at which somebody enters [m]."""


@dataclass
class _Person:
    """One pedestrian in the director's book."""

    id: int
    entry: Entry
    goal: np.ndarray
    inside: bool = False
    gone: bool = False
    goals: int = 0
    """How many goals were reached."""


class Director(Node[Config]):
    """Lets people in and out, and tells the planner what they want."""

    Config = Config
    inputs = (AGENTS,)
    outputs = (POPULATION, RECORDED_TRACKS, ADMISSIONS, OBJECTIVES)
    requires = (AGENTS,)
    trigger = AGENTS

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        try:
            self._scene = load_scene(config.scene)
            entries = self._scene.sample_population(seed, config.count, config.until)
        except SceneError as error:
            raise ConfigError(str(error)) from None
        if not entries:
            raise ConfigError(
                f"scene {config.scene}: nobody enters; give it a population, or a later `until`"
            )
        self._people = [_Person(i, entry, np.asarray(entry.goal)) for i, entry in enumerate(entries)]
        random = isinstance(self._scene.population, RandomPopulation)
        self._walk_on = config.on_arrival == "walk_on" or (config.on_arrival == "auto" and random)
        self._events = [event for event in self._scene.events if isinstance(event, NewGoal)]

    def start(self) -> Iterable[Outgoing]:
        """Everybody who may enter, and how they were recorded."""
        people = self._people
        yield POPULATION(
            Population(
                ids=np.arange(len(people), dtype=np.int32),
                groups=np.array([_group(p.entry) for p in people], dtype=np.int32),
                shapes=np.stack([sample_shapes(1, p.entry.body_seed)[0] for p in people]).astype(np.float32),
                enter_times=np.array([p.entry.time for p in people]),
                goals=np.stack([p.goal for p in people]).astype(np.float64),
            )
        )
        yield OBJECTIVES(Objectives())
        tracks = [(p.id, p.entry.track) for p in people if p.entry.track is not None]
        if tracks:
            rows = np.concatenate([track for _, track in tracks])
            ids = np.repeat([i for i, _ in tracks], [len(track) for _, track in tracks]).astype(np.int32)
            yield RECORDED_TRACKS(RecordedTracks(ids, rows[:, 0].copy(), rows[:, 1:].copy()))

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Admit who is due, see who has arrived."""
        agents = inbox.require(AGENTS)
        where = dict(zip(agents.ids.tolist(), agents.now[:, :2].astype(np.float64), strict=True))
        changed = self._new_goals(inbox.now)
        reached = [p for p in self._people if p.id in where and self._arrived(p, where[p.id], inbox.now)]
        leave = [] if self._walk_on else reached
        for person in reached:
            person.goals += 1
            if self._walk_on:
                person.goal = self._next_goal(person)
            else:
                person.inside, person.gone = False, True
        enter = self._admit(inbox.now, agents)
        outgoing: list[Outgoing] = []
        if enter or reached:
            ids = [p.id for p in leave]
            outgoing.append(ADMISSIONS(Admissions(enter, ids, [p.id for p in reached])))
        if changed or enter or reached:
            outgoing.append(OBJECTIVES(self._objectives()))
        return outgoing

    def _arrived(self, person: _Person, here: np.ndarray, now: float) -> bool:
        """Whether somebody has reached the goal; who was recorded standing stays as long as they did."""
        radius = self.config.arrival_radius
        if person.entry.group is not None:  # others of the group may stand on the very point
            radius *= 1.5
        if np.linalg.norm(here - person.goal) >= radius:
            return False
        stands = (
            person.entry.exit_time is not None and np.linalg.norm(person.goal - person.entry.xy) < 2 * radius
        )
        return not stands or now >= (person.entry.exit_time or 0.0)

    def _admit(self, now: float, agents: AgentStates) -> list[Enter]:
        """Who enters now: those who are due and find room, at their place or a step beside it."""
        taken = [xy for xy in agents.now[:, :2].astype(np.float64)]
        taken += [np.asarray(p.entry.xy) for p in self._people if p.inside and p.id not in agents.ids]
        enter = []
        for person in self._people:
            if person.inside or person.gone or person.entry.time > now + 1e-6:
                continue
            place = self._room(person, taken)
            if place is None:
                continue
            person.inside = True
            taken.append(place)
            towards = person.entry.velocity if np.any(person.entry.velocity) else person.goal - place
            enter.append(
                Enter(
                    id=person.id,
                    position=(float(place[0]), float(place[1])),
                    heading=float(np.arctan2(towards[1], towards[0])),
                    speed=float(np.linalg.norm(person.entry.velocity)),
                )
            )
        return enter

    def _room(self, person: _Person, taken: list[np.ndarray]) -> np.ndarray | None:
        """The wanted place, or the nearest free one within a metre, or None."""
        wanted = np.asarray(person.entry.xy, dtype=np.float64)
        places = np.concatenate([wanted[None], wanted + _RINGS])
        if taken:
            gaps = np.linalg.norm(places[:, None] - np.stack(taken), axis=-1).min(axis=1)
            places = places[gaps >= self.config.clearance]
        if len(places):
            places = places[self._scene.obstacle_distance(places) > _BODY_RADIUS]
        return places[0] if len(places) else None

    def _new_goals(self, now: float) -> bool:
        """Obey the scene's events up to now; says whether a goal has changed."""
        due = [event for event in self._events if event.time <= now]
        self._events = self._events[len(due) :]
        for event in due:
            if event.agent < len(self._people):
                person = self._people[event.agent]
                person.goal = (
                    self._point(person, event.goal) if isinstance(event.goal, str) else np.array(event.goal)
                )
        return bool(due)

    def _next_goal(self, person: _Person) -> np.ndarray:
        """A point in another area people walk to; the same for the same seed, person and count."""
        population = self._scene.population
        flows = population.flows if isinstance(population, RandomPopulation) else ()
        areas = sorted({name for flow in flows for name in (flow.spawn, flow.goal)})
        here = person.goal
        far = [a for a in areas if np.linalg.norm(self._scene.areas[a].mean(axis=0) - here) > 5.0] or areas
        rng = np.random.default_rng([self.seed, person.id, person.goals])
        return self._point(person, far[int(rng.integers(len(far)))])

    def _point(self, person: _Person, area: str) -> np.ndarray:
        """A free point of an area."""
        rng = np.random.default_rng([self.seed, person.id, person.goals, 1])
        return free_point(self._scene, area, rng)

    def _objectives(self) -> Objectives:
        inside = [person for person in self._people if person.inside]
        groups: dict[int, list[int]] = {}
        for person in inside:
            if person.entry.group is not None:
                groups.setdefault(person.entry.group, []).append(person.id)
        return Objectives(
            agents=[
                AgentObjectives(
                    person.id,
                    [
                        Waypoint((float(person.goal[0]), float(person.goal[1]))),
                        TargetSpeed(person.entry.preferred_speed),
                        SocialDistance(),
                        ObstacleAvoidance(),
                    ],
                )
                for person in inside
            ],
            groups=[
                SocialGroup(i, min(ids), sorted(ids)) for i, ids in sorted(groups.items()) if len(ids) > 1
            ],
        )


_BODY_RADIUS = 0.35
_ANGLES = np.linspace(0, 2 * np.pi, 12, endpoint=False)
_RINGS = np.concatenate([r * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1) for r in (0.35, 0.7, 1.05)])


def _group(entry: Entry) -> int:
    return -1 if entry.group is None else entry.group


def free_point(scene: Scene, area: str, rng: np.random.Generator) -> np.ndarray:
    """A point of an area away from obstacles (2,), world, m; the area's centre where there is no room."""
    polygon = scene.areas[area]
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = rng.uniform(low, high, (64, 2))
    inside = _contains(polygon, points) & (scene.obstacle_distance(points) > _BODY_RADIUS)
    return points[inside.argmax()] if inside.any() else polygon.mean(axis=0)


def _contains(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points (N, 2) lie inside a polygon (K, 2): even-odd rule."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    slope = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    return (crosses & (x < (b[:, 0] - a[:, 0]) * (y - a[:, 1]) / slope + a[:, 0])).sum(axis=1) % 2 == 1


if __name__ == "__main__":
    sys.exit(spin(Director))
