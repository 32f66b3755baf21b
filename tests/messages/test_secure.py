"""Exposed topics: only who is on the list gets in."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from footfall.messages.bus import PortError, take
from footfall.messages.clock import Clock
from footfall.messages.graph import ClockSpec, Edge, Graph, Input, NodeSpec, Security
from footfall.messages.secure import ClientKeys, new_keys
from footfall.messages.sockets import subscribing
from footfall.messages.topics import CLOCK
from footfall.messages.zmq_bus import ZmqBus


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """Certificates of a graph, a friend and a stranger; the friend's is on the list."""
    for name in ("graph", "friend", "stranger"):
        new_keys(tmp_path, name)
    (tmp_path / "list").mkdir()
    (tmp_path / "list" / "friend.key").write_bytes((tmp_path / "friend.key").read_bytes())
    return tmp_path


@pytest.fixture
def source(keys: Path) -> Iterator[tuple[ZmqBus, str]]:
    """A publisher of `clock` on TCP, and its address."""
    with zmq.Context() as context, context.socket(zmq.PUB) as probe:
        port = probe.bind_to_random_port("tcp://127.0.0.1")
    address = f"tcp://127.0.0.1:{port}"
    run_dir = Path(f"/tmp/ffs{os.getpid()}")
    run_dir.mkdir(mode=0o700)
    bus = ZmqBus(exposing(address, keys, str(run_dir)), "source")
    yield bus, address
    bus.close()
    (run_dir / "clock@source").unlink()
    run_dir.rmdir()


def exposing(address: str, keys: Path | None, run_dir: str = "/tmp") -> Graph:
    node = NodeSpec("source", "m", outputs={"clock": "clock"}, expose={"clock": address})
    security = keys and Security(str(keys / "graph.key_secret"), str(keys / "list"))
    return Graph("test", [node], run_dir, ClockSpec("free"), security=security)


def listen(address: str, keys: ClientKeys | None) -> ZmqBus:
    bus = ZmqBus(Graph("far", [NodeSpec("far", "m")]), "far")
    edge = Edge("clock", "source", "far", "clock", Input("clock", "queue", 10), False, False)
    try:
        bus.connect(edge, CLOCK, address, keys)
    except PortError:
        bus.close()
        raise
    return bus


def hears(source: ZmqBus, listener: ZmqBus, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        source.publish(CLOCK, Clock(1, 1, "free"), 0)
        source.poll(0.02)
        if listener.poll(0.05):
            assert take(listener)[0].message == Clock(1, 1, "free")
            return True
    return False


def certificates(keys: Path, name: str) -> ClientKeys:
    return ClientKeys(str(keys / f"{name}.key_secret"), str(keys / "graph.key"))


def test_who_is_on_the_list_is_heard_out(source: tuple[ZmqBus, str], keys: Path) -> None:
    listener = listen(source[1], certificates(keys, "friend"))
    assert hears(source[0], listener, 10.0)
    listener.close()


def test_a_stranger_with_keys_is_refused_until_listed(source: tuple[ZmqBus, str], keys: Path) -> None:
    listener = listen(source[1], certificates(keys, "stranger"))
    assert not hears(source[0], listener, 1.5)
    assert source[0]._gate is not None and source[0]._gate.denied > 0
    assert source[0].subscribers("clock") == 0
    listener.close()
    (keys / "list" / "stranger.key").write_bytes((keys / "stranger.key").read_bytes())
    listener = listen(source[1], certificates(keys, "stranger"))
    assert hears(source[0], listener, 10.0)
    listener.close()


def test_who_has_no_keys_is_refused(source: tuple[ZmqBus, str]) -> None:
    with zmq.Context() as context, subscribing(context, 10, "naked") as socket:
        socket.connect(source[1])
        for _ in range(20):
            source[0].publish(CLOCK, Clock(1, 1, "free"), 0)
            source[0].poll(0.02)
            assert not socket.poll(50)
    assert source[0].subscribers("clock") == 0


def test_the_wrong_server_is_not_believed(source: tuple[ZmqBus, str], keys: Path) -> None:
    wrong = ClientKeys(str(keys / "friend.key_secret"), str(keys / "stranger.key"))
    listener = listen(source[1], wrong)
    assert not hears(source[0], listener, 1.0)
    listener.close()


def test_exposing_without_keys_is_refused(keys: Path) -> None:
    for address in ("tcp://0.0.0.0:7000", "tcp://127.0.0.1:7000"):
        with pytest.raises(PortError, match="needs keys"):
            ZmqBus(exposing(address, None, str(keys)), "source")
    with pytest.raises(PortError, match="must be like tcp"):
        ZmqBus(exposing("udp://0.0.0.0:7000", keys, str(keys)), "source")


def test_an_empty_list_lets_nobody_in_and_says_so(keys: Path) -> None:
    (keys / "list" / "friend.key").unlink()
    with pytest.raises(PortError, match="no public certificate"):
        ZmqBus(exposing("tcp://127.0.0.1:7000", keys, str(keys)), "source")


def test_secrets_are_their_owners_own(keys: Path) -> None:
    secret = keys / "friend.key_secret"
    assert secret.stat().st_mode & 0o777 == 0o600
    secret.chmod(0o644)
    with pytest.raises(PortError, match="others may read it; run `chmod 600"):
        listen("tcp://127.0.0.1:7000", certificates(keys, "friend"))
    with pytest.raises(PortError, match="no such file"):
        listen("tcp://127.0.0.1:7000", certificates(keys, "nobody"))
    with pytest.raises(PortError, match="holds no secret key"):
        listen("tcp://127.0.0.1:7000", ClientKeys(str(keys / "friend.key"), str(keys / "graph.key")))
    with pytest.raises(PortError, match=r"graph\.key exists"):
        new_keys(keys, "graph")
    with pytest.raises(PortError, match="cannot name a key"):
        new_keys(keys, "../graph")
