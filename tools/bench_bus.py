"""`footfall bench bus`: the bus beside raw pyzmq in one run, array to array between two processes.

Both transports run in the same two processes and take turns every few hundredths of a second, so that
whatever else the machine does meets both.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from statistics import median
from time import monotonic_ns, perf_counter, sleep
from typing import Annotated, Any

import msgspec
import numpy as np
import zmq

from ..messages.array import Array
from ..messages.body import BodyStates
from ..messages.bus import BusError, take
from ..messages.graph import ClockSpec, Graph, Input, NodeSpec
from ..messages.topics import Topic
from ..messages.zmq_bus import ZmqBus
from .bench_peers import PeerNear, answer, open_pipes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bench."""
    parser.add_argument("--quick", action="store_true", help="fewer messages, for a first look")
    parser.add_argument("--no-peers", action="store_true", help="raw sockets and ours only")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


class Bytes(msgspec.Struct, frozen=True):
    """A few bytes: what the bus costs by itself."""

    data: Annotated[np.ndarray, Array("u1", ("N",))]


class Cloud(msgspec.Struct, frozen=True):
    """A point cloud."""

    points: Annotated[np.ndarray, Array("f4", ("N", 4), "", "world")]


class Image(msgspec.Struct, frozen=True):
    """A colour image."""

    pixels: Annotated[np.ndarray, Array("u1", ("H", "W", 3))]


class Flood(msgspec.Struct, frozen=True):
    """Says how many messages follow, and that they have come."""

    size: str
    count: int


BUS_TURN = b"bus"
PEOPLE = 30
SIZES: dict[str, type[msgspec.Struct]] = {"64": Bytes, "39k": BodyStates, "1m": Cloud, "6m": Image}
"""Message type by size; `39k` is the crowd's own message."""
GOALS = {"64": 1.5, "39k": 1.3, "1m": 1.15, "6m": 1.1}
"""Round trip on the bus by round trip on raw pyzmq that is not to be exceeded."""

PING = {size: Topic(f"ping_{size}", kind) for size, kind in SIZES.items()}
PONG = {size: Topic(f"pong_{size}", kind) for size, kind in SIZES.items()}
FLOOD = {size: Topic(f"flood_{size}", kind) for size, kind in SIZES.items()}
ORDER, DONE, TICK = Topic("order", Flood), Topic("done_", Flood), Topic("tick", Bytes)
BENCH_TOPICS = {
    topic.name: topic for topic in [*PING.values(), *PONG.values(), *FLOOD.values(), ORDER, DONE, TICK]
}


_PONG_OF = {PING[size].name: PONG[size] for size in SIZES}


def sample(size: str) -> msgspec.Struct:
    """A message of that size; its arrays are frozen, as those of a sender in a hurry are."""
    rng = np.random.default_rng(0)
    match size:
        case "64":
            message = Bytes(rng.integers(0, 255, 64, dtype=np.uint8))
        case "39k":
            message = BodyStates(
                np.arange(PEOPLE, dtype="i4"), rng.random((PEOPLE, 24, 13), dtype=np.float32)
            )
        case "1m":
            message = Cloud(rng.random((65536, 4), dtype=np.float32))
        case _:
            message = Image(rng.integers(0, 255, (1080, 1920, 3), dtype=np.uint8))
    for name in message.__struct_fields__:
        getattr(message, name).flags.writeable = False
    return message


def bench_graph(run_dir: str) -> Graph:
    """Two nodes: `near` asks, `far` answers."""
    latest, reliable = Input("", "latest"), Input("", "reliable", depth=64, timeout=30.0)

    def inputs(latest_topics: list[Topic], reliable_topics: list[Topic]) -> dict[str, Input]:
        return {t.name: msgspec.structs.replace(latest, topic=t.name) for t in latest_topics} | {
            t.name: msgspec.structs.replace(reliable, topic=t.name) for t in reliable_topics
        }

    names = {"near": [*PING.values(), *FLOOD.values(), ORDER], "far": [*PONG.values(), DONE, TICK]}
    return Graph(
        name="bench",
        run_dir=run_dir,
        clock=ClockSpec(mode="free"),
        nodes=[
            NodeSpec(
                "near",
                __name__,
                inputs([*PONG.values(), TICK], [DONE]),
                {t.name: t.name for t in names["near"]},
            ),
            NodeSpec(
                "far",
                __name__,
                inputs([*PING.values()], [*FLOOD.values(), ORDER]),
                {t.name: t.name for t in names["far"]},
            ),
        ],
    )


