"""A log as it happened: what was sent between one clock tick and the next."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from .log_reader import Logged, LogReader
from .topics import CLOCK

LATENESS_NS = 10_000_000_000
"""A message may speak of a time this long before it was sent, as the plans of a slow planner do."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick of the recorded clock with all that was sent since the one before."""

    step: int
    stamp_ns: int
    step_ns: int
    messages: list[Logged[Any]]
    places: list[float]
    """When each message was sent, as a share (0 to 1) of the wall time since the tick before."""
    repeats: bool = False
    """The tick itself has been given before: these are messages that came after the last one."""


def ticks(
    reader: LogReader,
    topics: Collection[str],
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Tick]:
    """The messages of `topics` by the tick before which they were sent.

    What was sent after the last tick comes with that tick once more, marked as a repetition. Without a
    recorded clock every new stamp is a tick.

    Args:
        reader: The log.
        topics: Topics to give; the clock itself is not among the messages.
        start_ns: First tick's simulation time.
        end_ns: Simulation time after the last tick.
    """
    wanted = {*topics} & {*reader.topics}
    if CLOCK.name in reader.topics:
        yield from _by_clock(reader, wanted, start_ns, end_ns)
    elif wanted:
        yield from _by_stamp(reader, wanted, start_ns, end_ns)


def _by_clock(
    reader: LogReader, topics: set[str], start_ns: int | None, end_ns: int | None
) -> Iterator[Tick]:
    early = None if start_ns is None else max(0, start_ns - LATENESS_NS)
    since: list[Logged[Any]] = []
    last: Logged[Any] | None = None
    clock = None
    for item in reader.messages(topics | {CLOCK.name}, start_ns=early, order="sent"):
        if item.topic != CLOCK.name:
            since.append(item)
            continue
        if last is not None and item.stamp_ns == last.stamp_ns:
            continue  # said again while time stood still
        clock = item.message
        if end_ns is not None and item.stamp_ns >= end_ns:
            return
        if start_ns is None or item.stamp_ns >= start_ns:
            yield Tick(clock.step, item.stamp_ns, clock.step_ns, since, _places(since, last, item.sent_ns))
        since, last = [], item
    if since and clock is not None and last is not None and (start_ns is None or last.stamp_ns >= start_ns):
        yield Tick(clock.step, last.stamp_ns, clock.step_ns, since, [0.0] * len(since), True)


def _places(messages: list[Logged[Any]], last: Logged[Any] | None, end_ns: int) -> list[float]:
    if last is None or end_ns <= last.sent_ns:
        return [1.0] * len(messages)
    length = end_ns - last.sent_ns
    return [min(1.0, max(0.0, (item.sent_ns - last.sent_ns) / length)) for item in messages]


def _by_stamp(
    reader: LogReader, topics: set[str], start_ns: int | None, end_ns: int | None
) -> Iterator[Tick]:
    step, last_ns = 0, 0
    since: list[Logged[Any]] = []
    for item in reader.messages(topics, start_ns=start_ns, end_ns=end_ns):
        if since and item.stamp_ns != since[0].stamp_ns:
            stamp_ns = since[0].stamp_ns
            yield Tick(step, stamp_ns, stamp_ns - last_ns, since, [1.0] * len(since))
            step, last_ns, since = step + 1, stamp_ns, []
        since.append(item)
    if since:
        stamp_ns = since[0].stamp_ns
        yield Tick(step, stamp_ns, stamp_ns - last_ns, since, [1.0] * len(since))
