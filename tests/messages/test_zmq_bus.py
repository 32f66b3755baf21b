"""The bus between real sockets: policies, barrier, latching, back-pressure, ownership, lives."""

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import pytest
import zmq

from footfall.messages.array import Array
from footfall.messages.bus import LIFE_BITS, BusError, PortError, Received, arrived, take
from footfall.messages.graph import ClockSpec, Graph, Input, NodeSpec
from footfall.messages.sockets import part_of
from footfall.messages.topics import Topic
from footfall.messages.zmq_bus import ZmqBus, endpoint


class Sample(msgspec.Struct, frozen=True):
    number: int
    data: Annotated[np.ndarray, Array("f4", ("N",))] = np.zeros(0, "f4")


DATA = Topic("data", Sample)
HELD = Topic("held", Sample, latched=True)
BACK = Topic("back", Sample)
TOPICS = {topic.name: topic for topic in (DATA, HELD, BACK)}

Open = Callable[..., ZmqBus]


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Open]:
    """Opens buses of a graph in a short run directory, and closes them."""
    opened: list[ZmqBus] = []
    run_dir = Path("/tmp") / f"fft{os.getpid()}-{tmp_path.name[-12:]}"
    run_dir.mkdir(mode=0o700)

    def open_bus(graph: Graph, node: str, restarts: int = 0) -> ZmqBus:
        graph = msgspec.structs.replace(graph, run_dir=str(run_dir))
        opened.append(ZmqBus(graph, node, TOPICS, restarts))
        return opened[-1]

    yield open_bus
    for one in opened:
        one.close()
    for path in run_dir.iterdir():
        path.unlink()
    run_dir.rmdir()


def pair(policy: str, topic: Topic = DATA, mode: str = "free", subscribers: int = 1, **wire) -> Graph:
    inputs = {topic.name: Input(topic.name, policy, **wire)}  # type: ignore[arg-type]
    return Graph(
        "test",
        [
            NodeSpec("source", "m", outputs={topic.name: topic.name}),
            *[NodeSpec(f"sink{i or ''}", "m", inputs=inputs) for i in range(subscribers)],
        ],
        clock=ClockSpec(mode=mode),  # type: ignore[arg-type]
    )


def collect(bus: ZmqBus, count: int, timeout: float = 5.0) -> list[Received]:
    got: list[Received] = []
    deadline = time.monotonic() + timeout
    while len(got) < count and time.monotonic() < deadline:
        bus.poll(0.1)
        got += take(bus)
    return got


def numbers(got: list[Received]) -> list[int]:
    return [received.message.number for received in got]


def test_nothing_is_lost_after_the_barrier(bus: Open) -> None:
    graph = pair("queue", depth=1000)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    assert source.wait_connected(5.0) == []
    for number in range(500):
        source.publish(DATA, Sample(number), number)
    got = collect(sink, 500)
    assert numbers(got) == list(range(500))
    assert [r.stamp_ns for r in got] == list(range(500)) == [r.sequence for r in got]
    assert sink.inlets[0].dropped == 0


def test_the_barrier_names_who_is_missing_and_counts_no_stranger_for_it(bus: Open) -> None:
    graph = pair("latest", subscribers=2)
    other = msgspec.structs.replace(graph.node("sink"), name="stranger", lockstep=False)
    with_stranger = msgspec.structs.replace(graph, nodes=[graph.nodes[0], other])
    source = bus(graph, "source")
    bus(graph, "sink")
    bus(with_stranger, "stranger")
    time.sleep(0.2)
    assert source.wait_connected(0.2) == ["data: sink1/data has not subscribed"]
    bus(graph, "sink1")
    assert source.wait_connected(5.0) == []
    assert source.subscribers("data") == 3


