"""`footfall log plot`: a run seen from above: map, tracks, goals, collisions."""

import argparse
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..messages.log import LogError, LogReader
from ..messages.map import SemanticMap
from ..messages.population import RecordedTracks
from ..messages.score import Score
from ..messages.topics import AGENTS, BODIES, MAP, OBJECTIVES, RECORDED_TRACKS, SCORE

LAYER_COLOURS = {
    "walkable": "#f1efe9",
    "road": "#c9ccd1",
    "pavement": "#e9e4d8",
    "green": "#d3e4c5",
    "stairs": "#ddd0bd",
    "crosswalk": "#ffffff",
    "marking": "#f7f2d2",
}
"""Ground colours, painted in this order."""


@dataclass
class Run:
    """What a picture from above needs of a log."""

    place: SemanticMap
    tracks: dict[int, np.ndarray] = field(default_factory=dict)
    """(T, 3) t [s], x, y [m] by pedestrian."""
    goals: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    overlaps: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    """(K, 2) where two people's disks begin to overlap [m]."""
    recorded: RecordedTracks | None = None
    score: Score | None = None


def read_run(log_path: str | Path) -> Run:
    """Collect map, tracks, goals and collisions of a log.

    Raises:
        LogError: not a log, one without a map, or one of another release.
    """
    place: SemanticMap | None = None
    rows: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    goals: dict[int, list[tuple[float, float]]] = defaultdict(list)
    radii: dict[int, float] = {}
    recorded: RecordedTracks | None = None
    score: Score | None = None
    overlaps: list[np.ndarray] = []
    touching: set[tuple[int, int]] = set()
    reader = LogReader(log_path)
    topics = (AGENTS, BODIES, MAP, OBJECTIVES, RECORDED_TRACKS, SCORE)
    wanted = [topic for topic in topics if topic.name in reader.topics]
    for topic in wanted:
        reader.read(topic)  # refuses what was recorded as another type
    for item in reader.messages(topics=[topic.name for topic in wanted]):
        message = item.message
        match item.topic:
            case MAP.name:
                place = message
            case BODIES.name:
                radii = dict(zip(message.ids.tolist(), message.radii.astype(float).tolist(), strict=True))
            case RECORDED_TRACKS.name:
                recorded = message
            case SCORE.name:
                score = message
            case OBJECTIVES.name:
                for agent in message.agents:
                    for wish in agent.objectives:
                        goal = getattr(wish, "position", None)
                        if goal is not None and goal not in goals[agent.id]:
                            goals[agent.id].append(goal)
            case AGENTS.name:
                ids, xy = message.ids.tolist(), message.now[:, :2].astype(float)
                for agent, (x, y) in zip(ids, xy, strict=True):
                    rows[agent].append((item.stamp_ns * 1e-9, x, y))
                if radii and len(ids) > 1:
                    radius = np.array([radii[agent] for agent in ids])
                    gap = np.linalg.norm(xy[:, None] - xy, axis=-1) - radius[:, None] - radius
                    pairs = {(i, j) for i, j in np.argwhere(np.triu(gap < -0.005, 1)).tolist()}
                    now = {(ids[i], ids[j]) for i, j in pairs}
                    overlaps += [(xy[i] + xy[j]) / 2 for i, j in pairs if (ids[i], ids[j]) not in touching]
                    touching = now
    if place is None:
        raise LogError(f"{log_path}: holds no map; record the topic 'map' to draw the run")
    return Run(
        place,
        {agent: np.array(points) for agent, points in rows.items()},
        dict(goals),
        np.array(overlaps).reshape(-1, 2),
        recorded,
        score,
    )


