"""Pictures of sampled futures, like figures 4, 5, 12 and 13 of Rempe et al. 2023, and the curve of the samplers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ..models.crowd.planning import Futures
from ..models.trace.closed_loop import asked
from ..models.trace.evaluation import GUIDES, TrialScene, TrialScenes
from ..models.trace.metrics import Array
from ..models.trace.network import Trace
from ..models.trace.planner import Sampling, TracePlanner
from ..models.trace.rollouts import Rollout, walk
from .eval_trace_paper import Row

TITLES = {
    "none": "no guidance",
    "obstacle": "obstacle avoidance",
    "agent": "agent avoidance",
    "waypoint": "waypoint",
    "all": "waypoint and both avoidances",
}
MANY_STEPS = Sampling(solver="dpm", steps=20, samples=20)


def draw_guides(folder: Path, planner: TracePlanner, scenes: TrialScenes) -> Path:
    """One scene under every guide, 20 samples a person and the chosen one in bold (figure 4)."""
    figure, axes = _grid(1, len(GUIDES))
    scene = max(islice(scenes, 20), key=lambda s: len(s.truth))  # the fullest of the first
    for axis, (name, wishes) in zip(axes, GUIDES.items(), strict=True):
        plan = planner.plan(scene.states, scene.size, scene.maps, wishes(scene), seed=0)
        _draw(axis, scene, plan)
        if name in ("waypoint", "all"):
            axis.scatter(*scene.goal.T, marker="x", s=18, c="black", linewidths=1, zorder=4)
        axis.set_title(TITLES[name], fontsize=8)
    return _save(figure, folder / "trace_guides.png")


def draw_samples(
    folder: Path, trace: Trace, scenes: TrialScenes, others: Mapping[str, Trace], count: int = 4
) -> Path:
    """20 unguided samples a person in several scenes, a row for each model (figure 12).

    The first row shows what people do who expect everybody else to walk straight on, the second ours, the others
    ablations by name.
    """
    apart = Trace(replace(trace.config, joint=False))
    apart.load_state_dict(trace.state_dict())
    rows = {"others walk straight on": apart.eval(), "joint futures": trace, **others}
    planners = {title: TracePlanner(model, MANY_STEPS) for title, model in rows.items()}
    return _save(_unguided(planners, _fullest(scenes, count)), folder / "trace_samples.png")


def draw_weights(
    folder: Path, trace: Trace, scenes: TrialScenes, weights: Sequence[float], count: int = 4
) -> Path:
    """20 unguided samples a person in several scenes, a row for each w of classifier-free sampling (figure 13)."""
    planners = {f"w = {w:g}": TracePlanner(trace, replace(MANY_STEPS, context_weight=w)) for w in weights}
    return _save(_unguided(planners, _fullest(scenes, count)), folder / "trace_weights.png")


def draw_rollouts(
    folder: Path, planners: Mapping[str, tuple[str, TracePlanner]], trials: Sequence[Rollout], count: int = 3
) -> Path:
    """Recorded crowds walked anew in closed loop (figure 5): a row for each planner, a column for each rollout.

    Args:
        folder: Of the picture.
        planners: By title, with the task of `closed_loop.TASKS`.
        trials: Rollouts; those with groups and the most people to plan for are drawn.
        count: How many.
    """
    busiest = sorted(trials, key=lambda trial: ((trial.groups < 0).all(), -trial.walkers))[:count]
    figure, axes = _grid(len(planners), len(busiest))
    for row, (title, (task, planner)) in enumerate(planners.items()):
        for number, trial, wanted in asked(busiest, task, seed=0):
            axis = axes[row * len(busiest) + number]
            path = walk(planner, trial, wanted.wishes, seed=number)[..., :2].numpy()
            _draw_rollout(axis, trial, path)
            axis.set_title(title, fontsize=8)
            if wanted.goals is not None:
                axis.scatter(*wanted.goals.T, marker="x", s=18, c="black", linewidths=1, zorder=4)
    return _save(figure, folder / "trace_rollouts.png")


def draw_samplers(folder: Path, rows: Sequence[Row]) -> Path:
    """Quality over time of the table `samplers`: left guided by all objectives, right without guidance."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    guided, free = figure.subplots(1, 2)
    for axis, guide, key, title in (
        (guided, "all", "error", "waypoint error [m], all objectives"),
        (free, "none", "emd_vel", "EMD of speeds [m/s], no guidance"),
    ):
        curves: dict[str, list[Row]] = {}
        for row in rows:
            if row["guide"] == guide:
                curves.setdefault(str(row["sampler"]).split()[0], []).append(row)
        for solver, points in curves.items():
            x, y = ([float(p[k] or 0) for p in points] for k in ("seconds", key))
            axis.plot(x, y, marker="o", markersize=3, linewidth=1, label=solver)
            for point, *place in zip(points, x, y, strict=True):
                axis.annotate(str(point["sampler"]).split()[1], place, fontsize=7)
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_ylim(bottom=0)
        axis.set_xlabel("CPU seconds a scene; numbers are denoising steps", fontsize=8)
        axis.set_title(title, fontsize=9)
        axis.legend(fontsize=7)
    return _save(figure, folder / "trace_samplers.png")


