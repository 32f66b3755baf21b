"""Draws a picture into a viser scene, and only what has changed since the last time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..messages.objectives import Waypoint
from ..messages.topics import (
    AGENTS,
    BODIES,
    BODY_STATES,
    CONTACTS,
    FALLS,
    MAP,
    OBJECTIVES,
    PLANS,
)
from .viewer_light import in_linear_light
from .viewer_people import Part, colours_of, dressed
from .viewer_picture import Picture
from .viewer_place import PlaceDrawing
from .viewer_shapes import KNOB, PIN, RING, SPOT, Mesh
from .viewer_trails import Trails

if TYPE_CHECKING:
    import viser

FAINT = 0.72
"""How far the colour of a sample that was not chosen is mixed with white."""
SAMPLE_STRIDE = 5
"""Every so many points of a sample that was not chosen are drawn."""
SHADE, SHADE_RADIUS = 0.22, 0.24
"""Opacity and radius [m] of the dark spot under somebody."""
DEFAULT_RADIUS = 0.3
"""Radius of a disk where no bodies were told [m]."""


@dataclass
class Shown:
    """What is drawn."""

    people: bool = True
    disks: bool = True
    tracks: bool = True
    trails: bool = False
    plans: bool = True
    samples: bool = True
    waypoints: bool = True
    groups: bool = True
    contacts: bool = True
    obstacles: bool = True
    buildings: bool = True
    names: bool = False


class Scene:
    """One run in a viser scene.

    Args:
        server: Where to draw.
        root: Path of everything drawn, to keep two runs apart.
        tint: Colour (3,) uint8 of everybody, to tell two runs apart; None for own colours.
        offset: World x, y by which everything is moved [m].
        ground: Whether the place is drawn too.
        trails: Gives the ways of the whole run, once they are to be shown.
    """

    def __init__(
        self,
        server: "viser.ViserServer",
        root: str = "/run",
        tint: np.ndarray | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
        ground: bool = True,
        trails: Callable[[], Trails] | None = None,
    ) -> None:
        self.shown = Shown()
        self.selected: int | None = None
        self._server = server
        self._root = root
        self._tint = tint
        self.trails = trails
        self._offset = np.array([*offset, 0.0])
        self._parts: list[tuple[Part, Any]] = []
        self._row_of: dict[int, int] = {}
        self._radii = np.zeros(0)
        self._present = np.zeros(0, bool)
        self._handles: dict[str, Any] = {}
        self._trails_drawn = -1
        self._labels: dict[str, Any] = {}
        self._frame = server.scene.add_frame(root, show_axes=False, position=self._offset)
        self._place = PlaceDrawing(server, root) if ground else None

    def draw(self, picture: Picture, everything: bool = False) -> None:
        """Bring the scene up to date with a picture, whose changes are then forgotten."""
        changed = picture.changed
        with self._server.atomic():
            if (MAP.name in changed or everything) and self._place is not None:
                self._place.draw(picture, self.shown.obstacles, self.shown.buildings)
            if BODIES.name in changed:
                self._dress(picture)
            if everything or {BODY_STATES.name, AGENTS.name} & changed:
                self._draw_people(picture)
                self._draw_shades(picture)
                self._draw_disks(picture)
                self._draw_groups(picture)
                self._draw_labels(picture)
            if everything or AGENTS.name in changed:
                self._draw_tracks(picture)
                self._draw_trails(picture)
            if everything or {PLANS.name, AGENTS.name} & changed:
                self._draw_plans(picture)
            if everything or PLANS.name in changed:
                self._draw_samples(picture)
            if everything or OBJECTIVES.name in changed:
                self._draw_waypoints(picture)
            if everything or {CONTACTS.name, FALLS.name} & changed:
                self._draw_contacts(picture)
        picture.changed = set()

    def move(self, offset: tuple[float, float]) -> None:
        """Draw everything so far from where it is, world x, y [m]."""
        self._frame.position = (*offset, 0.0)

    def remove(self) -> None:
        """Take everything away."""
        self._frame.remove()

    # -- people

    def _dress(self, picture: Picture) -> None:
        bodies, scene = picture.bodies, self._server.scene
        for _, handle in self._parts:
            handle.remove()
        self._parts = []
        if bodies is None or not len(bodies.ids):
            return
        count = len(bodies.ids)
        self._row_of = {agent: row for row, agent in enumerate(bodies.ids.tolist())}
        self._radii = bodies.radii.astype(np.float64)
        self._present = np.zeros(count, bool)
        for number, part in enumerate(dressed(bodies, self._tint)):
            handle = scene.add_batched_meshes_simple(
                f"{self._root}/people/{number}",
                part.vertices.astype(np.float32),
                part.faces.astype(np.uint32),
                np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
                np.zeros((count, 3), np.float32),
                batched_scales=np.full((count, 3), 1e-6, np.float32),
                batched_colors=in_linear_light(part.colours),
                receive_shadow=False,
            )
            self._parts.append((part, handle))

    def _draw_people(self, picture: Picture) -> None:
        states = picture.states
        if not self._parts or states is None:
            return
        visible = self.shown.people
        known = np.array([agent in self._row_of for agent in states.ids.tolist()], dtype=bool)
        rows = np.array([self._row_of[a] for a in states.ids[known].tolist()], dtype=int)
        present = np.zeros(len(self._present), bool)
        present[rows] = visible
        positions = np.zeros((len(present), 3), np.float32)
        rotations = np.tile(np.array([1, 0, 0, 0], np.float32), (len(present), 1))
        shown_changed = not np.array_equal(present, self._present)
        self._present = present
        for part, handle in self._parts:
            positions[rows] = states.positions[known, part.body]
            rotations[rows] = states.rotations[known, part.body]
            handle.batched_positions = positions
            handle.batched_wxyzs = rotations
            if shown_changed:
                handle.batched_scales = np.where(present[:, None], part.scales, 1e-6)

    def _draw_disks(self, picture: Picture) -> None:
        ids, xy = picture.places()
        if not self.shown.disks or not ids:
            self._drop("disks")
            return
        radii = np.array([self._radii[self._row_of[a]] if a in self._row_of else DEFAULT_RADIUS for a in ids])
        colours = self._colours(np.array(ids))
        if self.selected in ids:
            colours[ids.index(self.selected)] = (20, 20, 20)
        positions = picture.on_ground(xy, 0.03).astype(np.float32)
        scales = np.column_stack([radii, radii, np.ones(len(ids))]).astype(np.float32)
        self._batch("disks", RING, positions, scales, colours)

    def _draw_shades(self, picture: Picture) -> None:
        """A dark spot under everybody: the sun's shadows end some way from the camera."""
        ids, xy = picture.places()
        if not self.shown.people or not ids:
            self._drop("shades")
            return
        positions = picture.on_ground(xy, 0.015).astype(np.float32)
        scales = np.full((len(ids), 3), SHADE_RADIUS, np.float32)
        self._batch("shades", SPOT, positions, scales, np.zeros((len(ids), 3), np.uint8), SHADE)

    def _draw_groups(self, picture: Picture) -> None:
        ids, xy = picture.places()
        where = dict(zip(ids, xy, strict=True))
        pairs = [
            (where[group.leader], where[member])
            for group in picture.objectives.groups
            for member in group.members
            if member != group.leader and member in where and group.leader in where
        ]
        segments = np.array(pairs).reshape(-1, 2, 2) if self.shown.groups else np.zeros((0, 2, 2))
        self._lines(
            "groups", picture.on_ground(segments, 0.05), np.full((len(segments), 3), 60, np.uint8), 3.0
        )

    def _draw_labels(self, picture: Picture) -> None:
        """Names over heads: of everybody, of who is selected, of who has just fallen."""
        ids, xy = picture.places()
        texts: dict[str, tuple[str, np.ndarray]] = {}
        for agent, here in zip(ids, picture.on_ground(xy, 2.0), strict=True):
            if self.shown.names or agent == self.selected:
                texts[f"name{agent}"] = (f"#{agent}", here)
        for fall in picture.recent_falls():
            texts[f"fall{fall.agent}"] = (
                f"#{fall.agent} has fallen",
                fall.position + np.array([0.0, 0.0, 1.0]),
            )
        for key in set(self._labels) - set(texts):
            self._labels.pop(key).remove()
        for key, (text, place) in texts.items():
            if key in self._labels:
                self._labels[key].position = place
            else:
                self._labels[key] = self._server.scene.add_label(
                    f"{self._root}/labels/{key}", text, position=place, anchor="bottom-center"
                )

    # -- where they have been, are going, want to go

    def _draw_tracks(self, picture: Picture) -> None:
        agents = picture.agents
        if not self.shown.tracks or agents is None or not len(agents.ids):
            self._lines("tracks", np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), 2.0)
            return
        past = agents.history[:, ::-2][:, ::-1].astype(np.float64)  # every 0.2 s, up to now
        segments = np.stack([past[:, :-1, :2], past[:, 1:, :2]], axis=2)  # (N, T, 2, 2)
        there = (past[:, :-1, 6] > 0) & (past[:, 1:, 6] > 0)
        colours = self._colours(agents.ids)[:, None].repeat(segments.shape[1], axis=1)
        self._lines("tracks", picture.on_ground(segments[there], 0.03), colours[there] // 2, 2.0)

    def _draw_trails(self, picture: Picture) -> None:
        """Everybody's way since the beginning, as far as it leads up to now."""
        if not self.shown.trails or self.trails is None:
            self._drop("trails")
            self._trails_drawn = -1
            return
        ids, segments = self.trails().until(picture.now_ns)
        if len(ids) != self._trails_drawn:  # they grow much more rarely than people move
            self._trails_drawn = len(ids)
            self._lines("trails", picture.on_ground(segments, 0.02), self._colours(ids), 1.5)

    def _draw_plans(self, picture: Picture) -> None:
        plans = picture.plans
        if not self.shown.plans or plans is None or not len(plans.ids):
            self._lines("plans", np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), 4.0)
            return
        here = dict(zip(*picture.places(), strict=True))
        rows = [row for row, agent in enumerate(plans.ids.tolist()) if agent in here]
        first = picture.still_ahead()
        chosen = plans.positions[rows, plans.chosen[rows]][:, first:].astype(np.float64)  # (N, T, 2)
        start = np.array([here[agent] for agent in plans.ids[rows].tolist()]).reshape(-1, 1, 2)
        way = np.concatenate([start, chosen], axis=1)
        self._lines("plans", *self._ways(picture, way, plans.ids[rows], 0.06), 4.0)

    def _draw_samples(self, picture: Picture) -> None:
        plans = picture.plans
        if not self.shown.samples or plans is None or plans.positions.shape[1] < 2:
            self._lines("samples", np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), 1.0)
            return
        n, s = plans.positions.shape[:2]
        way = plans.positions[:, :, ::SAMPLE_STRIDE].astype(np.float64).reshape(n * s, -1, 2)
        points, colours = self._ways(picture, way, plans.ids.repeat(s), 0.05)
        faint = (255 * FAINT + (1 - FAINT) * colours).astype(np.uint8)
        self._lines("samples", points, faint, 1.0)

    def _ways(
        self, picture: Picture, way: np.ndarray, ids: np.ndarray, above: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Segments (K, 2, 3) and colours (K, 3) of ways (N, T, 2)."""
        segments = np.stack([way[:, :-1], way[:, 1:]], axis=2)
        colours = self._colours(ids)[:, None].repeat(segments.shape[1], axis=1)
        return picture.on_ground(segments.reshape(-1, 2, 2), above), colours.reshape(-1, 3)

    def _draw_waypoints(self, picture: Picture) -> None:
        goals = [
            (agent.id, wish.position)
            for agent in picture.objectives.agents
            for wish in agent.objectives
            if isinstance(wish, Waypoint)
        ]
        if not self.shown.waypoints or not goals:
            self._drop("waypoints")
            return
        xy = np.array([goal for _, goal in goals])
        colours = self._colours(np.array([agent for agent, _ in goals]))
        positions = picture.on_ground(xy, 0.0).astype(np.float32)
        self._batch("waypoints", PIN, positions, np.ones((len(goals), 3), np.float32), colours)

    def _draw_contacts(self, picture: Picture) -> None:
        contacts = picture.contacts
        if not self.shown.contacts or contacts is None or not len(contacts.positions):
            self._drop("contacts")
            return
        count = len(contacts.positions)
        colours = np.tile(np.array([226, 30, 40], np.uint8), (count, 1))
        sizes = 1.0 + np.minimum(contacts.forces / 500.0, 2.0)
        scales = sizes[:, None].repeat(3, axis=1).astype(np.float32)
        self._batch("contacts", KNOB, contacts.positions.astype(np.float32), scales, colours)

    # -- viser

    def _colours(self, ids: np.ndarray) -> np.ndarray:
        return colours_of(ids) if self._tint is None else np.tile(self._tint, (len(ids), 1))

    def _lines(self, name: str, points: np.ndarray, colours: np.ndarray, width: float) -> None:
        """Line segments (K, 2, 3) [m] of colours (K, 3), `width` pixels wide."""
        if not len(points):
            self._drop(name)
            return
        points = points.astype(np.float32)
        both = in_linear_light(colours)[:, None].repeat(2, axis=1)
        handle = self._handles.get(name)
        if handle is not None and len(handle.points) == len(points):
            handle.points = points
            handle.colors = both
            return
        self._handles[name] = self._server.scene.add_line_segments(
            f"{self._root}/{name}", points, both, thickness=width, thickness_units="screen"
        )

    def _batch(
        self,
        name: str,
        mesh: Mesh,
        positions: np.ndarray,
        scales: np.ndarray,
        colours: np.ndarray,
        opacity: float | None = None,
    ) -> None:
        """Copies of a small mesh at positions (K, 3) [m]."""
        colours = in_linear_light(colours)
        handle = self._handles.get(name)
        if handle is not None and len(handle.batched_positions) == len(positions):
            handle.batched_positions = positions
            handle.batched_scales = scales
            handle.batched_colors = colours
            return
        self._handles[name] = self._server.scene.add_batched_meshes_simple(
            f"{self._root}/{name}",
            *mesh,
            np.tile(np.array([1, 0, 0, 0], np.float32), (len(positions), 1)),
            positions,
            batched_scales=scales,
            batched_colors=colours,
            opacity=opacity,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
            side="double",
        )

    def _drop(self, name: str) -> None:
        if name in self._handles:
            self._handles.pop(name).remove()
