"""The line between the launcher, its nodes and its command-line clients: JSON over one ROUTER socket."""

from typing import Literal

import msgspec
import zmq

from .bus import Bound
from .graph import Graph
from .steering import Command


class Ready(msgspec.Struct, frozen=True, tag=True):
    """Node to launcher: sockets are up, declared subscribers are there, start messages are sent."""

    node: str
    sent: Bound = {}


class Go(msgspec.Struct, frozen=True, tag=True):
    """Launcher to node: everybody is ready."""

    sent: Bound = {}
    """What everybody sent before; each node first takes what of it is meant for it."""
    restarted: bool = False
    """The graph has been running already: what went by is gone."""


class Stop(msgspec.Struct, frozen=True, tag=True):
    """Launcher to node: finish, write what must be written, end."""


class Finished(msgspec.Struct, frozen=True, tag=True):
    """Node to launcher: the run's end is reached (duration, end of log, exit condition)."""

    node: str
    reason: str


class Failed(msgspec.Struct, frozen=True, tag=True):
    """Node to launcher: it ends in failure; `usage` marks a fault of the user's input."""

    node: str
    reason: str
    usage: bool = False


class Request(msgspec.Struct, frozen=True, tag=True):
    """Client to launcher: send a `Control`, or stop the graph."""

    verb: Literal["control", "stop"]
    node: str = "*"
    name: str = ""
    value: bool | int | float | str | None = None


class Steer(msgspec.Struct, frozen=True, tag=True):
    """Client to launcher: ask something of the scene; it goes out as `steering`."""

    command: Command


class Publish(msgspec.Struct, frozen=True, tag=True):
    """Client to launcher: hand a message to all nodes that listen to a topic."""

    topic: str
    body: bytes
    """The message as one self-contained msgpack record, as logs store it."""


class Deliver(msgspec.Struct, frozen=True, tag=True):
    """Launcher to node: a message from outside the graph."""

    topic: str
    message: bytes
    """Header and self-contained body."""


class Reply(msgspec.Struct, frozen=True, tag=True):
    """Launcher to client: done, or why not."""

    error: str | None = None


Line = Ready | Go | Stop | Finished | Failed | Request | Steer | Publish | Deliver | Reply

_decoder = msgspec.json.Decoder(Line)


def link_address(run_dir: str) -> str:
    """Where the launcher listens."""
    return f"ipc://{run_dir}/launcher"


class Link:
    """A node's or client's end of the line."""

    def __init__(self, run_dir: str, name: str) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 1000)
        self._socket.setsockopt(zmq.IDENTITY, name.encode())
        self._socket.connect(link_address(run_dir))

    def send(self, line: Line) -> None:
        """Send one line."""
        self._socket.send(msgspec.json.encode(line))

    def receive(self, timeout: float) -> Line | None:
        """The next line, or None after `timeout` [s]."""
        if not self._socket.poll(int(timeout * 1000)):
            return None
        return decode_line(self._socket.recv())

    def close(self) -> None:
        """Close after what was sent has gone."""
        self._socket.close()
        self._context.term()


def encode_line(line: Line) -> bytes:
    """A line's bytes."""
    return msgspec.json.encode(line)


def decode_line(data: bytes) -> Line | None:
    """A line, or None for bytes that are not one."""
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, RecursionError):
        return None


def load_graph(path: str) -> Graph:
    """Read a resolved graph.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is not a graph.
    """
    with open(path, "rb") as file:
        return msgspec.json.decode(file.read(), type=Graph)
