"""The turns that other buses take: what is lost is sent again, and given up when nothing comes through."""

import queue
import threading
from collections.abc import Callable

import pytest

from footfall.tools import bench_peers
from footfall.tools.bench_peers import LEFT_OUT, PIPES, Lost, PeerNear, Pipe, answer, open_pipes

ARRAYS = {"64": bytes(64), "big": bytes(5000)}


class Queues(Pipe):
    """Two queues; loses what `loses` says."""

    package, licence = "pyzmq", "none"

    def __init__(self, incoming: queue.Queue, outgoing: queue.Queue, loses: Callable[[bytes], bool]) -> None:
        self.incoming, self.outgoing, self.loses = incoming, outgoing, loses

    def send(self, data: bytes) -> None:
        if not self.loses(data):
            self.outgoing.put(data)

    def receive(self, timeout: float) -> bytes:
        try:
            return self.incoming.get(timeout=timeout)
        except queue.Empty:
            raise Lost from None

    def close(self) -> None:
        pass


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[bytes], bool]], PeerNear]:
    """A near end whose far end answers in a thread, each turn anew."""
    monkeypatch.setattr(bench_peers, "PATIENCE", 0.05)

    def make(loses: Callable[[bytes], bool]) -> PeerNear:
        there: queue.Queue = queue.Queue()
        back: queue.Queue = queue.Queue()
        far = Queues(there, back, lambda data: False)

        def begin(word: bytes) -> None:
            name, turn = word.split()
            assert name == b"peer"
            threading.Thread(target=answer, args=(far, turn), daemon=True).start()

        return PeerNear("peer", Queues(back, there, loses), begin, ARRAYS)

    return make


def test_turns(peer: Callable) -> None:
    end = peer(lambda data: False)
    for _ in range(3):
        end.begin_turn()
        end.round_trip("64")
        end.round_trip("big")
        end.flood("64", 20)
        end.end_turn()
    assert end.lost == {"64": 0, "big": 0}
    assert end.takes("64") and end.takes("big")
    assert threading.active_count() < 10  # the far side of each turn has ended


def test_a_lost_message_is_sent_again_and_counted(peer: Callable) -> None:
    losses = iter([True, False])
    end = peer(lambda data: len(data) == 64 and next(losses, False))
    end.begin_turn()
    end.round_trip("64")
    end.end_turn()
    assert end.lost == {"64": 1, "big": 0}
    assert end.takes("64")


def test_a_size_that_never_comes_through_is_given_up(peer: Callable) -> None:
    end = peer(lambda data: len(data) == 5000)
    end.begin_turn()
    end.round_trip("big")
    end.round_trip("64")
    end.flood("big", 10)
    end.end_turn()
    assert not end.takes("big") and end.takes("64")
    assert end.facts()["does_not_come_through"] == ["big"]


def test_a_lost_end_does_not_end_the_next_turn(peer: Callable) -> None:
    losses = iter([True, False])
    end = peer(lambda data: data.startswith(b"end") and next(losses, False))
    for _ in range(2):
        end.begin_turn()
        end.round_trip("64")
        end.end_turn()
    assert end.lost["64"] == 0


def test_what_is_not_installed_is_left_out_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    for module in ("zenoh", "lcm"):
        monkeypatch.setitem(__import__("sys").modules, module, None)
    pipes, left_out = open_pipes(str(tmp_path), "near")
    assert pipes == {}
    assert set(left_out) == set(PIPES) | set(LEFT_OUT)
    assert "not installed: pip install 'footfall[bench]'" in left_out["zenoh"]
