"""Shows the graph in a browser, and passes on what is asked there.

In: what the launch file wires to it of the topics a picture is made of, `latest`, outside lockstep: a slow
browser costs pictures, never time. Out: nothing of its own; commands go through the launcher, which
publishes them as `steering` and `control`, so that they are recorded.
"""

import logging
import os
import sys
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Annotated, Any

from msgspec import Meta

from ..messages.bus import take
from ..messages.config import ConfigError, configure
from ..messages.link import Request, Steer
from ..messages.topics import AGENTS, LOG
from .node import NodeConfig
from .process import Process, run_process
from .viewer_clicks import Clicks
from .viewer_panels import Panels
from .viewer_picture import Picture
from .viewer_place import look_at_place
from .viewer_refusals import Refusals
from .viewer_scene import Scene
from .viewer_server import Window
from .viewer_steering import SteeringPanel
from .viewer_trails import Trails

log = logging.getLogger(__name__)

_NICENESS = 10  # whoever simulates goes first where processors are short
READOUT_PERIOD = 0.5
"""Wall time between updates of the read-outs [s]."""


class Config(NodeConfig, frozen=True):
    """Where the window is, and how often it is drawn."""

    host: str = "127.0.0.1"
    """Address to listen at; another than loopback needs `token_file`."""
    port: Annotated[int, Meta(ge=0, le=65535)] = 8080
    """TCP port; 0 takes a free one."""
    token_file: str | None = None
    """File with the token a browser must know; None asks for none."""
    rate_hz: Annotated[float, Meta(gt=0, le=60)] = 30.0
    """Pictures per second of wall time."""
    steering: bool = True
    """Whether the window can steer the run."""


class Viewer:
    """The window on one graph.

    Args:
        process: The node's process.
        config: See `Config`.

    Raises:
        ConfigError: the window cannot be opened.
    """

    def __init__(self, process: Process, config: Config) -> None:
        self.process = process
        self.config = config
        self.picture = Picture()
        self.window = Window(config.host, config.port, process.graph.name, read_token(config.token_file))
        server = self.window.server
        self.outbox: SimpleQueue[Request | Steer] = SimpleQueue()
        self.trails = Trails()
        self.scene = Scene(server, trails=lambda: self.trails)
        self._warned = Refusals(server)
        steering = SteeringPanel(server, self.outbox.put) if config.steering else None
        self.panels = Panels(server, [self.scene])
        clicks = Clicks(server, lambda: self.picture, self.panels.select)
        if steering is not None:
            steering.connect(self.panels, clicks, lambda: self.picture)
        self.steering = steering
        self._drawn = self._read_out = 0.0
        self._placed = False

    def run(self) -> None:
        """Show until told to stop."""
        process = self.process
        os.nice(_NICENESS)
        process.ready()
        log.info("open %s", self.window.gate.public_url)
        while True:
            wait = self._drawn + 1 / self.config.rate_hz - monotonic()
            process.wait(lambda: False, min(0.05, max(0.0, wait)))
            for received in take(process.bus):
                self.take(received.port, received.message, received.stamp_ns)
            process.now_ns = self.picture.now_ns
            self._pass_on()
            if monotonic() - self._drawn >= 1 / self.config.rate_hz:
                begin = monotonic()
                if self.draw():
                    process.time_step(monotonic() - begin)

    def take(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Take one message into the picture."""
        self.picture.take(topic, message, stamp_ns)
        if topic == AGENTS.name:
            self.trails.take(message, stamp_ns)
        elif topic == LOG.name:
            self._warned.take(message)

    def draw(self) -> bool:
        """Bring the window up to date; says whether there was anything to draw."""
        self._drawn = monotonic()
        self.process.facts = {"browsers": float(len(self.window.server.get_clients()))}
        if not self._placed and self.picture.place is not None:
            look_at_place(self.window.server, self.picture)
            self._placed = True
        if not self.picture.changed and not self.panels.stale:
            return False
        everything, self.panels.stale = self.panels.stale, False
        self.scene.draw(self.picture, everything)
        self.panels.steer_camera(self.picture)
        if everything or monotonic() - self._read_out > READOUT_PERIOD:
            self._read_out = monotonic()
            self.panels.update(self.picture)
            if self.steering is not None:
                self.steering.update(self.picture)
        return True

    def _pass_on(self) -> None:
        """Hand what was asked in the browser to the launcher."""
        while True:
            try:
                line = self.outbox.get_nowait()
            except Empty:
                return
            log.info("%s", line.command if isinstance(line, Steer) else f"{line.name} {line.value or ''}")
            self.process.link.send(line)

    def close(self) -> None:
        """Close the window."""
        self.window.close()


def read_token(path: str | None) -> str | None:
    """The token in a file.

    Raises:
        ConfigError: there is none in it, or others may read the file.
    """
    if path is None:
        return None
    file = Path(path).expanduser()
    try:
        if file.stat().st_mode & 0o077:
            raise ConfigError(f"viewer: token_file {file}: others may read it; `chmod 600 {file}`")
        token = file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"viewer: token_file {file}: {error}") from None
    if not token.isascii() or not token.isalnum() or len(token) < 16:
        raise ConfigError(f"viewer: token_file {file}: must hold 16 or more letters and digits")
    return token


def view(process: Process) -> None:
    """Show the graph until told to stop."""
    config = configure(Config, process.spec.config, f"{process.name}: config")
    viewer = Viewer(process, config)
    try:
        viewer.run()
    finally:
        viewer.close()


def main() -> int:
    """Run as a process of a graph."""
    return run_process(view)


if __name__ == "__main__":
    sys.exit(main())