@pytest.mark.parametrize("policy, depth, expected", [("latest", 1, [99]), ("queue", 7, list(range(93, 100)))])
def test_old_messages_give_way_and_are_counted(bus: Open, policy: str, depth: int, expected: list) -> None:
    graph = pair(policy, depth=depth)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    for number in range(100):
        source.publish(DATA, Sample(number), number)
    assert sink.poll(5.0, lambda: sink.inlets[0].received == 100)
    assert numbers(take(sink)) == expected
    assert sink.inlets[0].skipped == 100 - len(expected)
    assert sink.inlets[0].dropped == 0


def test_after_quick_answers_a_node_that_waits_long_sleeps(bus: Open) -> None:
    graph = pair("latest")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    for number in range(20):
        source.publish(DATA, Sample(number), number)
        assert numbers(collect(sink, 1)) == [number]
    busy = time.process_time()
    assert not sink.poll(1.0)
    assert time.process_time() - busy < 0.5


def test_latest_is_fresh_behind_a_busy_consumer(bus: Open) -> None:
    graph = pair("latest")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    stop = threading.Event()

    def publish() -> None:
        number = 0
        while not stop.is_set():
            source.publish(DATA, Sample(number), number)
            number += 1
            time.sleep(0.001)

    thread = threading.Thread(target=publish)
    thread.start()
    ages = []
    for _ in range(4):
        time.sleep(0.6)
        sink.poll(0)
        ages.append((time.monotonic_ns() - take(sink)[-1].sent_ns) * 1e-6)
    stop.set()
    thread.join()
    assert np.median(ages) < 20, ages


@pytest.mark.parametrize("policy, mode", [("reliable", "free"), ("latest", "lockstep")])
def test_a_newcomer_gets_the_latched_message_and_nobody_else_misses_one(
    bus: Open, policy: str, mode: str
) -> None:
    graph = pair(policy, HELD, mode, subscribers=3)
    source = bus(graph, "source")
    early = [bus(graph, "sink"), bus(graph, "sink1")]
    time.sleep(0.3)
    source.wait_connected(0.05)
    source.publish(HELD, Sample(1), 0)
    assert [numbers(collect(sink, 1)) for sink in early] == [[1], [1]]
    late = bus(graph, "sink2")
    assert source.wait_connected(5.0) == []
    assert numbers(collect(late, 1)) == [1]
    source.publish(HELD, Sample(2), 0)
    assert [numbers(collect(sink, 1)) for sink in [*early, late]] == [[2], [2], [2]]
    assert [sink.inlets[0].rejected for sink in [*early, late]] == [0, 0, 0]


def test_two_newcomers_before_the_first_message_both_get_it(bus: Open) -> None:
    graph = pair("latest", HELD, subscribers=2)
    source, sinks = bus(graph, "source"), [bus(graph, "sink"), bus(graph, "sink1")]
    assert source.wait_connected(5.0) == []
    source.publish(HELD, Sample(5), 0)
    assert [numbers(collect(sink, 1)) for sink in sinks] == [[5], [5]]


def test_a_reliable_subscriber_holds_the_publisher_up(bus: Open) -> None:
    graph = pair("reliable", depth=10, timeout=20.0)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    payload = np.zeros(5000, "f4")
    sent = [0]

    def publish() -> None:
        for number in range(1500):
            source.publish(DATA, Sample(number, payload), number)
            sent[0] = number + 1

    thread = threading.Thread(target=publish)
    thread.start()
    time.sleep(0.7)
    held = sent[0]
    assert held < 1000
    assert len(sink.inlets[0].pending) == 10
    assert numbers(collect(sink, 1500, 20)) == list(range(1500))
    thread.join()
    assert sink.inlets[0].dropped == 0
    assert source.refused == {}


def test_polling_with_a_full_inlet_does_not_spin(bus: Open) -> None:
    graph = pair("reliable", depth=2)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    for number in range(20):
        source.publish(DATA, Sample(number), number)
    sink.poll(1.0, lambda: sink.inlets[0].full)
    begin = time.thread_time()
    assert not sink.poll(0.5, lambda: False)
    assert time.thread_time() - begin < 0.05
    assert numbers(collect(sink, 20)) == list(range(20))


