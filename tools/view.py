"""`footfall view`: recorded runs, rollouts and motions in a browser, to scrub, play and compare."""

import argparse
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from ..messages.config import ConfigError
from .view_time_line import TimeBar, TimeLine, play

if TYPE_CHECKING:
    import viser

    from ..nodes.viewer_scene import Scene
    from .view_motion import MotionViewer

READOUT_PERIOD = 0.3
"""Wall time between updates of the read-outs [s]."""
TINTS = (np.array([46, 110, 190], np.uint8), np.array([222, 122, 30], np.uint8))
"""Colours of two runs that are compared."""
BESIDE_GAP = 4.0
"""Gap between two runs side by side [m]."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `view` to the command line."""
    parser = subparsers.add_parser(
        "view",
        help="look at recorded runs and motions in a browser",
        description="Show one log, or two to compare, in a browser; or a policy's rollout; or a motion (BVH,"
        " AMC, DeepMimic's JSON, AMASS, a motion library) beside what our body makes of it. Ctrl-C ends it.",
    )
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="a log, two logs to compare, a rollout or a motion",
    )
    parser.add_argument("--beside", action="store_true", help="two logs side by side instead of overlaid")
    parser.add_argument("--start", type=float, metavar="S", help="simulation time to begin at [s]")
    parser.add_argument("--play", action="store_true", help="begin playing at once")
    parser.add_argument("--loop", action="store_true", help="begin anew at the end")
    motion = parser.add_argument_group("motions")
    motion.add_argument("--clip", metavar="NAME", help="which of several to begin with")
    motion.add_argument("--asf", type=Path, help="skeleton of an AMC (default: the one beside it)")
    motion.add_argument(
        "--unit", type=float, metavar="M", help="metres per unit of a BVH (default: by its size)"
    )
    motion.add_argument(
        "--fps", type=float, default=0.0, help="of a BVH or AMC whose own is missing or wrong"
    )
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
    from .motion_take import MOTION_FILES

    motions = [path for path in args.files if path.suffix.lower() in MOTION_FILES]
    if len(args.files) > 2 or (motions and len(args.files) > 1):
        what = "one motion is shown at a time" if motions else "one log can be shown, or two compared"
        raise ConfigError(f"{len(args.files)} files: {what}")
    window = None
    try:
        title = " and ".join(path.name for path in args.files)
        opener = _read(args, bool(motions))
        window = Window(args.host, args.port, title, token_for(args.host, args.token))
        viewer = opener(window.server)
        line = viewer.time_line
        line.seek(args.start if args.start is not None else line.start)
        line.playing, line.loop = args.play, args.loop
        print(f"{title}: {line.start:g} to {line.end:g} s, open {window.url}", flush=True)
        viewer.run()
    finally:
        if window is not None:
            window.close()
    return 0


def _read(
    args: argparse.Namespace, motion: bool
) -> "Callable[[viser.ViserServer], LogViewer | MotionViewer]":
    """Read the files, and say how to show them."""
    from .view_motion import MotionViewer

    if motion:
        from .motion_take import read_takes

        takes = read_takes(args.files[0], args.asf, args.unit, args.fps)
        return lambda server: MotionViewer(server, takes, args.clip)
    from ..messages.log import LogReader
    from .rollout_log import is_rollout, read_rollout
    from .view_log import LogPictures

    if len(args.files) == 1 and is_rollout(LogReader(args.files[0])):
        takes = read_rollout(args.files[0])
        return lambda server: MotionViewer(server, takes, args.clip)
    runs = [LogPictures(path) for path in args.files]
    return lambda server: LogViewer(server, runs, args.beside)


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
        self._bar = TimeBar(server, self.time_line)
        self.scenes = self._scenes(beside)
        self.panels = Panels(server, self.scenes)
        self._clicks = Clicks(server, lambda: self.runs[0].picture, self.panels.select)
        look_at_place(server, self.runs[0].show(self.start))

    def _scenes(self, beside: bool) -> "list[Scene]":
        from ..nodes.viewer_scene import Scene

        if len(self.runs) == 1:
            return [Scene(self.server, trails=self.runs[0].trails)]
        shift = 0.0
        place = self.runs[0].show(self.start).place
        if beside and place is not None:
            shift = place.raster.shape[2] * place.resolution + BESIDE_GAP
        first, second = self.runs
        tints = (None, None) if beside else TINTS
        return [
            Scene(self.server, "/first", tints[0], trails=first.trails),
            Scene(self.server, "/second", tints[1], (shift, 0.0), ground=beside, trails=second.trails),
        ]

    def run(self) -> None:
        """Show, until interrupted."""
        play(self.time_line, self.refresh)

    def refresh(self) -> None:
        """Show the moment the time line is at."""
        time = self.time_line.time
        everything, self.panels.stale = self.panels.stale, False
        pictures = [run.show(time) for run in self.runs]
        for scene, picture in zip(self.scenes, pictures, strict=True):
            scene.draw(picture, everything)
        self._bar.update()
        self.panels.steer_camera(pictures[0])
        now = monotonic()
        if everything or now - getattr(self, "_read_out", 0.0) > READOUT_PERIOD:
            self._read_out = now
            self.panels.update(pictures[0], pictures[1:])
