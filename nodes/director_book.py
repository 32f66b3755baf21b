"""The director's book: what everybody wants, who walks with whom, and what steering changes in it."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ..messages.objectives import (
    AgentObjectives,
    Objective,
    Objectives,
    ObstacleAvoidance,
    SocialDistance,
    SocialGroup,
    TargetSpeed,
    Waypoint,
)
from ..messages.steering import (
    BreakGroup,
    Command,
    MakeGroup,
    SetDistance,
    SetSpeed,
    SetWaypoint,
    SetWeight,
)
from ..models.scene import Entry

log = logging.getLogger(__name__)


@dataclass
class Person:
    """One pedestrian, in the scene or not."""

    id: int
    entry: Entry
    goal: np.ndarray
    """(2,) [m], world."""
    speed: float
    """Wanted speed [m/s]."""
    at: float | None = None
    """When to be at the goal [s]; None for any time."""
    gap: float = SocialDistance().gap
    """Social distance [m]."""
    weights: dict[str, float] = field(default_factory=dict)
    """Weights that are not 1, by type of objective."""
    inside: bool = False
    gone: bool = False
    goals: int = 0
    """How many goals were reached."""

    def wishes(self) -> list[Objective]:
        """What this person is asked to do."""

        def weight(kind: type) -> float:
            return self.weights.get(kind.__name__, 1.0)

        x, y = float(self.goal[0]), float(self.goal[1])
        return [
            Waypoint((x, y), at=self.at, weight=weight(Waypoint)),
            TargetSpeed(self.speed, weight=weight(TargetSpeed)),
            SocialDistance(self.gap, weight=weight(SocialDistance)),
            ObstacleAvoidance(weight=weight(ObstacleAvoidance)),
        ]


@dataclass
class Group:
    """People who walk together."""

    members: list[int]
    leader: int | None = None
    """None for the member with the lowest number."""
    distance: float = SocialGroup(0, 0, []).distance
    """Wanted distance between neighbours [m]."""
    weight: float = 1.0


class Book:
    """Everybody who may ever be there, by number from 0, and their groups."""

    def __init__(self, entries: Iterable[Entry]) -> None:
        self.people = [
            Person(i, entry, np.asarray(entry.goal), entry.preferred_speed) for i, entry in enumerate(entries)
        ]
        self.groups: dict[int, Group] = {}
        for person in self.people:
            if person.entry.group is not None:
                self.groups.setdefault(person.entry.group, Group([])).members.append(person.id)

    def objectives(self) -> Objectives:
        """What those who are inside are asked to do."""
        inside = [AgentObjectives(person.id, person.wishes()) for person in self.people if person.inside]
        groups = []
        for number, group in sorted(self.groups.items()):
            members = sorted(member for member in group.members if self.people[member].inside)
            if len(members) > 1:
                leader = group.leader if group.leader in members else members[0]
                groups.append(
                    SocialGroup(number, leader, members, distance=group.distance, weight=group.weight)
                )
        return Objectives(inside, groups)

    def knows(self, command: Command) -> bool:
        """Whether everybody a command names is in the book; if not, a warning says so."""
        named = [*getattr(command, "members", ()), getattr(command, "agent", None)]
        last = len(self.people) - 1
        for who in named:
            if who is not None and not 0 <= who <= last:
                log.warning("steering: there is no person %d; they are numbered 0 to %d", who, last)
                return False
        return True

    def change(self, command: Command) -> bool:
        """Note what a command changes; says whether it changes anything."""
        people = self.people
        match command:
            case SetWaypoint(agent=agent):
                people[agent].goal, people[agent].at = np.array(command.position), command.at
            case SetSpeed(agent=agent):
                people[agent].speed = command.speed
            case SetDistance(agent=agent):
                for person in people if agent is None else [people[agent]]:
                    person.gap = command.gap
            case SetWeight(agent=agent, objective="Group"):
                for group in self.groups.values():
                    if agent is None or agent in group.members:
                        group.weight = command.weight
            case SetWeight(agent=agent):
                for person in people if agent is None else [people[agent]]:
                    person.weights[command.objective] = command.weight
            case MakeGroup():
                return self._make_group(command)
            case BreakGroup(agent=agent):
                self.groups = {i: group for i, group in self.groups.items() if agent not in group.members}
            case _:
                return False
        return True

    def _make_group(self, command: MakeGroup) -> bool:
        members = sorted(set(command.members))
        leader = command.members[0] if command.leader is None else command.leader
        if len(members) < 2 or leader not in members:
            log.warning("steering: a group needs two members or more, one of them the leader: %s", command)
            return False
        for group in self.groups.values():
            group.members = [member for member in group.members if member not in members]
        self.groups[1 + max(self.groups, default=-1)] = Group(members, leader, command.distance)
        return True