def test_a_subscriber_too_slow_is_named(bus: Open, caplog: pytest.LogCaptureFixture) -> None:
    graph = pair("reliable", depth=1, timeout=0.3)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    payload = np.zeros(20_000, "f4")
    with caplog.at_level(logging.ERROR):
        for number in range(400):
            source.publish(DATA, Sample(number, payload), number)
    assert [r.getMessage() for r in caplog.records] == [
        "sink has not taken data for 0.3 s; its messages are given up until it reads again"
    ]
    refused = source.refused["data"]
    got = collect(sink, 400 - refused)
    source.publish(DATA, Sample(400), 400)
    got += collect(sink, 1)
    assert len(got) + refused == 401
    assert sink.inlets[0].dropped == refused


def test_in_lockstep_it_ends_the_run(bus: Open) -> None:
    graph = pair("reliable", mode="lockstep", depth=1, timeout=0.3)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    sink._closing.set()  # nothing reads any more
    payload = np.zeros(20_000, "f4")
    with pytest.raises(BusError, match=r"sink has not taken data for 0\.3 s; lockstep cannot go on"):
        for number in range(1000):
            source.publish(DATA, Sample(number, payload), number)
    sink._closing.clear()


def test_lockstep_takes_no_message_before_its_tick(bus: Open) -> None:
    graph = pair("latest", mode="lockstep")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    for number in range(3):
        source.publish(DATA, Sample(number), number)
    bound = {"data@source": 1}
    assert sink.poll(5.0, lambda: arrived(sink, {"data@source": 2}))
    assert numbers(take(sink, bound)) == [1]
    assert numbers(take(sink, source.sent)) == [2]


def test_working_on_in_a_published_array_changes_nothing(bus: Open) -> None:
    graph = pair("reliable", depth=100)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    base = np.zeros((2, 60_000), "f4")
    view = base[0]
    for number, array in enumerate([np.zeros(10, "f4"), np.zeros(5000, "f4"), np.zeros(60_000, "f4"), view]):
        for turn in range(10):
            array[:] = number * 10 + turn
            source.publish(DATA, Sample(number * 10 + turn, array), 0)
            array[:] = -1
    for received in collect(sink, 40):
        assert (received.message.data == received.message.number).all()
        with pytest.raises(ValueError, match="read-only"):
            received.message.data[0] = 1


def test_a_read_only_view_of_a_writable_array_is_copied_too(bus: Open) -> None:
    graph = pair("latest", HELD)
    source = bus(graph, "source")
    base = np.full(60_000, 7, "f4")
    view = base[:]
    view.flags.writeable = False
    source.publish(HELD, Sample(0, view), 0)
    base[:] = -1
    sink = bus(graph, "sink")
    assert (collect_served(source, sink).message.data == 7).all()


def collect_served(source: ZmqBus, sink: ZmqBus) -> Received:
    source.wait_connected(5.0)
    return collect(sink, 1)[0]


@pytest.mark.parametrize("count", [1, 1023, 1025, 2000, 2300, 20_000])
def test_arrays_are_aligned_wherever_they_arrive(bus: Open, count: int) -> None:
    graph = pair("reliable", depth=100)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    data = np.arange(count, dtype="f4")
    for number in range(7):
        source.publish(DATA, Sample(number, data), 0)
    for received in collect(sink, 7):
        assert received.message.data.flags.aligned
        np.testing.assert_array_equal(received.message.data, data)


def test_a_restarted_publisher_makes_no_gap(bus: Open) -> None:
    graph = pair("queue", depth=100)
    first, sink = bus(graph, "source"), bus(graph, "sink")
    first.wait_connected(5.0)
    first.publish(DATA, Sample(0), 0)
    assert numbers(collect(sink, 1)) == [0]
    first.close()
    second = bus(graph, "source", restarts=1)
    assert second.wait_connected(5.0) == []
    second.publish(DATA, Sample(1), 0)
    got = collect(sink, 1)
    assert [r.sequence for r in got] == [1 << LIFE_BITS]
    assert sink.inlets[0].dropped == 0