class OurNear:
    """The asking end on the bus."""

    name = "footfall"

    def __init__(self, run_dir: str, raw: "RawNear") -> None:
        self.raw = raw
        self.bus = ZmqBus(bench_graph(run_dir), "near", BENCH_TOPICS)
        if missing := self.bus.wait_connected(20.0):
            raise BusError("; ".join(missing))
        self.messages = {size: sample(size) for size in SIZES}

    def begin_turn(self) -> None:
        """Let the other end listen to the bus."""
        self.raw.socket.send(BUS_TURN)

    def end_turn(self) -> None:
        """Let the other end listen to the raw socket again."""
        self.bus.publish(ORDER, Flood("end", 0), 0)
        self._wait_done()

    def round_trip(self, size: str) -> None:
        """Send a message and take the answer."""
        bus = self.bus
        bus.publish(PING[size], self.messages[size], 0)
        while True:
            if not bus.poll(10.0):
                raise BusError(f"no answer to {size} within 10 s")
            if any(received.topic == PONG[size].name for received in take(bus)):
                return

    def flood(self, size: str, count: int) -> None:
        """Send many, and wait until the other end has them all."""
        self.bus.publish(ORDER, Flood(size, count), 0)
        for _ in range(count):
            self.bus.publish(FLOOD[size], self.messages[size], 0)
        self._wait_done()

    def _wait_done(self) -> None:
        while self.bus.poll(60.0):
            if any(received.topic == DONE.name for received in take(self.bus)):
                return
        raise BusError("the other end does not answer")

    def latest_ages(self, busy: float, trials: int) -> list[float]:
        """Age of the newest message of a 1 kHz topic when a consumer that was busy comes back [s]."""
        self.begin_turn()
        self.bus.publish(ORDER, Flood("tick", int((busy + 0.01) * trials * 1000) + 500), 0)
        ages = []
        for _ in range(trials):
            sleep(busy)
            self.bus.poll(0)
            ticks = [received for received in take(self.bus) if received.topic == TICK.name]
            ages.append((monotonic_ns() - ticks[-1].sent_ns) * 1e-9)
        return ages

    def close(self) -> None:
        """Let go of the sockets."""
        self.bus.close()


def far(run_dir: str) -> None:
    """The answering end of both transports, in turns as the asking end says; runs until it is killed."""
    raw = zmq.Context().socket(zmq.PAIR)
    raw.setsockopt(zmq.RCVHWM, 128)
    raw.connect(f"ipc://{run_dir}/raw")
    bus = ZmqBus(bench_graph(run_dir), "far", BENCH_TOPICS)
    bus.wait_connected(20.0)
    pipes, _ = open_pipes(run_dir, "far")
    left: dict[str, int] = {}
    while True:
        frame = raw.recv(copy=False)
        if len(frame) >= 64:
            _array_of(frame)
            raw.send(frame, copy=False)
            continue
        word = bytes(frame.buffer)
        if word == BUS_TURN:
            while _answer(bus, left):
                pass
            continue
        name, _, turn = word.decode().partition(" ")
        if name in pipes:
            answer(pipes[name], turn.encode())
            continue
        for _ in range(int(word)):
            _array_of(raw.recv(copy=False))
        raw.send(b"done")


def _answer(bus: ZmqBus, left: dict[str, int]) -> bool:
    """Take what comes next on the bus and do as it says; false at the end of the bus's turn."""
    bus.poll(30.0)
    for received in take(bus):
        if answer := _PONG_OF.get(received.topic):
            bus.publish(answer, received.message, 0)
        elif received.topic == ORDER.name and received.message.size == "end":
            bus.publish(DONE, received.message, 0)
            return False
        elif received.topic == ORDER.name and received.message.size == "tick":
            _tick(bus, received.message.count)
        elif received.topic == ORDER.name:
            _count(bus, left, received.message.size, received.message.count)
        else:
            _count(bus, left, received.topic.removeprefix("flood_"), -1)
    return True


def _array_of(frame: zmq.Frame) -> np.ndarray:
    return np.frombuffer(frame.buffer, np.uint8)


def _count(bus: ZmqBus, left: dict[str, int], size: str, change: int) -> None:
    left[size] = left.get(size, 0) + change
    if left[size] == 0:
        bus.publish(DONE, Flood(size, 0), 0)


def _tick(bus: ZmqBus, count: int) -> None:
    message, start = sample("64"), perf_counter()
    for index in range(count):
        bus.publish(TICK, message, index)
        sleep(max(0.0, start + (index + 1) * 1e-3 - perf_counter()))


