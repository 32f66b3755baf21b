"""Open-loop evaluation on the test scenes of a set of crowds (Rempe et al. 2023, sec. 4.1)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from ..crowd.planning import Futures
from .choice import choose_samples, labelled
from .config import TraceConfig
from .crowd_file import SPLITS, Crowds
from .metrics import (
    Array,
    agent_collisions,
    displacement_errors,
    mean_accelerations,
    obstacle_collisions,
    realism,
    waypoint_error,
)
from .objectives import Future, Objective
from .scene_map import SceneMaps
from .scene_planner import ScenePlanner
from .windows import CrowdWindows

Found = TypeVar("Found")

PASS = {"temperature": 0.05, "widening": 0.3}
"""Of waypoints: the nearest state alone is to be there, but people turn round for those behind them."""

_SEEDS_A_RUN = 100_000  # more than there are scenes
WAYPOINT_FRAME = 40  # the waypoint is where the person truly is after four seconds


@dataclass(frozen=True)
class TrialScene:
    """One scene at the moment from which the future is predicted.

    Attributes:
        states: (A, 31, 4) world states, as the planner takes them.
        size: (A, 2) [m].
        truth: (A, 51, 2) observed positions, the current one first [m].
        maps: Map, or None.
        polygons: Obstacle outlines.
        radius: Of the discs [m].
    """

    states: torch.Tensor
    size: torch.Tensor
    truth: Array
    maps: SceneMaps | None
    polygons: Sequence[Array]
    radius: float

    @property
    def goal(self) -> Array:
        """(A, 2) where everybody truly is after four seconds [m]."""
        return self.truth[:, WAYPOINT_FRAME]


class TrialScenes:
    """The test split, every scene with somebody in it once: three seconds of history, then five to predict."""

    def __init__(self, crowds: Crowds, config: TraceConfig, split: str = "test", limit: int | None = None):
        self.dt = crowds.dt
        self._windows = CrowdWindows(crowds, split, config)
        self._crowds, self._config = crowds, config
        rows = np.flatnonzero(crowds.split == SPLITS.index(split))[:limit]
        self._scenes = [(scene, int(row)) for scene, row in enumerate(rows) if len(self._people(scene))]

    def __len__(self) -> int:
        return len(self._scenes)

    def _people(self, scene: int) -> torch.Tensor:
        """Who is there from now to the end."""
        present, now = self._windows.present[scene], self._config.history - 1
        return (present[:, now] & present[:, now + self._config.plan]).nonzero()[:, 0]

    def __iter__(self) -> Iterator[TrialScene]:
        windows, now = self._windows, self._config.history - 1
        for scene, row in self._scenes:
            people = self._people(scene)
            states = windows.states[scene, people, : now + 1]
            truth = windows.observed[scene, people, now : now + self._config.plan + 1].numpy()
            size = torch.full((len(people), 2), 2 * windows.radius)
            maps = windows.maps(torch.tensor([scene]))
            yield TrialScene(states, size, truth, maps, self._crowds.polygons_of(row), windows.radius)


@dataclass
class Report:
    """Figures of one method over all test scenes; rates in 0 to 1, distances in m.

    Attributes:
        obstacle: Mean share of time in an obstacle.
        agent: Mean over scenes of the share of people who ever touch another.
        waypoint: Mean smallest distance to the waypoint.
        ade: Of the sample nearest to the truth.
        fde: Of the same sample.
        emd: Histogram distances of speed, longitudinal and lateral acceleration.
        emd_compat: The same with accelerations projected on the world axes.
        accelerations: Mean absolute longitudinal and lateral acceleration [m/s^2].
        seconds: CPU time per scene.
    """

    obstacle: float
    agent: float
    waypoint: float
    ade: float
    fde: float
    emd: dict[str, float]
    emd_compat: dict[str, float]
    accelerations: tuple[float, float]
    seconds: float = 0.0


@dataclass
class Tally:
    """Collects chosen trajectories scene by scene."""

    dt: float
    obstacle: list[Array] = field(default_factory=list)
    agent: list[float] = field(default_factory=list)
    waypoint: list[Array] = field(default_factory=list)
    ade: list[Array] = field(default_factory=list)
    fde: list[Array] = field(default_factory=list)
    walked: list[Array] = field(default_factory=list)
    truth: list[Array] = field(default_factory=list)

    def add(self, scene: TrialScene, positions: Array, chosen: NDArray[np.int_]) -> None:
        """Count one scene's samples (A, S, T, 2) and the chosen one of each agent (A,)."""
        rows = np.arange(len(positions))
        path = positions[rows, chosen]
        self.obstacle.append(obstacle_collisions(path, scene.radius, scene.polygons))
        self.agent.append(float(agent_collisions(path, scene.radius).mean()))
        self.waypoint.append(waypoint_error(path, scene.goal))
        ade, fde = displacement_errors(positions, scene.truth[:, 1:])
        best = ade.argmin(1)
        self.ade.append(ade[rows, best])
        self.fde.append(fde[rows, best])
        self.walked.append(np.concatenate([scene.truth[:, :1], path], 1))
        self.truth.append(scene.truth)

    def report(self, seconds: float = 0.0) -> Report:
        """The figures so far."""
        walked, truth = np.concatenate(self.walked), np.concatenate(self.truth)

        def mean(rows: list[Array]) -> float:
            return float(np.concatenate(rows).mean())

        return Report(
            obstacle=mean(self.obstacle),
            agent=float(np.mean(self.agent)),
            waypoint=mean(self.waypoint),
            ade=mean(self.ade),
            fde=mean(self.fde),
            emd=realism(walked, truth, self.dt),
            emd_compat=realism(walked, truth, self.dt, compatible=True),
            accelerations=mean_accelerations(walked, self.dt),
            seconds=seconds,
        )


