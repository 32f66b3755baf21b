"""A small run whose every number is known, as pictures and as a log."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from footfall.messages.agents import AgentStates
from footfall.messages.body import Bodies, BodyStates, Contacts, Falls
from footfall.messages.diagnostics import Diagnostics, InputStats, LogLine, OutputStats, Parameters
from footfall.messages.graph import Graph, NodeSpec
from footfall.messages.log import LogWriter
from footfall.messages.map import HeightField, Obstacle, SemanticMap
from footfall.messages.objectives import AgentObjectives, Objectives, SocialGroup, TargetSpeed, Waypoint
from footfall.messages.plan import Plans
from footfall.messages.topics import (
    AGENTS,
    BODIES,
    BODY_STATES,
    CONTACTS,
    DIAGNOSTICS,
    FALLS,
    LOG,
    MAP,
    OBJECTIVES,
    PARAMETERS,
    PLANS,
    Outgoing,
)
from footfall.models.body import describe, sample_shapes

IDS = np.array([0, 1, 4], np.int32)
SHAPES = sample_shapes(3, 5).astype(np.float32)
PEOPLE = [describe(shape) for shape in SHAPES.astype(np.float64)]


def place(slope: float = 0.0) -> SemanticMap:
    """Ten by ten metres around the origin, a crate and a tower, ground rising by `slope` along x."""
    raster = np.zeros((2, 50, 50), np.uint8)
    raster[0] = 1
    raster[1, :, 20:30] = 1
    heights = slope * np.arange(-5.0, 5.5, 1.0, dtype=np.float32)[None].repeat(11, axis=0)
    square = np.array([[3.0, 3.0], [4.0, 3.0], [4.0, 4.0], [3.0, 4.0]])
    return SemanticMap(
        "yard",
        ["walkable", "road"],
        raster,
        0.2,
        (-5.0, -5.0),
        [Obstacle("crate", square, 1.0), Obstacle("tower", -square[::-1], 12.0)],
        HeightField(heights, 1.0, (-5.0, -5.0)) if slope else None,
    )


def where(time: float) -> np.ndarray:
    """Everybody walks along x at 1 m/s, side by side."""
    return np.column_stack([-2 + time + 0 * IDS, np.arange(3) - 1.0])


def moment(time: float) -> Iterator[Outgoing]:
    """Messages of one tenth of a second."""
    xy = where(time)
    history = np.zeros((3, 31, 7), np.float32)
    for back in range(31):
        then = time - back * 0.1
        if then > -1e-6:
            history[:, 30 - back, :2] = where(then)
            history[:, 30 - back, 3:] = [1.0, 0.4, 0.5, 1.0]
    yield AGENTS(AgentStates(IDS, np.array([7, 7, -1], np.int32), history))
    joints = np.zeros((3, 24, 13), np.float32)
    joints[..., 3] = 1
    for row, person in enumerate(PEOPLE):
        joints[row, :, :3] = person.zero_positions + np.array([*xy[row], 0])
    yield BODY_STATES(BodyStates(IDS, joints))
    if round(time * 10) % 5 == 0:
        ahead = 0.1 * np.arange(1, 51)
        samples = np.stack([(1 + 0.1 * s) * ahead for s in range(3)])  # (S, T)
        positions = np.zeros((3, 3, 50, 2), np.float32)
        positions[..., 0] = xy[:, None, None, 0] + samples
        positions[..., 1] = xy[:, None, None, 1]
        losses = np.arange(9, dtype=np.float32).reshape(3, 3, 1)
        flat, speeds = 0 * positions[..., 0], 1 + 0 * positions[..., 0]
        chosen = np.array([0, 1, 2], np.int32)
        yield PLANS(Plans(IDS, chosen, positions, flat, speeds, "trace", ["waypoint"], losses, 0.02))


def start() -> Iterator[Outgoing]:
    """What holds from the beginning."""
    yield MAP(place())
    yield BODIES(
        Bodies(
            IDS,
            SHAPES,
            np.array([p.mass for p in PEOPLE], np.float32),
            np.array([p.stature for p in PEOPLE], np.float32),
            np.array([p.radius for p in PEOPLE], np.float32),
            np.stack([p.offsets for p in PEOPLE]).astype(np.float32),
        )
    )
    wishes = [AgentObjectives(int(i), [Waypoint((3.0, float(i))), TargetSpeed(1.0)]) for i in IDS]
    yield OBJECTIVES(Objectives(wishes, [SocialGroup(7, 0, [0, 1])]))
    yield PARAMETERS(Parameters("planner", '{"method": "trace", "rate_hz": 2}'))
    yield LOG(LogLine("planner", "WARNING", "<b>slow</b>"))


def report(sent: int) -> Outgoing:
    inputs = [InputStats("map", "map_server", 1, 3, 0, 1, None)]
    outputs = [OutputStats("plans", sent, 1000 * sent, 0)]
    return DIAGNOSTICS(Diagnostics("planner", 1, sent, 0.01, 0.02, 0.5, 1 << 20, inputs, outputs))


def run(until: float = 4.0) -> Iterator[tuple[float, Outgoing]]:
    """All messages of the run with their times."""
    for item in start():
        yield 0.0, item
    for k in range(round(until * 10) + 1):
        time = k / 10
        for item in moment(time):
            yield time, item
        if k % 10 == 0:
            yield time, report(2 * k // 10)
        if k == 25:
            yield time, FALLS(Falls(IDS[2:], np.array([[0.5, 1, 0.2]], np.float32), "report"))
            pair, normal = np.array([[0, 1]], np.int32), np.array([[0, 1, 0]], np.float32)
            at, force = np.array([[0.5, -0.5, 1]], np.float32), np.array([120], np.float32)
            yield time, CONTACTS(Contacts(pair, pair * 0, at, normal, force))
        if k == 30:
            empty = np.zeros((0, 3), np.float32)
            none = np.zeros((0, 2), np.int32)
            yield time, CONTACTS(Contacts(none, none, empty, empty, np.zeros(0, np.float32)))


@pytest.fixture
def messages() -> Callable[..., Iterator[tuple[float, Outgoing]]]:
    return run


@pytest.fixture
def yard() -> Callable[..., SemanticMap]:
    return place


@pytest.fixture
def run_log(tmp_path: Path) -> Path:
    """The run as a log."""
    path = tmp_path / "yard.mcap"
    counts: dict[str, int] = {}
    with LogWriter(path, Graph("yard", [NodeSpec("simulator", "x")]), chunk_bytes=100_000) as writer:
        for number, (time, item) in enumerate(run()):
            name = item.topic.name
            sequence = counts[name] = counts.get(name, -1) + 1
            writer.write_message(item.topic, "simulator", sequence, round(time * 1e9), number, item.message)
    return path