class RawNear:
    """The asking end on two raw sockets: the same bytes in one frame, without copies."""

    name = "raw pyzmq"

    def __init__(self, run_dir: str) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.PAIR)
        self.socket.setsockopt(zmq.SNDHWM, 128)
        self.socket.bind(f"ipc://{run_dir}/raw")
        self.arrays = {size: _raw_bytes(sample(size)) for size in SIZES}

    def round_trip(self, size: str) -> None:
        """Send an array and receive one."""
        self.socket.send(self.arrays[size], copy=False)
        _array_of(self.socket.recv(copy=False))

    def begin_turn(self) -> None:
        """Nothing to do: raw is what the other end listens to between turns."""

    def end_turn(self) -> None:
        """Nothing to do."""

    def flood(self, size: str, count: int) -> None:
        """Send many, and wait until the other end has them all."""
        self.socket.send(f"{count}".encode())
        for _ in range(count):
            self.socket.send(self.arrays[size], copy=False)
        self.socket.recv()

    def close(self) -> None:
        """Let go of the socket."""
        self.socket.close(linger=0)
        self.context.term()


def _raw_bytes(message: msgspec.Struct) -> bytes:
    parts = [getattr(message, name) for name in message.__struct_fields__]
    return b"".join(part.tobytes() for part in parts)


@dataclass
class _Series:
    """What was measured of one transport at one size."""

    round_trips: list[float] = field(default_factory=list)
    """One after the other, as fast as it goes: median of each turn [s]."""
    paced: list[float] = field(default_factory=list)
    """One a millisecond or slower, everybody having gone to sleep in between: median of each turn [s]."""
    rates: list[float] = field(default_factory=list)
    """Messages a second, by turn."""


End = RawNear | OurNear | PeerNear
"""The asking end of a transport."""

ROUND_TRIPS = {"64": 4000, "39k": 4000, "1m": 1200, "6m": 300}
FLOODS = {"64": 4000, "39k": 2000, "1m": 200, "6m": 60}
PACED = 800
TURNS = 20


def measure(quick: bool = False, sizes: tuple[str, ...] = tuple(SIZES), peers: bool = True) -> dict[str, Any]:
    """All transports in turns; medians, their ratios, and the age of `latest` behind a busy consumer.

    Returns:
        `rtt_ratio`, `paced_rtt_ratio` and `throughput_ratio` (ours by raw) by size; `rtt_us`,
        `paced_rtt_us` and `messages_per_second` by transport and size; `latest_age_ms` (`median` and
        `max`); `goals_met`; `peers` by name, with the same by size beside raw, or why it is left out.
    """
    share = 5 if quick else 1
    with tempfile.TemporaryDirectory(prefix="ffbench-") as run_dir:
        pipes, left_out = open_pipes(run_dir, "near") if peers else ({}, {})
        other = subprocess.Popen([sys.executable, "-m", "footfall.tools.bench_bus", run_dir])
        try:
            raw = RawNear(run_dir)
            ours = OurNear(run_dir, raw)
            others = [PeerNear(name, pipe, raw.socket.send, raw.arrays) for name, pipe in pipes.items()]
            ends: list[End] = [raw, ours, *others]
            series = {end.name: {size: _Series() for size in sizes} for end in ends}
            for size in sizes:
                for end in ends:
                    end.begin_turn()
                    for _ in range(20):
                        end.round_trip(size)
                    end.end_turn()
                for turn in range(TURNS):
                    for end in ends if turn % 2 else reversed(ends):
                        if end not in others or end.takes(size):
                            _take_turn(end, size, series[end.name][size], share)
            ages = ours.latest_ages(0.2 if quick else 0.6, 4 if quick else 10)
        finally:
            other.kill()
            other.wait()
        for end in ends:
            end.close()
    facts = {end.name: _peer_facts(end, series) for end in others}
    return _summary(series, ages) | {
        "peers": facts | {name: {"left_out": reason} for name, reason in left_out.items()}
    }


def _peer_facts(end: PeerNear, series: "dict[str, dict[str, _Series]]") -> dict[str, Any]:
    """What was measured of a peer; None for what does not come through or cannot be flooded."""
    raw, own = series[RawNear.name], series[end.name]
    sizes = {size: end.takes(size) for size in own}
    floods = end.facts()["throughput_measured"]
    rtt = {size: median(own[size].round_trips) if ok else None for size, ok in sizes.items()}
    rates = {size: median(own[size].rates) if ok and floods else None for size, ok in sizes.items()}
    return {
        **end.facts(),
        "rtt_us": {size: value and round(value * 1e6, 1) for size, value in rtt.items()},
        "paced_rtt_us": {
            size: round(median(own[size].paced) * 1e6, 1) if ok else None for size, ok in sizes.items()
        },
        "messages_per_second": {size: rate and round(rate, 1) for size, rate in rates.items()},
        "rtt_ratio": {
            size: value and _ratio(own[size].round_trips, raw[size].round_trips)
            for size, value in rtt.items()
        },
        "throughput_ratio": {
            size: rate and _ratio(own[size].rates, raw[size].rates) for size, rate in rates.items()
        },
    }