def plot(log_path: str | Path, out_path: str | Path) -> Path:
    """Draw a log from above into a picture file (PNG, SVG or PDF by its ending); returns its path.

    Raises:
        LogError: not a log, or one without a map.
        ValueError: a file ending that is no picture format.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    run = read_run(log_path)
    figure, axes = plt.subplots(figsize=(9, 9), layout="constrained")
    draw_place(axes, run.place)
    if run.recorded is not None:
        for agent in np.unique(run.recorded.ids):
            track = run.recorded.positions[run.recorded.ids == agent]
            axes.plot(*track.T, color="0.45", lw=0.8, ls=(0, (2, 2)), zorder=3)
    colours = plt.get_cmap("turbo")(np.linspace(0.05, 0.95, max(1, len(run.tracks))))
    for colour, (agent, track) in zip(colours, sorted(run.tracks.items()), strict=False):
        # A pedestrian who leaves and comes back is not joined by a line.
        pieces = np.split(track, np.flatnonzero(np.diff(track[:, 0]) > 0.35) + 1)
        for piece in pieces:
            axes.plot(piece[:, 1], piece[:, 2], color=colour, lw=1.6, alpha=0.9, zorder=4)
            axes.plot(*piece[0, 1:], "o", color=colour, ms=3.5, zorder=5)
        axes.plot(*track[-1, 1:], "o", color=colour, mec="k", mew=0.6, ms=7, zorder=6)
        for goal in run.goals.get(agent, [])[-1:]:
            axes.plot(*goal, "x", color=colour, ms=6, mew=1.8, zorder=5)
    axes.plot(*run.overlaps.T, "o", mfc="none", mec="#e0002d", ms=12, mew=1.8, zorder=7)
    axes.set_title(title_of(run), fontsize=10)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    try:
        figure.savefig(out_path, dpi=130)
    finally:
        plt.close(figure)
    return Path(out_path)


def draw_place(axes, place: SemanticMap) -> None:
    """Paint layers, heights and obstacles of a map."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Polygon

    rows, columns = place.raster.shape[1:]
    image = np.full((rows, columns, 3), to_rgb("#a9a6a0"))
    layers = dict(zip(place.layers, place.raster, strict=True))
    for name, colour in LAYER_COLOURS.items():
        if name in layers:
            image[layers[name] > 0] = to_rgb(colour)
    x, y = place.origin
    extent = (x, x + columns * place.resolution, y, y + rows * place.resolution)
    axes.imshow(image, origin="lower", extent=extent, zorder=0)
    if place.terrain is not None and np.ptp(place.terrain.heights) > 0.01:
        ground = place.terrain
        xs = ground.origin[0] + ground.resolution * np.arange(ground.heights.shape[1])
        ys = ground.origin[1] + ground.resolution * np.arange(ground.heights.shape[0])
        axes.contour(xs, ys, ground.heights, levels=12, colors="#7a6a55", linewidths=0.5, zorder=1)
    for obstacle in place.obstacles:
        axes.add_patch(Polygon(obstacle.polygon, fc="#6d6a75", ec="#4a4852", lw=0.5, zorder=2))
    axes.set_xlim(*extent[:2])
    axes.set_ylim(*extent[2:])
    axes.set_aspect("equal")


def title_of(run: Run) -> str:
    """What the run came to, in two lines."""
    score = run.score
    if score is None:
        return f"{run.place.name}: {len(run.tracks)} pedestrians"
    share = 100 / max(score.agent_seconds, 1e-9)
    lines = [
        f"{run.place.name}: {score.entered} pedestrians, {score.agent_seconds:.0f} agent seconds, "
        f"{score.goals_reached} goals reached",
        f"overlap with others {share * score.agent_overlap_seconds:.2f} %, "
        f"with obstacles {share * score.obstacle_overlap_seconds:.2f} %",
    ]
    if score.track_distance is not None:
        lines[1] += f"; {score.track_distance:.2f} m from recorded tracks"
    return "\n".join(lines)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `footfall log plot`."""
    parser.add_argument("log", help="recorded run (.mcap)")
    parser.add_argument("-o", "--out", help="picture file (default: the log's name with .png)")
    parser.add_argument("--video", metavar="MP4", help="also render the MuJoCo scene into a film")


def run(arguments: argparse.Namespace) -> int:
    """Draw; prints the picture's path."""
    out = Path(arguments.out) if arguments.out else Path(arguments.log).with_suffix(".png")
    print(plot(arguments.log, out))
    if arguments.video:
        from .log_film import film

        print(film(arguments.log, arguments.video))
    return 0
