"""Other buses for `footfall bench bus`, moving the same bytes between the same two processes.

Each is one duplex pipe of bytes: `send` on one side, `receive` on the other. What is not installed, or cannot
run between two processes that are there already, is left out by name and with the reason.
"""

import json
from abc import ABC, abstractmethod
from importlib.metadata import version
from time import monotonic, sleep
from typing import Any, Literal

import numpy as np

Side = Literal["near", "far"]
END = b"end"
"""Ends a turn on the far side."""
ARRAY_BYTES = 64
"""Size of the smallest array; what is shorter is a word."""
PATIENCE = 1.0
"""Longest wait for an answer; then the message counts as lost and is sent again [s]."""
GIVE_UP = 3
"""Messages of one size lost in a row after which the size is left out."""


class Lost(RuntimeError):  # noqa: N818 - not an error of ours
    """Nothing came within the patience."""


class Pipe(ABC):
    """A peer's connection between two processes."""

    package: str
    """Name on PyPI."""
    licence: str
    reliable = True
    """Whether it promises to lose nothing, so that it can be flooded."""

    @abstractmethod
    def __init__(self, run_dir: str, side: Side) -> None: ...

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send bytes."""

    @abstractmethod
    def receive(self, timeout: float) -> bytes:
        """The next bytes.

        Raises:
            Lost: there are none within the time [s].
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it."""


class Zenoh(Pipe):
    """Peer to peer over a Unix socket, without scouting; block rather than drop."""

    package = "eclipse-zenoh"
    licence = "EPL-2.0 or Apache-2.0"

    def __init__(self, run_dir: str, side: Side) -> None:
        import zenoh  # pyright: ignore[reportMissingImports]

        endpoint = json.dumps([f"unixsock-stream/{run_dir}/zenoh"])
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("listen/endpoints", endpoint if side == "near" else "[]")
        config.insert_json5("connect/endpoints", endpoint if side == "far" else "[]")
        self._session = zenoh.open(config)
        other = "far" if side == "near" else "near"
        channel = zenoh.handlers.FifoChannel(128)
        self._incoming = self._session.declare_subscriber(f"bench/{side}", channel)
        self._outgoing = self._session.declare_publisher(
            f"bench/{other}", congestion_control=zenoh.CongestionControl.BLOCK
        )

    def send(self, data: bytes) -> None:
        """See `Pipe.send`."""
        self._outgoing.put(data)

    def receive(self, timeout: float) -> bytes:
        """See `Pipe.receive`; it waits without a time-out, for zenoh loses nothing here."""
        return self._incoming.recv().payload.to_bytes()

    def close(self) -> None:
        """See `Pipe.close`."""
        self._session.close()


class Lcm(Pipe):
    """UDP multicast on this machine; large messages are cut in pieces, and nothing is sent twice."""

    package = "lcm"
    licence = "LGPL-2.1"
    reliable = False

    def __init__(self, run_dir: str, side: Side) -> None:
        import lcm  # pyright: ignore[reportMissingImports]

        self._lcm = lcm.LCM("udpm://239.255.76.67:7667?ttl=0")
        self._other = f"{run_dir}/far" if side == "near" else f"{run_dir}/near"
        self._got: list[bytes] = []
        self._lcm.subscribe(f"{run_dir}/{side}"[-60:], lambda _, data: self._got.append(data))

    def send(self, data: bytes) -> None:
        """See `Pipe.send`."""
        self._lcm.publish(self._other[-60:], data)

    def receive(self, timeout: float) -> bytes:
        """See `Pipe.receive`."""
        deadline = monotonic() + timeout
        while not self._got:
            left = deadline - monotonic()
            if left <= 0:
                raise Lost
            self._lcm.handle_timeout(max(1, int(left * 1000)))
        return self._got.pop(0)

    def close(self) -> None:
        """See `Pipe.close`."""


PIPES: dict[str, type[Pipe]] = {"zenoh": Zenoh, "LCM": Lcm}
LEFT_OUT = {
    "dora-rs": "MIT; its daemon and command (`dora-rs-cli`) start the processes themselves, so that it cannot"
    " take turns with the others between the same two",
}
"""Peers that cannot take part, and why."""


def open_pipes(run_dir: str, side: Side) -> tuple[dict[str, Pipe], dict[str, str]]:
    """The peers that are installed and work, and the reasons of those that are left out."""
    pipes, left_out = {}, dict(LEFT_OUT)
    for name, kind in PIPES.items():
        try:
            pipes[name] = kind(run_dir, side)
        except ImportError:
            left_out[name] = f"{kind.licence}; not installed: pip install 'footfall[bench]'"
        except Exception as error:
            left_out[name] = f"{kind.licence}; does not run here: {' '.join(str(error).split())}"
    return pipes, left_out


def answer(pipe: Pipe, turn: bytes) -> None:
    """The far side of one turn: sends arrays back and counts floods, until the near side ends it.

    Args:
        pipe: The connection.
        turn: Number of the turn: what came late of an earlier one does not end this one.
    """
    while True:
        try:
            data = pipe.receive(PATIENCE)
        except Lost:
            continue
        if data.startswith(END):
            pipe.send(data)
            if data == END + turn:
                return
            continue
        if len(data) >= ARRAY_BYTES:
            np.frombuffer(data, np.uint8)
            pipe.send(data)
            continue
        for _ in range(int(data)):
            np.frombuffer(pipe.receive(PATIENCE), np.uint8)
        pipe.send(b"done")


class PeerNear:
    """The asking end of a peer, as `bench_bus` wants it.

    Args:
        name: Of the peer.
        pipe: The connection.
        begin: Tells the far side whose turn it is.
        arrays: Bytes to move, by size.
    """

    def __init__(self, name: str, pipe: Pipe, begin: Any, arrays: dict[str, bytes]) -> None:
        self.name = name
        self._pipe = pipe
        self._begin = begin
        self._arrays = arrays
        self._turn = 0
        self.lost: dict[str, int] = dict.fromkeys(arrays, 0)
        self.given_up: set[str] = set()
        """Sizes that do not come through."""

    def takes(self, size: str) -> bool:
        """Whether messages of that size come through."""
        return size not in self.given_up

    def begin_turn(self) -> None:
        """Let the other end listen to this peer."""
        self._turn += 1
        self._begin(f"{self.name} {self._turn}".encode())
        sleep(0.002)

    def end_turn(self) -> None:
        """Let the other end listen to the raw socket again."""
        word = END + str(self._turn).encode()
        for _ in range(20):
            self._pipe.send(word)
            try:
                while self._pipe.receive(PATIENCE) != word:
                    pass
                return
            except Lost:
                continue
        raise Lost(f"{self.name}: the other end does not answer")

    def round_trip(self, size: str) -> None:
        """Send an array and take one of that size back; give the size up when none comes."""
        if not self.takes(size):
            return
        array = self._arrays[size]
        for _ in range(GIVE_UP):
            self._pipe.send(array)
            try:
                while len(data := self._pipe.receive(PATIENCE)) != len(array):
                    pass
                np.frombuffer(data, np.uint8)
                return
            except Lost:
                self.lost[size] += 1
        self.given_up.add(size)

    def flood(self, size: str, count: int) -> None:
        """Send many, and wait until the other end has them all."""
        if not self._pipe.reliable or not self.takes(size):
            return
        self._pipe.send(str(count).encode())
        for _ in range(count):
            self._pipe.send(self._arrays[size])
        while self._pipe.receive(60.0) != b"done":
            pass

    def facts(self) -> dict[str, Any]:
        """Release, licence and losses."""
        return {
            "version": version(self._pipe.package),
            "licence": self._pipe.licence,
            "lost": {size: count for size, count in self.lost.items() if count},
            "does_not_come_through": sorted(self.given_up),
            "throughput_measured": self._pipe.reliable,
        }

    def close(self) -> None:
        """Let go of the connection."""
        self._pipe.close()