def _fullest(scenes: TrialScenes, count: int) -> list[TrialScene]:
    """Those of the first scenes with the most people."""
    return sorted(islice(scenes, 30), key=lambda s: -len(s.truth))[:count]


def _unguided(planners: Mapping[str, TracePlanner], scenes: Sequence[TrialScene]) -> Figure:
    """A row for each planner, a column for each scene."""
    figure, axes = _grid(len(planners), len(scenes))
    for row, (title, planner) in enumerate(planners.items()):
        for column, scene in enumerate(scenes):
            axis = axes[row * len(scenes) + column]
            _draw(axis, scene, planner.plan(scene.states, scene.size, scene.maps, seed=column))
            axis.set_title(title, fontsize=8)
    return figure


def _grid(rows: int, columns: int) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=(2.4 * columns, 2.6 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(np.ravel(figure.subplots(rows, columns)))


def _draw(axis: Axes, scene: TrialScene, plan: Futures) -> None:
    """Obstacles, the past, all samples thin and the chosen ones bold, people as discs."""
    for polygon in scene.polygons:
        axis.fill(*polygon.T, color="0.75", linewidth=0)
    colours = colormaps["tab10"](np.arange(len(scene.truth)) % 10)
    history = scene.states[..., :2].numpy()
    for person, colour in enumerate(colours):
        now = scene.truth[person, :1]
        samples = plan.positions[person]
        starts = np.broadcast_to(now, (len(samples), 1, 2))
        lines = LineCollection(list(np.concatenate([starts, samples], 1)), colors=[colour], linewidths=0.5)
        lines.set_alpha(0.5)
        axis.add_collection(lines)
        axis.plot(*history[person].T, color=colour, linewidth=0.8, linestyle=":")
        axis.plot(*np.concatenate([now, samples[plan.chosen[person]]]).T, color=colour, linewidth=1.8)
        axis.scatter(*now.T, s=14, color=[colour], edgecolors="black", linewidths=0.5, zorder=3)
    _frame(axis, scene.truth[:, 0].mean(0), 9.0)


def _draw_rollout(axis: Axes, trial: Rollout, path: Array) -> None:
    """Obstacles, whoever is replayed in grey, recorded ways dotted, walked ways (walkers, T, 2) bold."""
    for polygon in trial.polygons:
        axis.fill(*polygon.T, color="0.75", linewidth=0)
    span = slice(trial.now, trial.now + path.shape[1])
    colours = colormaps["tab10"](np.arange(len(path)) % 10)
    for person, truth in enumerate(trial.observed[:, span].numpy()):
        colour = colours[person] if person < len(path) else "0.6"
        axis.plot(*truth.T, color=colour, linewidth=0.8, linestyle=":")
    for walked, colour in zip(path, colours, strict=True):
        axis.plot(*walked.T, color=colour, linewidth=1.8)
        axis.scatter(*walked[0], s=14, color=[colour], edgecolors="black", linewidths=0.5, zorder=3)
    _frame(axis, path[:, 0].mean(0), 9.0)


def _frame(axis: Axes, middle: Array, reach: float) -> None:
    """A square without numbers."""
    axis.set_xlim(middle[0] - reach, middle[0] + reach)
    axis.set_ylim(middle[1] - reach, middle[1] + reach)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])


def _save(figure: Figure, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    return path
