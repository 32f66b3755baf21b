"""What is asked of people in closed loop, and how well they did it (Rempe et al. 2023, sec. 4.2, app. C.2, C.5)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from .evaluation import Progress, unwatched
from .metrics import (
    RANGES,
    Array,
    agent_collisions,
    histogram_distance,
    mean_accelerations,
    motion,
    obstacle_collisions,
    social_distance_error,
    waypoint_error,
)
from .objectives import Objective
from .rollouts import GOAL_SECONDS, LoopPlanner, Rollout, Wishes, walk

GROUP_DISTANCE, GROUP_COHESION = 1.5, 0.3  # m, probability (app. C.5)
PERTURBATION = 2.0  # m, standard deviation (app. C.5)
URGENCY, SPEED = 0.7, 1.25  # share, m/s (app. C.5)
TEMPERATURE = 0.2  # m, of the waypoint's soft minimum; as in the open-loop tables
ARRIVED = 0.3  # m from the waypoint


@dataclass(frozen=True)
class Task:
    """What is asked of the walkers of one rollout, and how far off they were.

    Attributes:
        name: Of the guide.
        wishes: What is asked of the walkers; nothing is asked of the others.
        error: (E,) guidance errors [m] of walked positions (walkers, 101, 2).
        goals: (walkers, 2) where they are to go [m], or None.
    """

    name: str
    wishes: Wishes
    error: Callable[[Array], Array]
    goals: Array | None = None


def reach(name: str, goals: Array, urgency: float = URGENCY) -> Task:
    """Pass goals (walkers, 2) at any time, also beyond the horizon of a plan; who has passed is free."""

    def wishes(people: int, path: Array) -> list[Objective]:
        goal = torch.full((people, 2), torch.nan)
        walking = waypoint_error(path, goals) > ARRIVED
        goal[: len(goals)][torch.from_numpy(walking)] = torch.from_numpy(goals[walking])
        settings = {"goal": goal, "urgency": urgency, "speed": SPEED, "temperature": TEMPERATURE}
        return [Objective("global_waypoint", settings)]

    return Task(name, wishes, lambda path: waypoint_error(path, goals), goals)


def waypoint_task(rollout: Rollout, rng: np.random.Generator) -> Task:
    """Go where they truly went in nine seconds."""
    return reach("waypoint", rollout.goals)


def urgent_task(rollout: Rollout, rng: np.random.Generator) -> Task:
    """The same as fast as the preferred speed allows: the paper's urgency asks for 0.9 m/s only."""
    return reach("urgent", rollout.goals, urgency=1.0)


def perturbed_task(rollout: Rollout, rng: np.random.Generator) -> Task:
    """Go 2 m (standard deviation of x and of y) beside it."""
    noise = rng.normal(0, PERTURBATION, rollout.goals.shape)
    return reach("perturbed", (rollout.goals + noise).astype(np.float32))


def groups_task(rollout: Rollout, rng: np.random.Generator) -> Task:
    """Stay 1.5 m from the nearest member of the group."""
    groups = rollout.groups

    def wishes(people: int, path: Array) -> list[Objective]:
        group = torch.full((people,), -1)
        group[: len(groups)] = torch.from_numpy(groups)
        settings = {"group": group, "distance": GROUP_DISTANCE, "cohesion": GROUP_COHESION}
        return [Objective("social_group", settings)]

    return Task(
        "groups", wishes, lambda path: social_distance_error(path, groups.astype(float), GROUP_DISTANCE)
    )


def no_task(rollout: Rollout, rng: np.random.Generator) -> Task:
    """Just walk; the error is the distance from where they truly went."""
    goals = rollout.goals
    return Task("none", lambda people, path: [], lambda path: waypoint_error(path, goals))


TASKS = {
    "none": no_task,
    "waypoint": waypoint_task,
    "urgent": urgent_task,
    "perturbed": perturbed_task,
    "groups": groups_task,
}


