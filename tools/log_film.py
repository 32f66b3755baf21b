"""`footfall log film`: the MuJoCo scene of a log as an MP4 or a GIF."""

import argparse
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..messages.body import Bodies, BodyStates
from ..messages.config import ConfigError
from ..messages.log import LogError, LogReader
from ..messages.map import HeightField, SemanticMap
from ..messages.objectives import Objectives, Waypoint
from ..messages.plan import PLAN_DT, Plans
from ..messages.topics import BODIES, BODY_STATES, MAP, OBJECTIVES, PLANS
from ..nodes.viewer_ground import paint
from ..nodes.viewer_people import colour_of
from ..nodes.viewer_picture import heights_at
from .progress import progress_line

PLAN_STRIDE = 4
"""Every so many points of a plan are drawn."""
PIN = np.array([0.0, 0.0, 0.9])
"""What stands at a waypoint [m]."""
CAMERAS = ("street", "top", "follow")


def film(
    log_path: str | Path,
    out_path: str | Path,
    camera: str = "street",
    size: tuple[int, int] = (960, 540),
    rate_hz: int = 15,
    start: float = 0.0,
    duration: float | None = None,
    follow: int | None = None,
    shadows: bool = True,
    plans: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render the body states of a log; returns the film's path.

    Args:
        log_path: The log; needs the topics map, bodies and body_states.
        out_path: MP4 or GIF to write.
        camera: `street` (from a corner, at an angle), `top`, or `follow` (behind one person).
        size: Width and height in pixels, both even.
        rate_hz: Frames per simulated second.
        start: First simulated second.
        duration: Simulated seconds; None for all.
        follow: Whom to follow; None for who is there longest.
        shadows: Whether the sun casts shadows; without a GPU they double the time.
        plans: Whether plans and waypoints are drawn.
        progress: Called with frames done and frames in all.

    Raises:
        LogError: the log lacks a topic, or nobody is in it then.
        RenderError: no OpenGL (says what to install), or the film cannot be written.
    """
    from ..models.body import describe
    from ..models.render.renderer import CrowdRenderer
    from ..models.render.video import write_video
    from ..nodes.place_solids import solids_of

    place, bodies, states, overlays = read_film(log_path, start, duration, rate_hz)
    with CrowdRenderer(
        [describe(shape) for shape in bodies.shapes.astype(np.float64)],
        *solids_of(place),
        width=size[0],
        height=size[1],
        shadows=shadows,
        ground=None if place.terrain else painted_ground(place),
    ) as renderer:
        whom = most_present(states) if follow is None else follow
        rows = {agent: row for row, agent in enumerate(bodies.ids.tolist())}

        def frames() -> Iterator[np.ndarray]:
            for state, overlay in zip(states, overlays, strict=True):
                agents = [rows[agent] for agent in state.ids.tolist()]
                strokes = strokes_of(overlay, state, place.terrain) if plans else []
                yield renderer.render(
                    state.joints[..., :7], viewpoint(camera, place, state, whom), agents, strokes
                )

        done = (lambda count: progress(count, len(states))) if progress else None
        write_video(out_path, frames(), rate_hz, done)
    return Path(out_path)


@dataclass(frozen=True)
class Overlay:
    """What a frame shows beside the people."""

    age: float
    """Of the plans [s]."""
    plans: Plans | None
    objectives: Objectives


def read_film(
    log_path: str | Path, start: float, duration: float | None, rate_hz: int
) -> tuple[SemanticMap, Bodies, list[BodyStates], list[Overlay]]:
    """Map, bodies, and one body state and one overlay a frame."""
    reader = LogReader(log_path)
    missing = [topic.name for topic in (MAP, BODIES, BODY_STATES) if topic.name not in reader.topics]
    if missing:
        raise LogError(f"{log_path}: has no {', '.join(missing)}; a film needs map, bodies and body_states")
    place = next(iter(reader.read(MAP))).message
    bodies = next(iter(reader.read(BODIES))).message
    end = None if duration is None else round((start + duration) * 1e9) + 1
    states: list[BodyStates] = []
    overlays: list[Overlay] = []
    plans, plans_ns, objectives = None, 0, Objectives()
    wanted = {topic.name for topic in (BODY_STATES, PLANS, OBJECTIVES)} & set(reader.topics)
    for item in reader.messages(wanted, end_ns=end):
        time = item.stamp_ns * 1e-9
        match item.topic:
            case PLANS.name:
                plans, plans_ns = item.message, item.stamp_ns
            case OBJECTIVES.name:
                objectives = item.message
            case _ if time >= start - 1e-9 and (time - start) * rate_hz >= len(states) - 1e-6:
                states.append(item.message)
                overlays.append(Overlay((item.stamp_ns - plans_ns) * 1e-9, plans, objectives))
    if not any(len(state.ids) for state in states):
        raise LogError(f"{log_path}: nobody is there from {start:g} s on")
    return place, bodies, states, overlays


def strokes_of(overlay: Overlay, state: BodyStates, ground: HeightField | None):
    """The chosen plans from where people are, and pins at their waypoints, in the colours of their shirts."""
    from ..models.render.renderer import Stroke

    def lifted(xy: np.ndarray, above: float) -> np.ndarray:
        height = np.zeros(len(xy)) if ground is None else heights_at(ground, xy)
        return np.column_stack([xy, height + above])

    def colour(agent: int) -> tuple[float, float, float]:
        return tuple((colour_of(agent) / 255).tolist())

    where = dict(zip(state.ids.tolist(), state.positions[:, 0, :2].astype(np.float64), strict=True))
    strokes = []
    if (plans := overlay.plans) is not None:
        first = round(overlay.age / PLAN_DT)
        for row, agent in enumerate(plans.ids.tolist()):
            way = plans.positions[row, plans.chosen[row], first::PLAN_STRIDE].astype(np.float64)
            if agent in where and len(way):
                points = lifted(np.concatenate([where[agent][None], way]), 0.03)
                strokes.append(Stroke(points, colour(agent), 0.035))
    for wishes in overlay.objectives.agents:
        for wish in wishes.objectives:
            if isinstance(wish, Waypoint) and wishes.id in where:
                foot = lifted(np.array([wish.position], dtype=np.float64), 0.0)[0]
                strokes.append(Stroke(np.array([foot, foot + PIN]), colour(wishes.id), 0.05))
    return strokes


def viewpoint(camera: str, place: SemanticMap, state: BodyStates, whom: int):
    """The camera of one frame."""
    from ..models.render.camera import Camera

    rows, columns = place.raster.shape[1:]
    width, height = columns * place.resolution, rows * place.resolution
    centre = np.array(place.origin) + 0.5 * np.array([width, height])
    if camera == "top":
        return Camera.top(centre, max(height, width * 9 / 16))
    row = np.flatnonzero(state.ids == whom)
    if camera == "follow" and len(row):
        return Camera.follow(state.joints[row[0], 0, :7])
    return Camera((float(centre[0]), float(centre[1]), 0.0), 0.55 * max(width, height), 82.0, -22.0)


def most_present(states: list[BodyStates]) -> int:
    """Who is in the most frames; of several the lowest id."""
    ids, counts = np.unique(np.concatenate([state.ids for state in states]), return_counts=True)
    return int(ids[counts.argmax()])


def painted_ground(place: SemanticMap):
    """The raster layers as a picture on the ground."""
    from ..models.render.renderer import GroundPicture

    times = max(1, min(6, 2400 // max(place.raster.shape[1:])))
    return GroundPicture(paint(place, times), place.resolution / times, place.origin)


def size_of(text: str) -> tuple[int, int]:
    """`1280x720` as two numbers.

    Raises:
        argparse.ArgumentTypeError: anything else.
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if not match or int(match[1]) % 2 or int(match[2]) % 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT with even numbers, e.g. 1280x720")
    return int(match[1]), int(match[2])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `footfall log film`."""
    parser.add_argument("log", help="recorded run (.mcap)")
    parser.add_argument("-o", "--out", help="film, .mp4 or .gif (default: the log's name with .mp4)")
    parser.add_argument("--camera", choices=CAMERAS, default="street")
    parser.add_argument("--size", type=size_of, default=(960, 540), help="WIDTHxHEIGHT (default 960x540)")
    parser.add_argument("--fps", type=int, default=15, help="frames per simulated second (default 15)")
    parser.add_argument("--start", type=float, default=0.0, metavar="S")
    parser.add_argument("--duration", type=float, metavar="S")
    parser.add_argument("--follow", type=int, metavar="ID", help="whom to follow with --camera follow")
    parser.add_argument("--no-shadows", action="store_true", help="half the time without a GPU")
    parser.add_argument("--no-plans", action="store_true", help="people alone, without plans and waypoints")


def run(arguments: argparse.Namespace) -> int:
    """Film; prints the path."""
    out = Path(arguments.out) if arguments.out else Path(arguments.log).with_suffix(".mp4")
    if arguments.fps < 1:
        raise ConfigError(f"--fps {arguments.fps}: at least one frame a second is needed")
    film(
        arguments.log,
        out,
        arguments.camera,
        arguments.size,
        arguments.fps,
        arguments.start,
        arguments.duration,
        arguments.follow,
        not arguments.no_shadows,
        not arguments.no_plans,
        progress_line(),
    )
    print(out)
    return 0