Wishes = Callable[[TrialScene], list[Objective]]


def no_wish(scene: TrialScene) -> list[Objective]:
    """Unguided."""
    return []


def avoid_obstacles(scene: TrialScene) -> list[Objective]:
    """Stay out of obstacles."""
    return [Objective("obstacle_avoid", {"buffer": 0.03})]


def avoid_agents(scene: TrialScene) -> list[Objective]:
    """Keep 0.2 m from everybody (app. C.5)."""
    return [Objective("agent_avoid", {"buffer": 0.2})]


def reach_waypoint(scene: TrialScene) -> list[Objective]:
    """Pass the waypoint at any time."""
    return [Objective("waypoint", {"goal": torch.from_numpy(scene.goal), **PASS})]


def everything(scene: TrialScene) -> list[Objective]:
    """Waypoint and both avoidances; the last to correct a trajectory is the avoidance of obstacles."""
    return [*reach_waypoint(scene), *avoid_agents(scene), *avoid_obstacles(scene)]


GUIDES: dict[str, Wishes] = {
    "none": no_wish,
    "obstacle": avoid_obstacles,
    "agent": avoid_agents,
    "waypoint": reach_waypoint,
    "all": everything,
}


Choice = Literal["guide", "truth", "every"]
Progress = Callable[[int, int], None]
"""Told how many plans are made, and of how many."""


def unwatched(done: int, total: int) -> None:
    """Nobody is told."""


def evaluate(
    planner: ScenePlanner,
    scenes: TrialScenes,
    wishes: Wishes = no_wish,
    choice: Choice = "guide",
    clock: Callable[[], float] = lambda: 0.0,
    workers: int = 1,
    runs: int = 1,
    progress: Progress = unwatched,
) -> Report:
    """Plan every test scene and count.

    Args:
        planner: With its sampling and guidance.
        scenes: Test scenes.
        wishes: Objectives of a scene.
        choice: Which of the samples counts: the one that `guide` chose; the one nearest to the `truth`
            (tables 5 and 6); or `every` one, as a run of its own, with the figures of the runs averaged
            (unguided rows, app. C.5: three runs).
        clock: CPU seconds, for the report.
        workers: Scenes planned at a time; the figures do not depend on it.
        runs: Noise is drawn so many times, and the figures are averaged.
        progress: Called after every plan.
    """
    each = planner.sampling.samples if choice == "every" else 1
    tallies = [Tally(scenes.dt) for _ in range(runs * each)]
    begun = clock()
    for run in range(runs):
        plans = plan_each(planner, scenes, wishes, workers, _SEEDS_A_RUN * run)
        for done, (scene, plan) in enumerate(plans, run * len(scenes) + 1):
            for sample, tally in enumerate(tallies[each * run : each * (run + 1)]):
                chosen = np.full(len(plan.chosen), sample) if choice == "every" else plan.chosen
                if choice == "truth":
                    chosen = displacement_errors(plan.positions, scene.truth[:, 1:])[0].argmin(1)
                tally.add(scene, plan.positions, chosen)
            progress(done, runs * len(scenes))
    seconds = (clock() - begun) / len(scenes) / runs
    return average([tally.report(seconds) for tally in tallies])


