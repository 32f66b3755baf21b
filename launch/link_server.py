"""The launcher's end of the line to its nodes and clients."""

from collections.abc import Iterable

import zmq

from ..messages.config import ConfigError
from ..messages.link import Line, Reply, decode_line, encode_line, link_address


class LinkServer:
    """One ROUTER socket; a node is addressed by its name.

    Raises:
        ConfigError: the socket cannot be bound.
    """

    def __init__(self, run_dir: str) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 200)
        self._socket.setsockopt(zmq.ROUTER_HANDOVER, 1)  # a restarted node takes over its name
        self._socket.setsockopt(zmq.MAXMSGSIZE, 1 << 20)
        try:
            self._socket.bind(link_address(run_dir))
        except zmq.ZMQError as error:
            self.close()
            raise ConfigError(f"{run_dir}: cannot listen there: {error}") from None

    def receive(self) -> Iterable[tuple[bytes, Line]]:
        """Lines that have come, with the identity of who sent each."""
        while self._socket.poll(0):
            identity, *parts = self._socket.recv_multipart()
            line = decode_line(parts[-1]) if parts else None
            if line is None:
                self.send(identity, Reply("not a line this launcher knows; use one release on both sides"))
                continue
            yield identity, line

    def send(self, to: bytes, line: Line) -> None:
        """Send one line; who is not there does not get it."""
        self._socket.send_multipart([to, encode_line(line)])

    def close(self) -> None:
        """Close after what was sent has gone."""
        self._socket.close()
        self._context.term()