@dataclass(frozen=True)
class LoopReport:
    """Figures over all rollouts.

    Attributes:
        error: Mean guidance error [m].
        obstacle: Mean share of time in an obstacle.
        agent: Mean over scenes of the share of walkers who ever touch somebody.
        longitudinal: Mean absolute acceleration along the way [m/s^2].
        lateral: The same across it.
        emd_speed: Histogram distance of speeds to the recording's [m/s].
        seconds: CPU time per rollout.
    """

    error: float
    obstacle: float
    agent: float
    longitudinal: float
    lateral: float
    emd_speed: float
    seconds: float = 0.0


@dataclass
class LoopTally:
    """Collects rollouts one by one; `seconds` is the CPU time that all of them took."""

    dt: float
    seconds: float = 0.0
    error: list[Array] = field(default_factory=list)
    obstacle: list[Array] = field(default_factory=list)
    agent: list[float] = field(default_factory=list)
    walked: list[Array] = field(default_factory=list)
    speeds: list[Array] = field(default_factory=list)

    def add(self, rollout: Rollout, task: Task, path: Array) -> None:
        """Count walked positions (walkers, 101, 2) [m]."""
        span = slice(rollout.now, rollout.now + path.shape[1])
        others = rollout.observed[rollout.walkers :, span].numpy()
        self.error.append(task.error(path))
        self.obstacle.append(obstacle_collisions(path, rollout.radius, rollout.polygons))
        touched = agent_collisions(np.concatenate([path, others]), rollout.radius)
        self.agent.append(float(touched[: rollout.walkers].mean()))
        self.walked.append(path)
        truth = rollout.observed[: rollout.walkers, span].numpy()
        speeds = motion(truth, self.dt).speed
        self.speeds.append(speeds[np.isfinite(speeds)])

    def extend(self, other: "LoopTally") -> None:
        """Count what another one has collected."""
        self.seconds += other.seconds
        for name in ("error", "obstacle", "agent", "walked", "speeds"):
            getattr(self, name).extend(getattr(other, name))

    def report(self) -> LoopReport:
        """The figures so far."""
        walked = np.concatenate(self.walked)
        speeds = motion(walked, self.dt).speed
        return LoopReport(
            float(np.concatenate(self.error).mean()),
            float(np.concatenate(self.obstacle).mean()),
            float(np.mean(self.agent)),
            *mean_accelerations(walked, self.dt),
            histogram_distance(speeds, np.concatenate(self.speeds), RANGES["speed"]),
            self.seconds / max(len(self.walked), 1),
        )


def asked(trials: Sequence[Rollout], task: str, seed: int) -> Iterator[tuple[int, Rollout, Task]]:
    """Rollouts with what is asked of them; those without any group are left out of `groups`."""
    for number, rollout in enumerate(trials):
        if task != "groups" or (rollout.groups >= 0).any():
            yield number, rollout, TASKS[task](rollout, np.random.default_rng([seed, number]))


def recorded(trials: Sequence[Rollout], task: str, seed: int = 0) -> LoopTally:
    """The people as they were recorded, for the nine seconds in which all are seen."""
    tally = LoopTally(trials[0].dt)
    for _, rollout, wanted in asked(trials, task, seed):
        span = slice(rollout.now, rollout.now + round(GOAL_SECONDS / rollout.dt) + 1)
        tally.add(rollout, wanted, rollout.observed[: rollout.walkers, span].numpy())
    return tally


def walk_all(
    planner: LoopPlanner,
    trials: Sequence[Rollout],
    task: str,
    seed: int = 0,
    clock: Callable[[], float] = lambda: 0.0,
    progress: Progress = unwatched,
) -> LoopTally:
    """Walk all rollouts under one of `TASKS`; perturbations depend on the seed and the rollout only."""
    tally, begun, tasks = LoopTally(trials[0].dt), clock(), list(asked(trials, task, seed))
    for done, (number, rollout, wanted) in enumerate(tasks, 1):
        path = walk(planner, rollout, wanted.wishes, seed=1000 * seed + number)
        tally.add(rollout, wanted, path[..., :2].numpy())
        progress(done, len(tasks))
    tally.seconds = clock() - begun
    return tally
