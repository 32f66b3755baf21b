"""Directs the scene: who enters where and when, with which body, heading where.

In: agents (10 Hz), steering. Out: population and recorded tracks (latched, at the start), admissions (when
somebody enters, leaves or arrives), objectives (latched, whenever somebody's change).
"""

import logging
import sys
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import shapely
from msgspec import Meta

from ..messages.agents import AgentStates
from ..messages.config import ConfigError
from ..messages.objectives import Objectives
from ..messages.population import Admissions, Enter, Population, RecordedTracks
from ..messages.steering import Remove, Spawn
from ..messages.topics import ADMISSIONS, AGENTS, OBJECTIVES, POPULATION, RECORDED_TRACKS, STEERING, Outgoing
from ..models.body import sample_shapes
from ..models.scene import Entry, NewGoal, RandomPopulation, Scene, SceneError, load_scene
from .director_book import Book, Person
from .node import Inbox, Node, NodeConfig
from .spin import spin

log = logging.getLogger(__name__)

NEVER = 1e9
"""Time of entry of those who come only when asked for [s]."""


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
    spare: Annotated[int, Meta(ge=0)] = 0
    """People in reserve of a random population, who enter only when steering asks for somebody."""


class Director(Node[Config]):
    """Lets people in and out, and tells the planner what they want."""

    Config = Config
    inputs = (AGENTS, STEERING)
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
        if config.spare and isinstance(self._scene.population, RandomPopulation):
            reserve = self._scene.sample_population(seed + 1, config.spare)
            entries = [*entries, *(replace(entry, time=NEVER, group=None) for entry in reserve)]
        if not entries:
            raise ConfigError(
                f"scene {config.scene}: nobody enters; give it a population, or a later `until`"
            )
        self._book = Book(entries)
        random = isinstance(self._scene.population, RandomPopulation)
        self._walk_on = config.on_arrival == "walk_on" or (config.on_arrival == "auto" and random)
        self._events = [event for event in self._scene.events if isinstance(event, NewGoal)]

    def start(self) -> Iterable[Outgoing]:
        """Everybody who may enter, and how they were recorded."""
        people = self._book.people
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
        enter, leave = [], []
        for steering in inbox.new(STEERING):
            command = steering.command
            if not self._book.knows(command):
                continue
            match command:
                case Remove(agent=agent):
                    leave += self._remove(agent)
                case Spawn():
                    enter += self._spawn(command, agents, enter)
                case _:
                    changed |= self._book.change(command)
        present = [p for p in self._book.people if p.inside and p.id in where]
        reached = [p for p in present if self._arrived(p, where[p.id], inbox.now)]
        for person in reached:
            person.goals, person.at = person.goals + 1, None
            if self._walk_on:
                person.goal = self._next_goal(person)
            else:
                leave += self._remove(person.id)
        enter += self._admit(inbox.now, agents)
        outgoing: list[Outgoing] = []
        if enter or reached or leave:
            outgoing.append(ADMISSIONS(Admissions(enter, leave, [p.id for p in reached])))
        if changed or enter or reached or leave:
            outgoing.append(OBJECTIVES(self._book.objectives()))
        return outgoing

    def _arrived(self, person: Person, here: np.ndarray, now: float) -> bool:
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
        taken += [np.asarray(p.entry.xy) for p in self._book.people if p.inside and p.id not in agents.ids]
        enter = []
        for person in self._book.people:
            if person.inside or person.gone or person.entry.time > now + 1e-6:
                continue
            place = self._room(np.asarray(person.entry.xy, dtype=np.float64), taken)
            if place is None:
                continue
            person.inside = True
            taken.append(place)
            towards = person.entry.velocity if np.any(person.entry.velocity) else person.goal - place
            enter.append(_entrance(person, place, towards, float(np.linalg.norm(person.entry.velocity))))
        return enter

    def _spawn(self, command: Spawn, agents: AgentStates, entering: list[Enter]) -> list[Enter]:
        """Let in who waits longest to be asked; somebody who was there before only if nobody else is left."""
        absent = [p for p in self._book.people if not p.inside and p.id not in agents.ids]
        if not absent:
            log.warning("steering: everybody is there already; give the director `spare` people")
            return []
        person = min(absent, key=lambda p: (p.gone, -p.entry.time, p.id))
        taken = [*agents.now[:, :2].astype(np.float64), *(np.array(enter.position) for enter in entering)]
        place = self._room(np.array(command.position), taken)
        if place is None:
            log.warning("steering: no room for somebody at %.2f, %.2f", *command.position)
            return []
        person.inside, person.gone = True, False
        if command.goal is not None:
            person.goal = np.array(command.goal)
        return [_entrance(person, place, person.goal - place, 0.0)]

    def _remove(self, agent: int) -> list[int]:
        """Take somebody out, if there."""
        person = self._book.people[agent]
        if not person.inside:
            return []
        person.inside, person.gone = False, True
        return [agent]

    def _room(self, wanted: np.ndarray, taken: list[np.ndarray]) -> np.ndarray | None:
        """The wanted place (2,) [m], or the nearest free one within a metre, or None."""
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
            if event.agent < len(self._book.people):
                person = self._book.people[event.agent]
                person.goal = (
                    self._point(person, event.goal) if isinstance(event.goal, str) else np.array(event.goal)
                )
        return bool(due)

    def _next_goal(self, person: Person) -> np.ndarray:
        """A point in another area people walk to; the same for the same seed, person and count."""
        population = self._scene.population
        flows = population.flows if isinstance(population, RandomPopulation) else ()
        areas = sorted({name for flow in flows for name in (flow.spawn, flow.goal)})
        here = person.goal
        far = [a for a in areas if np.linalg.norm(self._scene.areas[a].mean(axis=0) - here) > 5.0] or areas
        rng = np.random.default_rng([self.seed, person.id, person.goals])
        return self._point(person, far[int(rng.integers(len(far)))])

    def _point(self, person: Person, area: str) -> np.ndarray:
        """A free point of an area."""
        rng = np.random.default_rng([self.seed, person.id, person.goals, 1])
        return free_point(self._scene, area, rng)


_BODY_RADIUS = 0.35
_ANGLES = np.linspace(0, 2 * np.pi, 12, endpoint=False)
_RINGS = np.concatenate([r * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1) for r in (0.35, 0.7, 1.05)])


def _entrance(person: Person, place: np.ndarray, towards: np.ndarray, speed: float) -> Enter:
    """Somebody enters at a place (2,) [m], facing a direction (2,)."""
    x, y = place.tolist()
    return Enter(person.id, (x, y), heading=float(np.arctan2(towards[1], towards[0])), speed=speed)


def _group(entry: Entry) -> int:
    return -1 if entry.group is None else entry.group


def free_point(scene: Scene, area: str, rng: np.random.Generator) -> np.ndarray:
    """A point of an area away from obstacles (2,), world, m; the area's centre where there is no room."""
    polygon = scene.areas[area]
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = rng.uniform(low, high, (64, 2))
    inside = shapely.contains_xy(shapely.Polygon(polygon), *points.T)
    inside &= scene.obstacle_distance(points) > _BODY_RADIUS
    return points[inside.argmax()] if inside.any() else polygon.mean(axis=0)


if __name__ == "__main__":
    sys.exit(spin(Director))