def plan_each(
    planner: ScenePlanner,
    scenes: TrialScenes,
    wishes: Wishes = no_wish,
    workers: int = 1,
    first_seed: int = 0,
) -> Iterator[tuple[TrialScene, Futures]]:
    """Every scene and its plan, in order, so many at a time; the plans do not depend on that."""

    def plan_scene(scene: TrialScene, seed: int) -> Futures:
        return planner.plan(scene.states, scene.size, scene.maps, wishes(scene), seed=seed)

    return _with_each(scenes, plan_scene, workers, first_seed)


def evaluate_filter(
    planner: ScenePlanner,
    scenes: TrialScenes,
    guides: Mapping[str, Wishes],
    clock: Callable[[], float] = lambda: 0.0,
    workers: int = 1,
    progress: Progress = unwatched,
) -> dict[str, Report]:
    """Choose among the same unguided samples by several guides (TRACE-Filter of table 1).

    Args:
        planner: With its sampling; nothing is guided.
        scenes: Test scenes.
        guides: Objectives by name.
        clock: CPU seconds, for the reports.
        workers: Scenes planned at a time.
        progress: Called after every plan.
    """
    tallies = {name: Tally(scenes.dt) for name in guides}
    begun = clock()

    def choose(scene: TrialScene, seed: int) -> tuple[Array, dict[str, NDArray[np.int_]]]:
        plan = planner.plan(scene.states, scene.size, scene.maps, seed=seed)
        now, radius = scene.states[:, -1], scene.size.max(1).values / 2
        states = planner.world_states(plan.actions, now)
        future = Future(states, now, radius, scenes.dt, scene.maps, seed=seed)
        chosen = {}
        for name, wishes in guides.items():
            objectives = wishes(scene)
            losses = {label: wish.loss(future) for label, wish in labelled(objectives)}
            chosen[name] = choose_samples(losses, objectives).numpy()
        return plan.positions, chosen

    for done, (scene, (positions, chosen)) in enumerate(_with_each(scenes, choose, workers), 1):
        for name, tally in tallies.items():
            tally.add(scene, positions, chosen[name])
        progress(done, len(scenes))
    seconds = (clock() - begun) / len(scenes)
    return {name: tally.report(seconds) for name, tally in tallies.items()}


def _with_each(
    scenes: TrialScenes, work: Callable[[TrialScene, int], Found], workers: int, first: int = 0
) -> Iterator[tuple[TrialScene, Found]]:
    """Every scene and what is found for it and its seed, numbered from the `first`, so many at a time."""
    trials, threads = list(scenes), torch.get_num_threads()
    torch.set_num_threads(max(1, threads // workers))  # of each worker
    try:
        with ThreadPoolExecutor(workers) as pool:
            yield from zip(trials, pool.map(work, trials, range(first, first + len(trials))), strict=True)
    finally:
        torch.set_num_threads(threads)


def average(reports: Sequence[Report]) -> Report:
    """The mean of every figure over several runs."""

    def mean(values: Sequence[Any]) -> Any:
        if isinstance(values[0], dict):
            return {key: mean([value[key] for value in values]) for key in values[0]}
        if isinstance(values[0], tuple):
            return tuple(map(mean, zip(*values, strict=True)))
        return float(np.mean(values))

    names = [f.name for f in fields(Report)]
    return Report(**{name: mean([getattr(report, name) for report in reports]) for name in names})
