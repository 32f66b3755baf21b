"""Pictures of what guidance does: `python -m footfall.tools.trace_demo docs/images/trace_demo.png`.

Left: two social groups, who start among each other. Right: waypoints off the way people would take, as in the
paper's perturbed-waypoint runs. Closed loop, planned once a second.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ..models.trace.guidance_losses import distance_to
from ..models.trace.objectives import Future, Objective
from ..models.trace.planner import FEW, TracePlanner
from ..models.trace.scene_map import SceneMaps
from ..models.trace.scene_planner import TraceFutures

SPEED = 1.2  # m/s
COLOURS = ("#1b6ca8", "#c4501b", "#4c8c2b", "#7a3f9d", "#a8851b", "#20807a")


def walk(
    planner: TracePlanner, start: np.ndarray, maps: SceneMaps | None, wishes: list[Objective], seconds: int
) -> np.ndarray:
    """Positions (A, 1 + T, 2) of people who start at (A, 2), walk along x and plan once a second.

    Args:
        planner: With its settings.
        start: World [m].
        maps: Or None.
        wishes: What they are asked all the time.
        seconds: How long.
    """
    states = np.zeros((len(start), 31, 4))
    states[..., :2], states[..., 3] = start[:, None], SPEED
    states[..., 0] += SPEED * 0.1 * np.arange(-30, 1)
    size, rows, last = np.full((len(start), 2), 0.6), np.arange(len(start)), None
    walked = [start[:, None]]
    for second in range(seconds):
        last = planner.plan(states, size, maps, wishes, previous=last, elapsed=10, seed=second)
        states = np.concatenate([states[:, 10:], first_second(last, rows)], axis=1)
        walked.append(states[:, -10:, :2])
    return np.concatenate(walked, axis=1)


def first_second(plan: TraceFutures, rows: np.ndarray) -> np.ndarray:
    """States (A, 10, 4) of the chosen samples."""
    parts = (plan.positions, plan.headings[..., None], plan.speeds[..., None])
    return np.concatenate([part[rows, plan.chosen][:, :10] for part in parts], axis=-1)


def groups(planner: TracePlanner) -> tuple[np.ndarray, np.ndarray]:
    """Two groups of three; positions and group numbers."""
    start = np.array([[0.0, 0.0], [0.5, 1.3], [-0.4, 2.6], [0.3, 3.9], [-0.3, 5.2], [0.2, 6.5]])
    group = np.array([0, 1, 0, 1, 0, 1])

    wishes = [
        Objective("social_group", {"group": torch.from_numpy(group), "distance": 1.0}),
        Objective("target_speed", {"speed": SPEED}),
        Objective("agent_avoid", {"buffer": 0.2}),
    ]

    return walk(planner, start, None, wishes, 10), group


def waypoints(planner: TracePlanner) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three people, each with a waypoint 2 m off straight on; positions, waypoints, obstacle corners."""
    start = np.array([[0.0, 0.0], [0.5, 2.2], [0.0, 4.4]])
    goals = start + np.array([[8.0, -2.0], [8.0, 2.0], [7.5, 2.0]])
    box = np.array([[4.5, 1.9], [6.0, 1.9], [6.0, 3.1], [4.5, 3.1]])
    y, x = np.mgrid[-10:20:0.1, -10:20:0.1]
    inside = (x > box[0, 0]) & (x < box[1, 0]) & (y > box[0, 1]) & (y < box[2, 1])
    maps = SceneMaps.from_raster({"obstacle": inside}, 0.1, (-10.0, -10.0))

    goal = {"goal": torch.from_numpy(goals), "speed": SPEED, "temperature": 0.3}
    wishes = [
        Objective("global_waypoint", goal),
        Objective("agent_avoid", {"buffer": 0.2}),
        Objective("obstacle_avoid", {"buffer": 0.05}),
    ]

    return walk(planner, start, maps, wishes, 8), goals, box


def errors(path: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Least distance (A,) of paths (A, T, 2) from their goals (A, 2) [m]."""
    states = torch.nn.functional.pad(torch.from_numpy(path[:, None]).float(), (0, 2))
    future = Future(states, states[:, 0, 0], torch.zeros(len(path)))
    return distance_to(future, torch.from_numpy(goals))[0].amin((1, 2)).numpy()


def draw(path: Path, planner: TracePlanner) -> np.ndarray:
    """Write the picture; returns the waypoint errors (3,) [m]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((10, 3.4), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    walked, group = groups(planner)
    for way, number in zip(walked, group, strict=True):
        left.plot(*way.T, color=COLOURS[number], lw=1.2)
    for frame in (0, 50, 100):
        for number in np.unique(group):
            left.plot(*walked[group == number, frame].T, "o:", color=COLOURS[number], ms=6, lw=0.8)
    left.set_title("two social groups: start, 5 s, 10 s", fontsize=9)
    walked, goals, box = waypoints(planner)
    right.fill(*box.T, color="0.6")
    for colour, way, goal in zip(COLOURS, walked, goals, strict=False):
        there = int(np.linalg.norm(way - goal, axis=1).argmin()) + 1
        right.plot(*way[:there].T, color=colour, lw=1.2)
        right.plot(*way[:there:10].T, "o", color=colour, ms=3)
        right.plot(*goal, "x", color=colour, ms=9, mew=2)
    missed = errors(walked, goals)
    right.set_title(f"waypoints 2 m off the straight way, missed by {missed.max():.2f} m at most", fontsize=9)
    for axes in (left, right):
        axes.set_aspect("equal")
        axes.tick_params(labelsize=7)
        axes.set_xlabel("x [m]", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(path)
    return missed


def main() -> int:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    args = parser.parse_args()
    missed = draw(args.file, TracePlanner.load(sampling=replace(FEW, steps=8)))
    print(f"{args.file}: waypoints missed by {', '.join(f'{m:.2f}' for m in missed)} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
