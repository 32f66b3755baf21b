"""Films, strips and path plots of walkers."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from ..models.body import Body, describe, sample_shapes
from ..models.pacer.courses import Course
from ..models.pacer.policy import ActorCritic
from ..models.pacer.walker_config import WalkerConfig
from ..models.pacer.walker_env import WalkerEnv
from ..models.pacer.walker_evaluation import PEOPLE_SEED, Rollouts, evaluation_paths, start_walks
from ..models.render.renderer import Camera, CrowdRenderer
from ..models.render.video import write_video

_FRAMES = 10  # of a strip


@dataclass(frozen=True)
class Walk:
    """T frames of N walkers."""

    poses: NDArray[np.float32]
    """(T, N, 24, 7) position m and rotation wxyz, world; a walker who fell lies on."""
    wanted: NDArray[np.float64]
    """(T, N, 2) m: where the path was."""
    bodies: Sequence[Body]
    period: float

    def draw(self, path: Path) -> None:
        """Film (.mp4) or strips (.png)."""
        if path.suffix == ".png":
            self._strips(path)
        else:
            self._film(path)

    def _film(self, path: Path) -> None:
        count = self.poses.shape[1]

        def frames():
            with CrowdRenderer(self.bodies, width=960, height=540, antialias=False) as renderer:
                for poses, wanted in zip(self.poses, self.wanted, strict=True):
                    shifted = poses.copy()
                    lanes = 2.2 * (np.arange(count) - 0.5 * (count - 1))
                    shifted[..., :2] -= wanted[:, None].astype(
                        np.float32
                    )  # each stays beside their path's point
                    shifted[..., 1] += lanes[:, None]
                    yield renderer.render(shifted, Camera((0.0, 0.0, 0.9), 3.5 + 1.6 * count, 60.0, -14.0))

        write_video(path, frames(), 1.0 / self.period)

    def _strips(self, path: Path) -> None:
        rows = []
        for n, body in enumerate(self.bodies):
            chosen = 60 + np.arange(_FRAMES) * 4
            poses = self.poses[np.minimum(chosen, len(self.poses) - 1), n].copy()
            origin = poses[:, :1, :2].copy()
            x, y = poses[0, 0, 3], poses[0, 0, 6]
            turn = -2.0 * np.arctan2(y, x)
            poses = _turned(poses, origin, turn)
            poses[..., 0] += 0.8 * np.arange(_FRAMES)[:, None]
            with CrowdRenderer([body] * _FRAMES, width=1400, height=330) as renderer:
                rows.append(renderer.render(poses, Camera((0.4 * _FRAMES - 0.4, 0.0, 0.85), 3.4, 90.0, -6.0)))
        Image.fromarray(np.concatenate(rows)).save(path)


def _turned(poses: NDArray, origin: NDArray, turn: float) -> NDArray:
    """Poses (T, 24, 7) about their own origins, turned about z."""
    cos, sin = np.cos(turn), np.sin(turn)
    out = poses.copy()
    x, y = (poses[..., i] - origin[..., i] for i in range(2))
    out[..., 0], out[..., 1] = cos * x - sin * y, sin * x + cos * y
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    w, i, j, k = np.moveaxis(poses[..., 3:], -1, 0)
    out[..., 3:] = np.stack([c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w], -1)
    return out


def record(model: ActorCritic, config: WalkerConfig, seconds: float, seed: int, walkers: int = 6) -> Walk:
    """Let a few people of different build walk random paths."""
    paths = evaluation_paths(seconds)
    config = replace(config, push_interval=0.0, paths=paths, easy_paths=paths, company=1, course=None)
    bodies = [describe(shape) for shape in sample_shapes(walkers, PEOPLE_SEED)]
    env = WalkerEnv(config, walkers, bodies, seed)
    start_walks(env, seed)
    poses, wanted = [], []
    for _ in range(round(seconds / env.period)):
        poses.append(np.concatenate([env.world.positions, env.world.quaternions], -1))
        wanted.append(env.paths.at(env.times))
        env.advance(env.unmirrored(model.act(torch.from_numpy(env.observe())).numpy()))
        env.lead()
    return Walk(np.array(poses, dtype=np.float32), np.array(wanted), bodies, env.period)


def draw_paths(path: Path, walk: Walk) -> None:
    """Draw where people should have gone and where they went, seen from above."""
    count = walk.poses.shape[1]
    figure = Figure(figsize=(9, 6), layout="constrained")
    FigureCanvasAgg(figure)
    for n in range(count):
        axes = figure.add_subplot(2, (count + 1) // 2, n + 1, aspect="equal")
        axes.plot(*walk.wanted[:, n].T, color="0.6", linewidth=3, label="path")
        axes.plot(*walk.poses[:, n, 0, :2].T, color="C0", linewidth=1, label="pelvis")
        for foot, colour in ((3, "C1"), (7, "C2")):
            places = walk.poses[:, n, foot, :2]
            still = np.linalg.norm(np.gradient(places, axis=0), axis=1) < 0.1 * walk.period
            axes.plot(*places[still].T, ".", color=colour, markersize=2)
        error = np.linalg.norm(walk.poses[:, n, 0, :2] - walk.wanted[:, n], axis=1).mean()
        body = walk.bodies[n]
        axes.set_title(f"{body.stature:.2f} m, {body.mass:.0f} kg: {100 * error:.0f} cm", fontsize=9)
    figure.savefig(path, dpi=110)


def draw_curves(path: Path) -> None:
    """Draw every column of a run's `curve.csv` over millions of samples, beside it as PNG."""
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    values = np.array([[float(v) if v else np.nan for v in row] for row in rows])
    shown = [i for i, name in enumerate(names) if name not in ("samples", "minutes")]
    figure = Figure(figsize=(14, 2.0 * -(-len(shown) // 5)), layout="constrained")
    FigureCanvasAgg(figure)
    for place, i in enumerate(shown, 1):
        axes = figure.add_subplot(-(-len(shown) // 5), 5, place)
        axes.plot(values[:, 0] / 1e6, values[:, i], linewidth=1)
        axes.set_title(names[i], fontsize=8)
        axes.tick_params(labelsize=6)
        axes.grid(alpha=0.3)
    figure.savefig(path.with_suffix(".png"), dpi=80)


def draw_failures(path: Path, course: Course, result: Rollouts) -> None:
    """Draw the ground from above, where people failed and where the others ended."""
    figure = Figure(figsize=(10, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    terrain, s = course.terrain, course.settings
    x, y = terrain.origin
    rows, columns = terrain.heights.shape
    extent = (x, x + columns * terrain.resolution, y, y + rows * terrain.resolution)
    picture = axes.imshow(terrain.heights, origin="lower", extent=extent, cmap="terrain")
    figure.colorbar(picture, label="height [m]", shrink=0.7)
    axes.plot(*result.ends[~result.failed].T, ".", color="white", markersize=2, label="on their feet")
    axes.plot(*result.ends[result.failed].T, "x", color="red", markersize=4, label="failed")
    for column, kind in enumerate(course.kinds[0]):
        axes.text((column + 0.5) * s.tile, -1.0, kind, ha="center", va="top", fontsize=7)
    axes.set(xlim=(-5, s.columns * s.tile + 5), ylim=(-5, s.levels * s.tile + 5))
    axes.legend(loc="upper right", fontsize=7)
    figure.savefig(path, dpi=110)
