"""`footfall log html`: a run as one HTML file that needs nothing else, also without a network."""

import argparse
import base64
import html
import json
import struct
import zlib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..messages.body import BodyStates
from ..messages.config import ConfigError
from ..messages.log import LogError, LogReader
from ..messages.map import SemanticMap
from ..messages.objectives import Objectives, Waypoint
from ..messages.plan import PLAN_DT, Plans
from ..messages.topics import AGENTS, BODIES, BODY_STATES, FALLS, MAP, OBJECTIVES, PLANS
from ..models.body.skeleton import PARENTS
from ..models.render.street import colour_of_obstacle
from ..nodes.viewer_ground import hides, paint
from ..nodes.viewer_people import colour_of

PAGE = Path(__file__).parent / "log_html.html"
"""The page around the data: drawing and controls."""
PLAN_STRIDE = 2
"""Every so many points of a plan are kept."""
MAX_SAMPLES = 12
"""Samples kept of each plan beside the chosen one."""
UNIT = 0.01
"""Positions are kept in steps of this [m]."""


def write_html(
    log_path: str | Path, out_path: str | Path, rate_hz: float = 10.0, bodies: bool = True
) -> Path:
    """Write a log as an HTML replay; returns its path.

    Args:
        log_path: The log; needs `agents`. Map, bodies, plans and objectives are shown where they are there.
        out_path: HTML file to write.
        rate_hz: Pictures per simulated second, at most that of the log.
        bodies: Whether limbs are kept, not only places.

    Raises:
        LogError: not a log, or nobody is in it.
    """
    facts, arrays = collect(LogReader(log_path), rate_hz, bodies)
    facts["title"] = Path(log_path).name
    facts["arrays"], blob = pack(arrays)
    data = base64.b64encode(zlib.compress(blob, 9)).decode()
    head = json.dumps(facts).replace("<", "\\u003c")
    page = PAGE.read_text(encoding="utf-8")
    page = page.replace("__TITLE__", html.escape(facts["title"])).replace("__FACTS__", head)
    Path(out_path).write_text(page.replace("__DATA__", data), encoding="utf-8")
    return Path(out_path)


