"""`footfall topic hz`, `bw` and `delay`: how often, how much, how late."""

import argparse
import json
from collections import deque
from time import monotonic, monotonic_ns
from typing import NamedTuple

import numpy as np

from ..messages.codec import Header
from ..messages.zmq_bus import ZmqBus
from .observe import complain, open_source


class Arrival(NamedTuple):
    """One message, seen from outside."""

    sent_ns: int
    arrived_ns: int
    size: int
    """[bytes]"""


def rates(args: argparse.Namespace) -> int:
    """Report once a second what the last `--window` seconds were like."""
    bus = open_source(args, args.topic)
    arrivals: deque[Arrival] = deque()
    reports = 0
    try:
        while args.count is None or reports < args.count:
            _listen(bus, arrivals, 1.0)
            horizon = monotonic_ns() - int(args.window * 1e9)
            while arrivals and arrivals[0].arrived_ns < horizon:
                arrivals.popleft()
            report = {"topic": args.topic, **REPORTS[args.verb](list(arrivals))}
            print(json.dumps(report) if args.json else _line(report), flush=True)
            reports += 1
    finally:
        bus.close()
    return 0 if arrivals or args.count is None else 1


def _listen(bus: ZmqBus, arrivals: deque[Arrival], seconds: float) -> None:
    """Note what comes, without decoding it."""
    end = monotonic() + seconds
    while (left := end - monotonic()) > 0:
        bus.poll(min(left, 0.1))
        now = monotonic_ns()
        for inlet in bus.inlets:
            while inlet.pending:
                header, body, frames = inlet.pending.popleft()
                size = Header.SIZE + len(body) + sum(len(frame) for frame in frames)
                arrivals.append(Arrival(header.sent_ns, now, size))
        complain(bus.inlets)


def _line(report: dict[str, object]) -> str:
    head, *rest = report.items()
    texts = [f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in rest]
    return f"{head[1]}: {', '.join(texts)}"


def _spread(values: np.ndarray, unit: str, scale: float) -> dict[str, float]:
    """Mean, minimum, maximum and 95th percentile."""
    if not len(values):
        return {}
    figures = {
        "mean": values.mean(),
        "min": values.min(),
        "max": values.max(),
        "p95": np.percentile(values, 95),
    }
    return {f"{name}_{unit}": round(float(value) * scale, 3) for name, value in figures.items()}


def hz(arrivals: list[Arrival]) -> dict[str, float]:
    """Rate and intervals, by the time of sending."""
    times = np.sort(np.array([a.sent_ns for a in arrivals], dtype=np.int64))
    intervals = np.diff(times)
    rate = len(intervals) / (intervals.sum() * 1e-9) if len(intervals) and intervals.sum() else 0.0
    return {"messages": len(arrivals), "hz": round(rate, 3), **_spread(intervals, "ms", 1e-6)}


def bw(arrivals: list[Arrival]) -> dict[str, float]:
    """Bytes a second, and sizes."""
    sizes = np.array([a.size for a in arrivals], dtype=np.int64)
    span = (arrivals[-1].arrived_ns - arrivals[0].arrived_ns) * 1e-9 if len(arrivals) > 1 else 0.0
    rate = float(sizes[1:].sum() / span) if span else 0.0
    return {"messages": len(arrivals), "bytes_per_s": round(rate, 1), **_spread(sizes, "bytes", 1.0)}


def delay(arrivals: list[Arrival]) -> dict[str, float]:
    """Time from sending to arriving here."""
    delays = np.array([a.arrived_ns - a.sent_ns for a in arrivals], dtype=np.int64)
    return {"messages": len(arrivals), **_spread(delays, "ms", 1e-6)}


REPORTS = {"hz": hz, "bw": bw, "delay": delay}
