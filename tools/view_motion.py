"""A motion in a window: our body beside what it follows, foot contacts, joint curves, reward terms."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..messages.body import Bodies, BodyStates
from ..messages.config import ConfigError, near
from ..messages.topics import BODIES, BODY_STATES
from ..models.body import BODY_INDEX, BODY_NAMES, describe
from ..nodes.viewer_picture import Picture
from ..nodes.viewer_scene import Scene
from ..nodes.viewer_shapes import SPOT
from .motion_take import Take, joint_angles
from .view_time_line import TimeBar, TimeLine, play

if TYPE_CHECKING:
    import viser

LANE = 1.1
"""How far to its left the reference is shown [m]."""
REFERENCE_TINT = np.array([150, 190, 235], np.uint8)
"""Colour of the body that was to be followed."""
SKELETON_COLOUR, FOOT_COLOUR = (40, 90, 150), (235, 120, 30)
FLOOR = (196, 200, 204)
CURVE_SPAN = 4.0
"""Time that a plot shows, now in its middle [s]."""
CURVE_POINTS = 160
CURVE_PERIOD = 0.25
"""Wall time between updates of the plot [s]."""
REWARD, FEET = "reward terms", "feet on the ground"
COLOURS = ("#d1493f", "#3a9a5b", "#3573bd", "#8c5aa8", "#d08a26", "#3aa0b0", "#666666", "#c0709a")
_FEET = (("left heel", "left ball"), ("right heel", "right ball"))


class MotionViewer:
    """Takes in a window, one at a time.

    Args:
        server: Where to draw.
        takes: What can be looked at.
        name: Which first; None for the first.

    Raises:
        ConfigError: there is no take of that name.
    """

    def __init__(self, server: viser.ViserServer, takes: Sequence[Take], name: str | None = None) -> None:
        names = [take.name for take in takes]
        if name is not None and name not in names:
            raise ConfigError(f"there is no clip {name!r}; {near(name, names)}")
        self.takes = list(takes)
        self.take = self.takes[0 if name is None else names.index(name)]
        self.time_line = TimeLine(self.take.begin, self.take.end)
        self._server = server
        self._bar = TimeBar(server, self.time_line, 1 / self.take.rate_hz)
        self._scene: Scene | None = None
        self._beside: Scene | None = None
        self._drawn: dict[str, Any] = {}
        self._plot: Any = None
        self._plotted = 0.0
        self._series: list[tuple[str, NDArray, str]] = []
        self._add_controls(names)
        server.scene.add_grid(
            "/floor",
            60.0,
            60.0,
            cell_size=0.5,
            section_size=1.0,
            fade_distance=40.0,
            plane_color=FLOOR,
            plane_opacity=1.0,
            shadow_opacity=0.3,
        )
        self._show(self.take)
        server.initial_camera.position = (1.2, -3.0, 1.5)
        server.initial_camera.look_at = (0.0, 0.4, 0.9)

    def _add_controls(self, names: list[str]) -> None:
        gui = self._server.gui
        if len(names) > 1:
            choice = gui.add_dropdown("Clip", names, initial_value=self.take.name)
            choice.on_update(lambda _: self._show(self.takes[names.index(choice.value)]))
        self._along = gui.add_checkbox("Camera goes along", True)
        self._overlay = gui.add_checkbox("On one spot", False, hint="draw body and reference in one place")
        self._overlay.on_update(lambda _: self._move())
        self._what = gui.add_dropdown("Curves", ["-"])
        self._what.on_update(lambda _: self._choose_curves())
        self._text = gui.add_html("")

    def _show(self, take: Take) -> None:
        """Look at another take."""
        self.take = take
        line = self.time_line
        line.start, line.end, line.time = take.begin, take.end, take.begin
        self._bar.stretch()
        for scene in (self._scene, self._beside):
            if scene is not None:
                scene.remove()
        for handle in self._drawn.values():
            handle.remove()
        self._drawn = {}
        self._scene = self._person("/body", None)
        self._beside = None if take.reference is None else self._person("/reference", REFERENCE_TINT)
        choices = [*([REWARD] if take.terms else []), *([FEET] if take.contacts is not None else [])]
        choices += list(BODY_NAMES[1:])
        self._what.options = choices
        self._what.value = REWARD if take.terms else "L_Knee"
        self._choose_curves()
        self._centre = take.states[0, 0, :3].astype(float)
        self._move()

    def _person(self, root: str, tint: np.ndarray | None) -> Scene:
        person = describe(self.take.shape)
        bodies = Bodies(
            np.zeros(1, np.int32),
            self.take.shape[None].astype(np.float32),
            np.array([person.mass], np.float32),
            np.array([person.stature], np.float32),
            np.array([person.radius], np.float32),
            person.offsets[None].astype(np.float32),
        )
        scene = Scene(self._server, root, tint, ground=False)
        scene.shown.disks = False
        picture = Picture()
        picture.take(BODIES.name, bodies, 0)
        scene.draw(picture)
        return scene

    def _move(self) -> None:
        """Put the reference on the next lane, or on the same spot."""
        aside = 0.0 if self._overlay.value else LANE
        if self._beside is not None:
            self._beside.move((0.0, aside))
        self._aside = np.array([0.0, aside, 0.0])

    def run(self) -> None:
        """Show, until interrupted."""
        play(self.time_line, self.refresh)

    def refresh(self) -> None:
        """Show the moment the time line is at."""
        take, frame = self.take, self.take.frame_at(self.time_line.time)
        with self._server.atomic():
            self._draw_body(self._scene, take.states[frame])
            if take.reference is not None:
                self._draw_body(self._beside, take.reference[frame])
            self._draw_skeleton(frame)
            self._draw_feet(frame)
        self._bar.update()
        if self._along.value:
            self._follow(take.states[frame, 0, :3].astype(float))
        if monotonic() - self._plotted > CURVE_PERIOD:
            self._plotted = monotonic()
            self._draw_curves()
            self._text.content = self._facts(frame)

    @staticmethod
    def _draw_body(scene: Scene | None, state: np.ndarray) -> None:
        if scene is None:
            return
        joints = np.zeros((1, len(BODY_NAMES), 13), np.float32)
        joints[0, :, : state.shape[1]] = state[:, :13]
        picture = Picture()
        picture.take(BODY_STATES.name, BodyStates(np.zeros(1, np.int32), joints), 0)
        scene.draw(picture)

    def _draw_skeleton(self, frame: int) -> None:
        take = self.take
        if take.skeleton is None:
            return
        places = take.skeleton[frame] + self._aside
        pairs = [(joint, parent) for joint, parent in enumerate(take.parents) if parent >= 0]
        points = places[np.array(pairs)].astype(np.float32)
        if "skeleton" in self._drawn:
            self._drawn["skeleton"].points = points
            return
        self._drawn["skeleton"] = self._server.scene.add_line_segments(
            "/skeleton", points, SKELETON_COLOUR, thickness=5.0, thickness_units="screen"
        )

    def _draw_feet(self, frame: int) -> None:
        """A disk under each heel and ball that stands."""
        take = self.take
        if take.contacts is None:
            return
        bodies = [BODY_INDEX[name] for name in ("L_Ankle", "L_Toe", "R_Ankle", "R_Toe")]
        places = take.states[frame, bodies, :3].astype(np.float32)
        places[:, 2] = 0.006
        standing = take.contacts[frame].reshape(-1)
        scales = np.where(standing[:, None], np.float32(0.11), np.float32(1e-6)).repeat(3, axis=1)
        if "feet" in self._drawn:
            self._drawn["feet"].batched_positions = places
            self._drawn["feet"].batched_scales = scales
            return
        self._drawn["feet"] = self._server.scene.add_batched_meshes_simple(
            "/feet",
            *SPOT,
            np.tile(np.array([1, 0, 0, 0], np.float32), (4, 1)),
            places,
            batched_scales=scales,
            batched_colors=FOOT_COLOUR,
            lod="off",
            cast_shadow=False,
        )

    def _follow(self, centre: np.ndarray) -> None:
        """Take the cameras along, level."""
        moved = (centre - self._centre) * [1.0, 1.0, 0.0]
        self._centre = centre
        if not moved.any():
            return
        self._server.initial_camera.position = np.array(self._server.initial_camera.position) + moved
        self._server.initial_camera.look_at = np.array(self._server.initial_camera.look_at) + moved
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position = np.asarray(client.camera.position) + moved
                client.camera.look_at = np.asarray(client.camera.look_at) + moved

    # -- curves

    def _choose_curves(self) -> None:
        """Plot something else."""
        self._series = curves_of(self.take, self._what.value)
        if self._plot is not None:
            self._plot.remove()
        series: list[Any] = [{"label": "s"}]
        for number, (label, _, dash) in enumerate(self._series):
            style: dict[str, Any] = {"label": label, "stroke": COLOURS[number % len(COLOURS)], "width": 2}
            if dash:
                style |= {"dash": (4, 4), "stroke": COLOURS[number % 3]}
            series.append(style)
        series.append({"label": "now", "stroke": "#222222", "width": 1})
        self._plot = self._server.gui.add_uplot(
            self._window(),
            tuple(series),
            aspect=1.5,
            legend={"show": True},
            scales={"x": {"time": False}},
        )

    def _draw_curves(self) -> None:
        self._plot.data = self._window()

    def _window(self) -> tuple[np.ndarray, ...]:
        """Times about now, the curves there, and a line at now."""
        now = self.time_line.time
        low = max(self.take.begin, min(now - CURVE_SPAN / 2, self.take.end - CURVE_SPAN))
        times = np.linspace(low, min(low + CURVE_SPAN, self.take.end), CURVE_POINTS)
        mark = int(np.searchsorted(times, now, side="right"))
        frames = self.take.begin + np.arange(len(self.take)) / self.take.rate_hz
        curves = [np.interp(times, frames, curve) for _, curve, _ in self._series]
        bounds = np.concatenate(curves) if curves else np.zeros(1)
        line = np.full(len(times), np.nanmin(bounds))  # a spike: what is not a number spoils the plot's scale
        return (
            np.insert(times, mark, [now] * 3),
            *(np.insert(curve, mark, np.interp([now] * 3, times, curve)) for curve in curves),
            np.insert(line, mark, [np.nanmin(bounds), np.nanmax(bounds), np.nanmin(bounds)]),
        )

    def _facts(self, frame: int) -> str:
        """Where, how fast, and how far from the reference."""
        take = self.take
        before, after = max(frame - 3, 0), min(frame + 3, len(take) - 1)
        way = take.states[after, 0, :2] - take.states[before, 0, :2]
        speed = float(np.linalg.norm(way)) * take.rate_hz / max(after - before, 1)
        rows = [("frame", f"{frame + 1} of {len(take)}"), ("speed", f"{speed:.2f} m/s")]
        if take.reference is not None:
            away = np.linalg.norm(take.states[frame, :, :3] - take.reference[frame, :, :3], axis=-1)
            rows.append(("mean joint distance", f"{1000 * away.mean():.0f} mm"))
            rows.append(("farthest", f"{BODY_NAMES[int(away.argmax())]}, {1000 * away.max():.0f} mm"))
        rows += [(name, f"{values[frame]:.3f}") for name, values in take.terms.items()]
        if take.contacts is not None:
            for side, names in enumerate(_FEET):
                on = [name for part, name in enumerate(names) if take.contacts[frame, side, part]]
                rows.append(
                    (names[0].split()[0] + " foot", ", ".join(n.split()[1] for n in on) or "in the air")
                )
        cells = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
        return f'<div style="font-size:0.8em;padding:0 0.8em"><table style="width:100%">{cells}</table></div>'


def curves_of(take: Take, what: str) -> list[tuple[str, NDArray, str]]:
    """Labels, values (T,) and `dash` for the reference's, of what can be plotted."""
    if what == REWARD:
        return [(name, values, "") for name, values in take.terms.items()]
    if what == FEET:
        assert take.contacts is not None
        return [
            (_FEET[side][part], 0.8 * take.contacts[:, side, part] + 3 - 2 * side - part, "")
            for side in range(2)
            for part in range(2)
        ]
    own = np.degrees(joint_angles(take.states, what))
    found = [(f"{axis} [deg]", own[:, i], "") for i, axis in enumerate("xyz")]
    if take.reference is not None:
        wanted = np.degrees(joint_angles(take.reference, what))
        found += [(f"{axis} wanted", wanted[:, i], "dash") for i, axis in enumerate("xyz")]
    return found
