"""Pictures of sampled futures, like figures 4 and 12 of Rempe et al. 2023."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..models.crowd.planning import Futures
from ..models.trace.evaluation import GUIDES, TrialScene, TrialScenes
from ..models.trace.network import Trace
from ..models.trace.planner import Sampling, TracePlanner

TITLES = {
    "none": "no guidance",
    "obstacle": "obstacle avoidance",
    "agent": "agent avoidance",
    "waypoint": "waypoint",
    "all": "waypoint and both avoidances",
}


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


def draw_samples(folder: Path, trace: Trace, scenes: TrialScenes, count: int = 4) -> Path:
    """20 unguided samples a person in several scenes; above none of the neighbours, below as trained (fig. 12).

    The upper row shows what people do who expect everybody else to walk straight on.
    """
    apart = Trace(replace(trace.config, joint=False))
    apart.load_state_dict(trace.state_dict())
    sampling = Sampling(solver="dpm", steps=20, samples=20)
    figure, axes = _grid(2, count)
    rows = {"others walk straight on": apart.eval(), "joint futures": trace}
    chosen = sorted(islice(scenes, 30), key=lambda s: -len(s.truth))[:count]
    for row, (title, model) in enumerate(rows.items()):
        planner = TracePlanner(model, sampling)
        for column, scene in enumerate(chosen):
            axis = axes[row * count + column]
            _draw(axis, scene, planner.plan(scene.states, scene.size, scene.maps, seed=column))
            axis.set_title(title, fontsize=8)
    return _save(figure, folder / "trace_samples.png")


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
    middle, reach = scene.truth[:, 0].mean(0), 9.0
    axis.set_xlim(middle[0] - reach, middle[0] + reach)
    axis.set_ylim(middle[1] - reach, middle[1] + reach)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])


def _save(figure: Figure, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    return path
