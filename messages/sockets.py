"""How the bus sets up its ZeroMQ sockets, and what it does with arrays on the way into them."""

import os
import socket as unix
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from .array import WRITABLE, owner_of
from .bus import PortError
from .codec import Buffer, Header

OPEN_HWM = 1000
"""Messages an open socket keeps for a subscriber that lags, if they are small."""
OPEN_BYTES = 64 << 20
"""Memory in which large messages are kept for a subscriber that lags [bytes]."""
SEND_BUFFER = 400_000
"""Of a socket in the kernel [bytes]; twice the usual, which makes large messages 5 % faster."""
RELIABLE_HWM = 64
"""Messages on their way to a reliable subscriber, at least."""
MAX_MESSAGE = 1 << 28
"""Largest frame accepted [bytes]."""
MARK = b"\xff"
"""Starts the second subscription of a subscriber, which matches no message and tells who it is."""
ZERO_COPY_BYTES = 1 << 16
"""Arrays from this size on are sent without a copy; below, copying is faster."""

DONTWAIT = int(zmq.DONTWAIT)
_EVENTS, _POLLIN = zmq.EVENTS, int(zmq.POLLIN)
_MORE = int(zmq.DONTWAIT | zmq.SNDMORE)
_UNIX_PATH_MAX = 107


def endpoint(run_dir: str | Path, topic: str, publisher: str, subscriber: str | None = None) -> str:
    """Address of a publisher's open socket, or of the one kept for a reliable subscriber.

    Raises:
        PortError: the path is longer than a Unix socket's may be.
    """
    path = f"{run_dir}/{topic}@{publisher}" + (f">{subscriber}" if subscriber else "")
    if len(os.fsencode(path)) > _UNIX_PATH_MAX:
        raise PortError(
            f"{path}: longer than {_UNIX_PATH_MAX} bytes; choose a shorter run directory or node name"
        )
    return f"ipc://{path}"


def publishing(context: zmq.Context, hwm: int, *, wait: bool, linger: float, latched: bool) -> zmq.Socket:
    """A publishing socket, not yet bound.

    Args:
        context: Where it belongs.
        hwm: Messages kept for each subscriber.
        wait: Refuse a message for which there is no room, instead of dropping it for whom it is.
        linger: Longest wait for the delivery of what was sent when it is closed [s].
        latched: A newcomer is not subscribed until `subscribe_newcomer`.
    """
    socket = context.socket(zmq.XPUB)
    socket.setsockopt(zmq.XPUB_VERBOSER, 1)
    socket.setsockopt(zmq.LINGER, int(linger * 1000))
    socket.setsockopt(zmq.SNDHWM, hwm)
    socket.setsockopt(zmq.SNDBUF, SEND_BUFFER)
    socket.setsockopt(zmq.MAXMSGSIZE, 1 << 12)  # what comes in is subscriptions only
    if wait:
        socket.setsockopt(zmq.XPUB_NODROP, 1)
    if latched:
        socket.setsockopt(zmq.XPUB_MANUAL, 1)
    return socket


def subscribing(context: zmq.Context, hwm: int, identity: str) -> zmq.Socket:
    """A socket that subscribes all, not yet connected; `identity` tells the publisher who it is."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, hwm)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.RECONNECT_IVL, 10)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, 200)
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.setsockopt(zmq.SUBSCRIBE, MARK + identity.encode())
    return socket


def bind(socket: zmq.Socket, address: str, what: str) -> None:
    """Bind a socket to an address that nobody else serves.

    Raises:
        PortError: somebody does, or the address is not one.
    """
    path = address.removeprefix("ipc://")
    if path != address and os.path.exists(path):
        with unix.socket(unix.AF_UNIX) as probe:  # ZeroMQ would take a live socket's path away silently
            try:
                probe.connect(path)
            except OSError:
                pass
            else:
                raise PortError(f"cannot publish {what} at {address}: another process does already")
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        raise PortError(f"cannot publish {what} at {address}: {error}") from None


def subscribe_newcomer(socket: zmq.Socket, last: Sequence[Any] | None) -> None:
    """Let the subscriber whose event was read last in on a latched topic, and give it the last message.

    The socket is in the mode that addresses one subscriber for this one message only: left in it, it
    would give the next message to the newcomer alone.
    """
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    if last is None:
        return
    socket.setsockopt(zmq.XPUB_MANUAL_LAST_VALUE, 1)
    try:
        send_parts(socket, last)
    finally:
        socket.setsockopt(zmq.XPUB_MANUAL_LAST_VALUE, 0)
        socket.setsockopt(zmq.XPUB_MANUAL, 1)


def part_of(array: np.ndarray, *, kept: bool) -> Any:
    """A contiguous array as a message part that later changes of the array cannot reach.

    Args:
        array: Large ones are copied if they can still be written to; small ones ZeroMQ copies at once.
        kept: The part is kept for later sending.
    """
    if array.nbytes < ZERO_COPY_BYTES:
        return array.tobytes() if kept else array
    owner = _owner(array)
    if owner is WRITABLE:
        array = array.copy()
    elif isinstance(owner, zmq.Frame) and len(owner) == array.nbytes:
        return owner  # as it came in
    return zmq.Frame(array.data.cast("B"), copy=False)


def _owner(array: np.ndarray) -> object:
    """What holds the memory of an array nobody can write to: None for itself; `WRITABLE` if somebody can."""
    owner = owner_of(array)
    if isinstance(owner, memoryview):
        owner = owner.obj
    return owner if owner is None or isinstance(owner, (bytes, zmq.Frame)) else WRITABLE


def send_parts(socket: zmq.Socket, parts: Sequence[Any]) -> None:
    """Send one message without waiting.

    Raises:
        zmq.Again: there is no room for it.
    """
    *before, last = parts
    for part in before:
        socket.send(part, _MORE)
    socket.send(last, DONTWAIT)


def readable(socket: zmq.Socket) -> bool:
    """Whether there is something to read; cheaper to ask than to try in vain."""
    return bool(socket.getsockopt(_EVENTS) & _POLLIN)  # type: ignore[operator]


def receive_parts(socket: zmq.Socket) -> list[Buffer]:
    """Read one message without waiting, as many parts as its header says and there are.

    Parts the header keeps silent about are left to be read as the next message, which they are not.

    Raises:
        zmq.Again: there is none.
    """
    head = socket.recv(DONTWAIT)
    parts: list[Buffer] = [head]
    if expected := Header.count_frames(head):
        more = socket.getsockopt(zmq.RCVMORE)
        while more and len(parts) <= expected:
            frame = socket.recv(DONTWAIT, False)
            parts.append(frame.buffer)
            more = frame.more
    return parts
