"""`footfall bench viewer`: what the window costs a running crowd, and how soon a click shows in a plan.

One run, in turns: the viewer's process stands still (as if there were none), or draws for one client that
reads all it is sent, as a browser does. Real-time factors, updates a second and processor time are counted
over many short turns, so that whatever else the machine does weighs on both alike. At real time updates are
counted again, and waypoints set the way the window sets them; the first plan made with each is waited for.
"""

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from ..messages.config import ConfigError

WARM_UP = 12.0
"""Simulated time before anything is measured: by then everybody is there [s]."""
PATIENCE = 120.0
"""Longest wait for the run to begin, for a click to show, and for the warm-up's each simulated second [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument("--scene", default="plaza", help="launch file or scene (default %(default)s)")
    parser.add_argument("--planner", default="orca", help="default %(default)s")
    parser.add_argument("--people", type=int, default=100, help="default %(default)s")
    parser.add_argument("--turns", type=int, default=8, help="of each kind (default %(default)s)")
    parser.add_argument("--turn", type=float, default=6.0, metavar="S", help="wall time of one (default 6)")
    parser.add_argument("--clicks", type=int, default=10, help="waypoints set (default %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Measure, and print the figures."""
    figures = measure(args.scene, args.planner, args.people, args.turns, args.turn, args.clicks)
    if args.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:<28} {value:.3g}" if isinstance(value, float) else f"{name:<28} {value}")
    return 0


class Run:
    """A graph with a viewer, watched from outside.

    Raises:
        ConfigError: it does not start.
    """

    def __init__(self, scene: str, planner: str, people: int, folder: Path) -> None:
        from ..launch.running import find_graph
        from .observe import observer

        home = folder / "run"
        self._log = (folder / "launch.log").open("w+")
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", f"{__package__}.cli", "launch", scene, "--set", f"count={people}"),
                *("--set", f"planner={planner}"),
                *("--view", "0", "--rate", "1000", "--run-dir", str(home), "--quiet"),
            ],
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        deadline = monotonic() + PATIENCE
        while True:
            try:
                self.graph = find_graph(str(home))
                break
            except ConfigError:
                if self._process.poll() is not None or monotonic() > deadline:
                    said = self.said()
                    self._log.close()
                    raise ConfigError(f"the graph does not start: {said}") from None
                sleep(0.2)
        self._bus = observer(self.graph, ["clock", "objectives", "plans", "diagnostics"])
        self.now = 0.0
        """Simulation time [s]."""
        self.pid = 0
        """The viewer's process."""
        self.drawn: list[tuple[float, int]] = []
        """Wall time [s] and pictures the viewer had drawn by then, about once a second."""

    @property
    def url(self) -> str:
        """Where the window is."""
        host, port = (self.graph.node("viewer").config[key] for key in ("host", "port"))
        return f"http://{host}:{port}"

    def said(self) -> str:
        """The end of what the launcher has printed."""
        self._log.flush()
        return Path(self._log.name).read_text()[-300:].strip() or "no output"

    def messages(self, seconds: float) -> Any:
        """What comes within so much wall time."""
        from ..messages.bus import take

        deadline = monotonic() + seconds
        while (left := deadline - monotonic()) > 0:
            if self._process.poll() is not None:
                raise ConfigError(f"the graph has ended: {self.said()}")
            if not self._bus.poll(min(left, 0.2)):
                continue
            for received in take(self._bus):
                if received.topic == "clock":
                    self.now = received.stamp_ns * 1e-9
                elif received.topic == "diagnostics" and received.message.node == "viewer":
                    self.pid = received.message.pid
                    self.drawn.append((monotonic(), received.message.steps))
                yield received

    def wait(self, seconds: float) -> None:
        """Let wall time pass."""
        for _ in self.messages(seconds):
            pass

    def factor(self, seconds: float) -> float:
        """Real-time factor over so much wall time."""
        begin, sim = monotonic(), self.now
        self.wait(seconds)
        return (self.now - sim) / (monotonic() - begin)

    def until(self, time: float) -> None:
        """Wait for a simulation time [s]."""
        since, was = monotonic(), self.now
        while self.now < time or not self.pid:
            self.wait(0.5)
            if self.now >= was + 1.0:
                since, was = monotonic(), self.now
            if monotonic() - since > PATIENCE:
                raise ConfigError(f"the run stands still at {self.now:g} s: {self.said()}")

    def stop(self) -> None:
        """End the run."""
        self._bus.close()
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._log.close()