def _ratio(ours: list[float], raw: list[float]) -> float:
    """Median over turns of ours by raw; what the machine does in a while meets both of a turn."""
    return round(median(our / its for our, its in zip(ours, raw, strict=True)), 3)


def _take_turn(end: "End", size: str, series: _Series, share: int) -> None:
    end.begin_turn()
    for pause, count, times in (
        (0.0, ROUND_TRIPS[size] // TURNS, series.round_trips),
        (1e-3, PACED // TURNS, series.paced),
    ):
        taken = []
        for _ in range(max(3, count // share)):
            if pause:
                sleep(pause)
            begin = perf_counter()
            end.round_trip(size)
            taken.append(perf_counter() - begin)
        times.append(median(taken))
    count = max(5, FLOODS[size] // TURNS // share)
    begin = perf_counter()
    end.flood(size, count)
    series.rates.append(count / (perf_counter() - begin))
    end.end_turn()


def _summary(series: dict[str, dict[str, _Series]], ages: list[float]) -> dict[str, Any]:
    raw, ours = series[RawNear.name], series[OurNear.name]
    series = {RawNear.name: raw, OurNear.name: ours}
    rtt = {size: _ratio(ours[size].round_trips, raw[size].round_trips) for size in raw}
    return {
        "rtt_ratio": rtt,
        "paced_rtt_ratio": {size: _ratio(ours[size].paced, raw[size].paced) for size in raw},
        "throughput_ratio": {size: _ratio(ours[size].rates, raw[size].rates) for size in raw},
        "rtt_us": {
            name: {size: round(median(one.round_trips) * 1e6, 1) for size, one in by_size.items()}
            for name, by_size in series.items()
        },
        "paced_rtt_us": {
            name: {size: round(median(one.paced) * 1e6, 1) for size, one in by_size.items()}
            for name, by_size in series.items()
        },
        "messages_per_second": {
            name: {size: round(median(one.rates), 1) for size, one in by_size.items()}
            for name, by_size in series.items()
        },
        "latest_age_ms": {"median": round(median(ages) * 1e3, 2), "max": round(max(ages) * 1e3, 2)},
        "goals_met": all(rtt[size] <= GOALS[size] for size in rtt),
    }


def run(args: argparse.Namespace) -> int:
    """Measure and print; 1 if a goal is missed."""
    result = measure(args.quick, peers=not args.no_peers)
    if args.json:
        print(json.dumps(result))
        return 0 if result["goals_met"] else 1
    print(f"{'':16}" + "".join(f"{size:>12}" for size in SIZES))
    for title, rows in (
        ("round trip [us]", result["rtt_us"]),
        ("messages / s", result["messages_per_second"]),
    ):
        print(title)
        for name, row in rows.items():
            print(f"  {name:14}" + "".join(f"{row[size]:12.1f}" for size in SIZES))
    for title, key in (
        ("round trip", "rtt_ratio"),
        ("paced", "paced_rtt_ratio"),
        ("throughput", "throughput_ratio"),
    ):
        print(f"{title + ' ratio':16}" + "".join(f"{result[key][size]:12.2f}" for size in SIZES))
    print(f"{'goal':16}" + "".join(f"{goal:12.2f}" for goal in GOALS.values()))
    for name, facts in result["peers"].items():
        if reason := facts.get("left_out"):
            print(f"{name}: left out: {reason}")
            continue
        print(f"{name} {facts['version']} ({facts['licence']})")
        for key in ("rtt_us", "rtt_ratio", "throughput_ratio"):
            cells = ["-" if value is None else f"{value:.2f}" for value in facts[key].values()]
            print(f"  {key:<14}" + "".join(f"{cell:>12}" for cell in cells))
        if facts["lost"]:
            print(f"  lost          {facts['lost']}")
    age = result["latest_age_ms"]
    print(f"age of `latest` behind a busy consumer: {age['median']} ms, at most {age['max']} ms")
    return 0 if result["goals_met"] else 1


if __name__ == "__main__":
    far(sys.argv[1])