def collect(reader: LogReader, rate_hz: float, bodies: bool) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the page shows: facts as plain data, and arrays.

    Raises:
        LogError: nobody is in the log.
    """
    if AGENTS.name not in reader.topics:
        raise LogError(f"{reader.path}: has no {AGENTS.name}; a replay needs it")
    wanted = {AGENTS, BODIES, FALLS, MAP, OBJECTIVES, PLANS} | ({BODY_STATES} if bodies else set())
    book = _Book(1.0 / rate_hz)
    for item in reader.messages({topic.name for topic in wanted} & set(reader.topics)):
        book.take(item.topic, item.message, item.stamp_ns * 1e-9)
    if not book.times:
        raise LogError(f"{reader.path}: nobody is in it")
    return book.facts(), book.arrays()


class _Book:
    """Collects frames while a log goes by."""

    def __init__(self, period: float) -> None:
        self.period = period
        self.times: list[float] = []
        self._ids: list[np.ndarray] = []
        self._states: list[np.ndarray] = []
        self._joints: list[np.ndarray] = []
        self._bodies: BodyStates | None = None
        self._plans: list[tuple[float, Plans]] = []
        self._goals: list[tuple[float, Objectives]] = []
        self._falls: list[tuple[float, int]] = []
        self._places: list[tuple[float, SemanticMap]] = []
        self._radii: dict[int, float] = {}

    def take(self, topic: str, message: Any, time: float) -> None:
        match topic:
            case AGENTS.name:
                if not self.times or time - self.times[-1] > self.period - 1e-6:
                    self.times.append(time)
                    self._ids.append(message.ids)
                    self._states.append(message.now[:, :4])
                    self._joints.append(self._limbs(message.ids))
            case BODY_STATES.name:
                self._bodies = message
                if self.times and abs(time - self.times[-1]) < 1e-6:
                    self._joints[-1] = self._limbs(self._ids[-1])
            case BODIES.name:
                self._radii = dict(
                    zip(message.ids.tolist(), message.radii.astype(float).tolist(), strict=True)
                )
            case PLANS.name:
                self._plans.append((time, message))
            case OBJECTIVES.name:
                self._goals.append((time, message))
            case FALLS.name:
                self._falls += [(time, agent) for agent in message.ids.tolist()]
            case MAP.name:
                self._places.append((time, message))

    def _limbs(self, ids: np.ndarray) -> np.ndarray:
        """Joint positions (N, 24, 3) [m] of those with these ids; zero of who has none."""
        joints = np.zeros((len(ids), len(PARENTS), 3), np.float32)
        if self._bodies is not None:
            row_of = {agent: row for row, agent in enumerate(self._bodies.ids.tolist())}
            for row, agent in enumerate(ids.tolist()):
                if agent in row_of:
                    joints[row] = self._bodies.positions[row_of[agent]]
        return joints

    def facts(self) -> dict[str, Any]:
        everybody = sorted({agent for ids in self._ids for agent in ids.tolist()})
        first = self._places[0][1] if self._places else None
        return {
            "unit": UNIT,
            "planStep": PLAN_DT * PLAN_STRIDE,
            "parents": list(PARENTS) if self._bodies is not None else [],
            "people": {str(agent): self._person(agent) for agent in everybody},
            "place": None if first is None else _place(first),
            "obstacles": [[time, _obstacles(place)] for time, place in self._places],
            "goals": [[time, _waypoints(goals)] for time, goals in self._goals],
            "groups": [[time, [g.members for g in goals.groups]] for time, goals in self._goals],
            "falls": self._falls,
        }

    def _person(self, agent: int) -> dict[str, Any]:
        return {"colour": colour_of(agent).tolist(), "radius": round(self._radii.get(agent, 0.3), 3)}

    def arrays(self) -> dict[str, np.ndarray]:
        counts = [len(ids) for ids in self._ids]
        arrays = {
            "times": np.array(self.times, np.float32),
            "first": np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32),
            "ids": np.concatenate(self._ids).astype(np.int32),
            "xy": _short(np.concatenate([states[:, :2] for states in self._states])),
            "motion": np.concatenate([states[:, 2:4] for states in self._states]).astype(np.float32),
        }
        if self._bodies is not None:
            arrays["joints"] = _short(np.concatenate(self._joints))
        ground = self._places[0][1].terrain if self._places else None
        if ground is not None:
            arrays["heights"] = ground.heights
        return arrays | _plan_arrays(self._plans)


def _plan_arrays(plans: list[tuple[float, Plans]]) -> dict[str, np.ndarray]:
    """One row a plan of one person: times, ids, the chosen way, and the other samples of all as one list."""
    times, ids, ways, samples, owners = [], [], [], [], []
    for time, message in plans:
        rows = np.arange(len(message.ids))
        chosen = message.positions[rows, message.chosen][:, PLAN_STRIDE - 1 :: PLAN_STRIDE]
        start = sum(len(part) for part in ids)
        times.append(np.full(len(rows), time))
        ids.append(message.ids)
        ways.append(chosen)
        for row in rows.tolist():
            others = [s for s in range(message.positions.shape[1]) if s != message.chosen[row]]
            for sample in others[:MAX_SAMPLES]:
                samples.append(message.positions[row, sample, PLAN_STRIDE - 1 :: PLAN_STRIDE])
                owners.append(start + row)
    if not sum(len(part) for part in ids):
        return {}
    length = max(way.shape[1] for way in ways)
    even = [np.pad(way, ((0, 0), (0, length - way.shape[1]), (0, 0)), mode="edge") for way in ways]
    arrays = {
        "planTimes": np.concatenate(times).astype(np.float32),
        "planIds": np.concatenate(ids).astype(np.int32),
        "plans": _short(np.concatenate(even)),
    }
    if samples:
        even = [np.pad(way, ((0, length - len(way)), (0, 0)), mode="edge") for way in samples]
        arrays |= {"samples": _short(np.stack(even)), "sampleOf": np.array(owners, np.uint32)}
    return arrays


def _short(metres: np.ndarray) -> np.ndarray:
    """Metres in steps of `UNIT`."""
    return np.clip(np.round(metres / UNIT), -32768, 32767).astype(np.int16)


def _place(place: SemanticMap) -> dict[str, Any]:
    rows, columns = place.raster.shape[1:]
    ground = place.terrain
    return {
        "name": place.name,
        "origin": list(place.origin),
        "size": [columns * place.resolution, rows * place.resolution],
        "picture": "data:image/png;base64,"
        + base64.b64encode(png(paint(place, 2, grain=False)[::-1])).decode(),
        "terrain": None
        if ground is None
        else {"origin": list(ground.origin), "resolution": ground.resolution, "shape": ground.heights.shape},
    }


def _obstacles(place: SemanticMap) -> list[dict[str, Any]]:
    seen: Counter[str] = Counter()
    obstacles = []
    for obstacle in place.obstacles:
        colour = colour_of_obstacle(obstacle.name, seen[obstacle.name])
        seen[obstacle.name] += 1
        obstacles.append(
            {
                "name": obstacle.name,
                "height": obstacle.height,
                "polygon": np.round(obstacle.polygon, 3).tolist(),
                "colour": [round(255 * channel) for channel in colour],
                "hides": hides(obstacle),
            }
        )
    return obstacles


def _waypoints(goals: Objectives) -> dict[str, list[float]]:
    return {
        str(agent.id): [round(wish.position[0], 2), round(wish.position[1], 2)]
        for agent in goals.agents
        for wish in agent.objectives
        if isinstance(wish, Waypoint)
    }


def pack(arrays: dict[str, np.ndarray]) -> tuple[dict[str, Any], bytes]:
    """Arrays one after the other, each beginning at a multiple of 8 bytes, and where each is."""
    table, blob = {}, b""
    for name, array in arrays.items():
        blob += bytes(-len(blob) % 8)
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        table[name] = {"dtype": array.dtype.str[1:], "shape": list(array.shape), "at": len(blob)}
        blob += little.tobytes()
    return table, blob


def png(image: np.ndarray) -> bytes:
    """An RGB picture (H, W, 3) uint8 as PNG."""
    height, width = image.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(rows.tobytes(), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `footfall log html`."""
    parser.add_argument("log", help="recorded run (.mcap)")
    parser.add_argument("-o", "--out", help="file to write (default: the log's name with .html)")
    parser.add_argument("--rate", type=float, default=10.0, help="pictures per simulated second (default 10)")
    parser.add_argument("--no-bodies", action="store_true", help="leave out the limbs: a smaller file")


def run(arguments: argparse.Namespace) -> int:
    """Write; prints the path."""
    if not arguments.rate > 0:
        raise ConfigError(f"--rate {arguments.rate:g}: must be above 0")
    out = Path(arguments.out) if arguments.out else Path(arguments.log).with_suffix(".html")
    print(write_html(arguments.log, out, arguments.rate, not arguments.no_bodies))
    return 0
