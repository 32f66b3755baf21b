"""Keeps the score of a run: collisions, goals reached, distance from how people really walked.

In: agents (10 Hz), map, bodies, admissions, recorded tracks, falls. Out: score (latched, 1 Hz).
"""

import sys
from collections.abc import Iterable

import numpy as np
import shapely

from ..messages.agents import HISTORY_DT
from ..messages.body import Bodies
from ..messages.map import SemanticMap
from ..messages.population import RecordedTracks
from ..messages.score import Score
from ..messages.topics import ADMISSIONS, AGENTS, BODIES, FALLS, MAP, RECORDED_TRACKS, SCORE, Outgoing
from .node import Inbox, Node, NodeConfig
from .spin import spin


class Config(NodeConfig, frozen=True):
    """What counts as an overlap."""

    tolerance: float = 0.005
    """Depth from which two disks overlap [m]."""


class Referee(Node[Config]):
    """Judges the run, and changes nothing in it."""

    Config = Config
    inputs = (MAP, AGENTS, BODIES, ADMISSIONS, RECORDED_TRACKS, FALLS)
    outputs = (SCORE,)
    requires = (MAP, AGENTS, BODIES)
    trigger = AGENTS

    def __init__(self, config: Config, seed: int = 0) -> None:
        super().__init__(config, seed)
        self._entered: set[int] = set()
        self._goals = 0
        self._falls = 0
        self._samples = 0
        self._agent_overlaps = 0
        self._obstacle_overlaps = 0
        self._collisions = 0
        self._touching: set[tuple[int, int]] = set()
        self._track_total = 0.0
        self._track_samples = 0
        self._last_stamp_ns: int | None = None
        self._obstacles: shapely.Geometry = shapely.MultiPolygon()
        self._radii: dict[int, float] = {}
        self._tracks: dict[int, np.ndarray] = {}

    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Add up what the new states show."""
        self._take_in(inbox)
        for agents in inbox.received(AGENTS):
            now = agents.message.now
            self._judge(agents.message.ids, now[:, :2].astype(np.float64), agents.stamp_ns * 1e-9)
        whole_second = inbox.now_ns % 1_000_000_000 == 0
        if whole_second or self._last_stamp_ns is None or inbox.now_ns - self._last_stamp_ns >= 1_000_000_000:
            self._last_stamp_ns = inbox.now_ns
            return [SCORE(self._score(len(inbox.require(AGENTS).ids)))]
        return []

    def _take_in(self, inbox: Inbox) -> None:
        for semantic_map in inbox.new(MAP):
            self._obstacles = obstacle_shape(semantic_map)
        for bodies in inbox.new(BODIES):
            self._radii = radii_of(bodies)
        for tracks in inbox.new(RECORDED_TRACKS):
            self._tracks = tracks_of(tracks)
        self._goals += sum(len(admissions.reached) for admissions in inbox.new(ADMISSIONS))
        self._falls += sum(len(falls.ids) for falls in inbox.new(FALLS))

    def _judge(self, ids: np.ndarray, xy: np.ndarray, time: float) -> None:
        self._entered.update(ids.tolist())
        self._samples += len(ids)
        if not len(ids):
            return
        radius = np.array([self._radii[i] for i in ids.tolist()])
        gap = np.linalg.norm(xy[:, None] - xy, axis=-1) - radius[:, None] - radius
        np.fill_diagonal(gap, np.inf)
        pairs = np.argwhere(np.triu(gap < -self.config.tolerance, 1))
        touching = {(int(ids[i]), int(ids[j])) for i, j in pairs}
        self._agent_overlaps += len(np.unique(pairs))
        if not shapely.is_empty(self._obstacles):
            clear = shapely.distance(shapely.points(xy), self._obstacles)
            blocked = clear < radius - self.config.tolerance
            self._obstacle_overlaps += int(blocked.sum())
            touching |= {(int(i), -1) for i in ids[blocked]}
        self._collisions += len(touching - self._touching)
        self._touching = touching
        for agent, here in zip(ids.tolist(), xy, strict=True):
            track = self._tracks.get(agent)
            if track is not None and track[0, 0] - 1e-6 <= time <= track[-1, 0] + 1e-6:
                there = [np.interp(time, track[:, 0], track[:, axis]) for axis in (1, 2)]
                self._track_total += float(np.hypot(*(here - there)))
                self._track_samples += 1

    def _score(self, present: int) -> Score:
        return Score(
            entered=len(self._entered),
            present=present,
            goals_reached=self._goals,
            falls=self._falls,
            agent_seconds=self._samples * HISTORY_DT,
            agent_overlap_seconds=self._agent_overlaps * HISTORY_DT,
            obstacle_overlap_seconds=self._obstacle_overlaps * HISTORY_DT,
            collisions=self._collisions,
            track_distance=self._track_total / self._track_samples if self._track_samples else None,
            tracked_seconds=self._track_samples * HISTORY_DT,
        )


def obstacle_shape(semantic_map: SemanticMap) -> shapely.Geometry:
    """All obstacles of a map as one shape."""
    return shapely.union_all([shapely.Polygon(obstacle.polygon) for obstacle in semantic_map.obstacles])


def radii_of(bodies: Bodies) -> dict[int, float]:
    """Disk radius [m] by id."""
    return dict(zip(bodies.ids.tolist(), bodies.radii.astype(float).tolist(), strict=True))


def tracks_of(tracks: RecordedTracks) -> dict[int, np.ndarray]:
    """Recorded samples (T, 3) [t, x, y] by id."""
    rows = np.column_stack([tracks.times, tracks.positions])
    return {int(i): rows[tracks.ids == i] for i in np.unique(tracks.ids)}


if __name__ == "__main__":
    sys.exit(spin(Referee))