def test_losses_are_counted(bus: Open) -> None:
    graph = pair("latest")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    sink._lock.acquire()  # nothing is read
    payload = np.zeros(50_000, "f4")
    for number in range(1500):
        source.publish(DATA, Sample(number, payload), number)
    sink._lock.release()
    time.sleep(0.3)
    source.publish(DATA, Sample(1500), 0)
    assert sink.poll(5.0, lambda: sink.inlets[0].last_sequence == 1500)
    inlet = sink.inlets[0]
    assert inlet.dropped > 0
    assert inlet.dropped + inlet.received == 1501


def test_large_messages_are_kept_in_bounded_memory(bus: Open) -> None:
    graph = pair("latest")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    payload = np.zeros(1_500_000, "f4")
    sink._lock.acquire()
    for number in range(100):
        source.publish(DATA, Sample(number, payload), number)
    sink._lock.release()
    assert sink.poll(5.0)
    sink.poll(0.3, lambda: False)
    assert sink.inlets[0].received < 50


def test_one_address_has_one_publisher(bus: Open) -> None:
    graph = pair("latest")
    bus(graph, "source")
    with pytest.raises(PortError, match="another process does already"):
        bus(graph, "source")


def test_too_long_a_path_is_refused() -> None:
    with pytest.raises(PortError, match="longer than 107 bytes"):
        endpoint("/" + "x" * 100, "topic", "publisher")


def test_an_unknown_output_is_named(bus: Open) -> None:
    graph = pair("latest")
    source = bus(graph, "source")
    with pytest.raises(BusError, match="source has no output 'back' in this graph"):
        source.publish(BACK, Sample(0), 0)


def test_a_fork_cannot_use_the_bus(bus: Open) -> None:
    graph = pair("latest")
    source = bus(graph, "source")
    child = os.fork()
    if child == 0:
        try:
            source.publish(DATA, Sample(0), 0)
        except BusError:
            source.close()
            os._exit(7)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    source.publish(DATA, Sample(0), 0)


def test_closing_delivers_what_was_sent_and_does_not_hang(bus: Open) -> None:
    graph = pair("reliable", depth=1000)
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)
    for number in range(50):
        source.publish(DATA, Sample(number, np.zeros(3000, "f4")), 0)
    source.close()
    source.close()
    assert len(collect(sink, 50)) == 50


def test_a_signal_ends_a_poll_and_leaves_the_bus_usable(bus: Open) -> None:
    graph = pair("latest")
    source, sink = bus(graph, "source"), bus(graph, "sink")
    source.wait_connected(5.0)

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(KeyboardInterrupt):
            sink.poll(5.0)
    finally:
        signal.signal(signal.SIGALRM, before)
    source.publish(DATA, Sample(3), 0)
    assert numbers(collect(sink, 1)) == [3]


def test_what_came_in_goes_out_again_as_it_is(bus: Open) -> None:
    relay = NodeSpec("relay", "m", {"data": Input("data", "queue", 5)}, {"back": "back"})
    sink = NodeSpec("sink", "m", {"back": Input("back", "queue", 5)})
    source = NodeSpec("source", "m", outputs={"data": "data"})
    graph = Graph("test", [source, relay, sink], clock=ClockSpec("free"))
    first, middle, last = (bus(graph, name) for name in ("source", "relay", "sink"))
    assert first.wait_connected(5.0) == [] == middle.wait_connected(5.0)
    data = np.arange(100_000, dtype="f4")
    first.publish(DATA, Sample(1, data), 0)
    received = collect(middle, 1)[0]
    assert isinstance(part_of(received.message.data, kept=False), zmq.Frame)
    assert part_of(received.message.data, kept=False) is received.message.data.base  # not a copy
    middle.publish(BACK, received.message, 0)
    middle.publish(BACK, Sample(2, received.message.data[:50_000]), 0)
    got = [one.message.data for one in collect(last, 2)]
    np.testing.assert_array_equal(got[0], data)
    np.testing.assert_array_equal(got[1], data[:50_000])