class Reader:
    """Reads a window's web socket as fast as it can, like a browser with a fast machine."""

    def __init__(self, url: str) -> None:
        import viser
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self.bytes = 0
        self._socket = connect(
            url.replace("http", "ws", 1),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            proxy=None,
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for data in self._socket:
            self.bytes += len(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
        self._thread.join(5)


def measure(scene: str, planner: str, people: int, turns: int, turn: float, clicks: int) -> dict[str, float]:
    """The figures; see the module.

    Args:
        scene: Launch file or scene.
        planner: Method of the planner.
        people: How many walk.
        turns: Of each kind.
        turn: Wall time of one [s].
        clicks: Waypoints set.

    Raises:
        ConfigError: the graph does not start, or ends too soon.
    """
    with tempfile.TemporaryDirectory(prefix="footfall-bench-") as folder:
        watched = Run(scene, planner, people, Path(folder))
        try:
            watched.until(WARM_UP)
            return costs(watched, turns, turn) | at_real_time(watched, 2.0 * turn) | replies(watched, clicks)
        finally:
            watched.stop()


@dataclass
class Usage:
    """What the viewer's process has taken and given over some wall time."""

    wall: float = 0.0
    """[s]"""
    cpu: float = 0.0
    """[s]"""
    bytes: int = 0
    drawn: int = 0
    """Pictures between the first and the last of its reports."""
    drawn_wall: float = 0.0
    """Wall time between these [s]."""

    @contextmanager
    def counted(self, watched: Run, process: Any, reader: Reader) -> Iterator[None]:
        """Add what is used meanwhile."""
        begin, times, data = monotonic(), process.cpu_times(), reader.bytes
        yield
        after = process.cpu_times()
        self.wall += monotonic() - begin
        self.cpu += after.user + after.system - times.user - times.system
        self.bytes += reader.bytes - data
        reports = [report for report in watched.drawn if report[0] >= begin]
        if len(reports) > 1:
            self.drawn += reports[-1][1] - reports[0][1]
            self.drawn_wall += reports[-1][0] - reports[0][0]

    def figures(self) -> dict[str, float]:
        """Updates a second, processor time and traffic."""
        return {
            "updates_per_s": self.drawn / self.drawn_wall if self.drawn_wall else 0.0,
            "viewer_cores": self.cpu / self.wall,
            "megabytes_per_s": self.bytes / self.wall / 1e6,
        }


def costs(watched: Run, turns: int, turn: float) -> dict[str, float]:
    """Real-time factors with and without the viewer where the graph runs as fast as it can."""
    import psutil

    process = psutil.Process(watched.pid)
    factors: dict[str, list[float]] = {"with": [], "without": []}
    usage = Usage()
    try:
        for number in range(2 * turns):
            if number % 2:
                process.suspend()
                watched.wait(0.3)
                factors["without"].append(watched.factor(turn))
                continue
            process.resume()
            reader = Reader(watched.url)
            watched.wait(1.5)  # the whole scene is sent at first
            with usage.counted(watched, process, reader):
                factors["with"].append(watched.factor(turn))
            reader.close()
    finally:
        process.resume()
    ratios = [one / other for one, other in zip(factors["with"], factors["without"], strict=True) if other]
    return {
        "turns": float(turns),
        "real_time_factor_with": statistics.mean(factors["with"]),
        "real_time_factor_without": statistics.mean(factors["without"]),
        "ratio": statistics.mean(factors["with"]) / statistics.mean(factors["without"]),
        "ratio_median_of_turns": statistics.median(ratios),
    } | {f"flat_out_{name}": value for name, value in usage.figures().items()}


def at_real_time(watched: Run, seconds: float) -> dict[str, float]:
    """What one browser gets, and what it takes, where the graph keeps to real time if it can."""
    import psutil

    from ..messages.link import Request
    from .control import ask

    ask(watched.graph, Request("control", "*", "rate", 1.0))
    reader = Reader(watched.url)
    watched.wait(2.0)
    usage = Usage()
    with usage.counted(watched, psutil.Process(watched.pid), reader):
        factor = watched.factor(seconds)
    reader.close()
    return {"paced_real_time_factor": factor} | usage.figures()


def replies(watched: Run, clicks: int) -> dict[str, float]:
    """Wall time from setting a waypoint to the first plan that knows it [s]."""
    from ..messages.link import Steer
    from ..messages.objectives import Waypoint
    from ..messages.steering import SetWaypoint
    from .control import ask

    draw = random.Random(0)
    people: list[int] = []
    for received in watched.messages(PATIENCE):
        if received.topic == "plans":
            people = received.message.ids.tolist()
            break
    seconds = []
    for _ in range(clicks if people else 0):
        watched.wait(draw.uniform(0.2, 1.2))
        agent, goal = draw.choice(people), (draw.uniform(-2.0, 2.0), draw.uniform(-2.0, 2.0))
        begin, known_ns = monotonic(), None
        ask(watched.graph, Steer(SetWaypoint(agent, goal)))
        for received in watched.messages(PATIENCE):
            if received.topic == "objectives" and known_ns is None:
                mine = [w for a in received.message.agents if a.id == agent for w in a.objectives]
                if any(isinstance(wish, Waypoint) and wish.position == goal for wish in mine):
                    known_ns = received.stamp_ns
            elif received.topic == "plans" and known_ns is not None and received.stamp_ns > known_ns:
                seconds.append(monotonic() - begin)
                break
    if not seconds:
        return {}
    return {
        "clicks": float(len(seconds)),
        "click_to_plan_median_s": statistics.median(seconds),
        "click_to_plan_max_s": max(seconds),
    }
