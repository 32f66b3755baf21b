"""`footfall view`: recorded runs in a browser, to scrub, play and compare."""

import argparse
import secrets
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING

import numpy as np

from ..messages.config import ConfigError

if TYPE_CHECKING:
    import viser

    from ..nodes.viewer_scene import Scene

FRAME_RATE_HZ = 20
"""Pictures a second."""
READOUT_PERIOD = 0.3
"""Wall time between updates of the read-outs [s]."""
TINTS = (np.array([46, 110, 190], np.uint8), np.array([222, 122, 30], np.uint8))
"""Colours of two runs that are compared."""
BESIDE_GAP = 4.0
"""Gap between two runs side by side [m]."""
BUTTONS = ("Start", "Back", "Play / pause", "On")
SPEEDS: tuple[str, ...] = ("0.25", "0.5", "1", "2", "4", "8")


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `view` to the command line."""
    parser = subparsers.add_parser(
        "view",
        help="look at recorded runs in a browser",
        description="Show one log, or two to compare, in a browser. Ctrl-C ends it.",
    )
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG", help="one log, or two to compare")
    parser.add_argument("--beside", action="store_true", help="two logs side by side instead of overlaid")
    parser.add_argument("--start", type=float, metavar="S", help="simulation time to begin at [s]")
    parser.add_argument("--play", action="store_true", help="begin playing at once")
    parser.add_argument("--loop", action="store_true", help="begin anew at the end")
    add_address(parser)


def add_address(parser: argparse.ArgumentParser, port: int = 8080) -> None:
    """Where the window is served."""
    parser.add_argument("--port", type=int, default=port, help=f"TCP port; 0 is any (default {port})")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen at; 0.0.0.0 lets other machines in who know the token (default 127.0.0.1)",
    )
    parser.add_argument("--token", help="what a browser elsewhere must know (default: a new one)")


def token_for(host: str, token: str | None) -> str | None:
    """The token to ask for: none on loopback unless one is given."""
    from ..nodes.viewer_server import LOOPBACK

    return token or (None if host in LOOPBACK else secrets.token_hex(16))


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from ..nodes.viewer_server import Window

    if len(args.logs) > 2:
        raise ConfigError(f"{len(args.logs)} logs: one can be shown, or two compared")
    window = None
    try:
        from .view_log import LogPictures

        runs = [LogPictures(path) for path in args.logs]
        title = " and ".join(path.name for path in args.logs)
        window = Window(args.host, args.port, title, token_for(args.host, args.token))
        viewer = LogViewer(window.server, runs, args.beside)
        viewer.time_line.seek(args.start if args.start is not None else viewer.start)
        viewer.time_line.playing = args.play
        viewer.time_line.loop = args.loop
        print(f"{title}: {viewer.start:g} to {viewer.end:g} s, open {window.url}", flush=True)
        viewer.run()
    finally:
        if window is not None:
            window.close()
    return 0


class TimeLine:
    """Where in the run one is: play, pause, scrub, loop.

    Args:
        start: First simulation time [s].
        end: Last simulation time [s].
    """

    def __init__(self, start: float, end: float) -> None:
        self.start, self.end = start, max(end, start)
        self.time = start
        self.playing = False
        self.loop = False
        self.speed = 1.0

    def seek(self, time: float) -> None:
        """Go to a time [s], or to the nearest there is."""
        self.time = min(max(time, self.start), self.end)

    def advance(self, wall: float) -> None:
        """Let wall time pass [s]."""
        if not self.playing:
            return
        time = self.time + wall * self.speed
        if time < self.end:
            self.time = time
        elif self.loop:
            length = self.end - self.start
            self.time = self.start + ((time - self.start) % length if length > 0 else 0.0)
        else:
            self.time = self.end
            self.playing = False


class LogViewer:
    """One or two logs in a window, on one time line."""

    def __init__(self, server: "viser.ViserServer", runs: Sequence, beside: bool = False) -> None:
        from ..nodes.viewer_clicks import Clicks
        from ..nodes.viewer_panels import Panels
        from ..nodes.viewer_place import look_at_place

        self.runs = runs
        self.start = min(run.start for run in runs)
        self.end = max(run.end for run in runs)
        self.time_line = TimeLine(self.start, self.end)
        self.server = server
        self._add_time_line()
        self.scenes = self._scenes(beside)
        self.panels = Panels(server, self.scenes)
        self._clicks = Clicks(server, lambda: self.runs[0].picture, self.panels.select)
        look_at_place(server, self.runs[0].show(self.start))

    def _scenes(self, beside: bool) -> "list[Scene]":
        from ..nodes.viewer_scene import Scene

        if len(self.runs) == 1:
            return [Scene(self.server)]
        shift = 0.0
        place = self.runs[0].show(self.start).place
        if beside and place is not None:
            shift = place.raster.shape[2] * place.resolution + BESIDE_GAP
        return [
            Scene(self.server, "/first", None if beside else TINTS[0]),
            Scene(self.server, "/second", None if beside else TINTS[1], (shift, 0.0), ground=beside),
        ]

    def _add_time_line(self) -> None:
        gui, line = self.server.gui, self.time_line
        span = max(self.end - self.start, 0.01)
        self._slider = gui.add_slider(
            "Time [s]", self.start, self.start + span, round(span / 2000, 3) or 0.001, self.start
        )
        self._buttons = gui.add_button_group("", BUTTONS)
        self._speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._loop = gui.add_checkbox("Loop", False)
        self._loop.on_update(lambda _: setattr(line, "loop", self._loop.value))
        self._speed.on_update(lambda _: setattr(line, "speed", float(self._speed.value)))

        @self._slider.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is not None:
                line.seek(self._slider.value)

        @self._buttons.on_click
        def _(event: "viser.GuiEvent") -> None:
            match self._buttons.value:
                case "Start":
                    line.seek(line.start)
                case "Back":
                    line.seek(line.time - 0.1)
                case "On":
                    line.seek(line.time + 0.1)
                case _:
                    if not line.playing and line.time >= line.end:
                        line.seek(line.start)
                    line.playing = not line.playing

    def run(self) -> None:
        """Show, until interrupted."""
        self._loop.value = self.time_line.loop
        last = monotonic()
        while True:
            begin = monotonic()
            self.time_line.advance(begin - last)
            last = begin
            self.refresh()
            sleep(max(0.0, 1 / FRAME_RATE_HZ - (monotonic() - begin)))

    def refresh(self) -> None:
        """Show the moment the time line is at."""
        time = self.time_line.time
        everything, self.panels.stale = self.panels.stale, False
        pictures = [run.show(time) for run in self.runs]
        for scene, picture in zip(self.scenes, pictures, strict=True):
            scene.draw(picture, everything)
        if abs(self._slider.value - time) > self._slider.step:
            self._slider.value = time
        self.panels.steer_camera(pictures[0])
        now = monotonic()
        if everything or now - getattr(self, "_read_out", 0.0) > READOUT_PERIOD:
            self._read_out = now
            self.panels.update(pictures[0], pictures[1:])
