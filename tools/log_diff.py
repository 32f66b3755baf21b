"""`footfall log diff`: where two logs differ first, by topic, message, field and element."""

import argparse
import json
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from ..messages.compare import Difference, Tolerance, first_difference
from ..messages.config import ConfigError
from ..messages.log import LogError, LogReader
from .log_hash import deterministic_topics


@dataclass
class TopicDiff:
    """How one topic differs."""

    topic: str
    counts: tuple[int, int]
    first: tuple[int, float, Difference] | None = None
    """Number of the first message that differs (from 0), its time [s], and where it differs."""

    @property
    def same(self) -> bool:
        """Whether it does not."""
        return self.counts[0] == self.counts[1] and self.first is None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command line takes."""
    parser.add_argument("left", type=Path, help="one log")
    parser.add_argument("right", type=Path, help="the other")
    parser.add_argument(
        "--topics", metavar="TOPIC,...", help="only these (default: all that are deterministic)"
    )
    add_tolerance_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def add_tolerance_arguments(parser: argparse.ArgumentParser) -> None:
    """Options on what counts as the same."""
    parser.add_argument("--ignore", metavar="FIELD,...", default="", help="fields that do not count")
    parser.add_argument(
        "--tolerance",
        metavar="FIELD=X",
        action="append",
        default=[],
        help="largest difference that counts as none; repeatable",
    )


def tolerance_of(args: argparse.Namespace) -> Tolerance:
    """The options as a `Tolerance`.

    Raises:
        ConfigError: a malformed one.
    """
    absolute = {}
    for text in args.tolerance:
        name, _, value = text.partition("=")
        try:
            absolute[name] = float(value)
        except ValueError:
            raise ConfigError(f"--tolerance {text}: must be FIELD=NUMBER, e.g. positions=1e-6") from None
    return Tolerance([name for name in args.ignore.split(",") if name], absolute)


def run(args: argparse.Namespace) -> int:
    """Compare; returns 0 if the logs are the same, else 1."""
    left, right = LogReader(args.left), LogReader(args.right)
    wanted = [name for name in args.topics.split(",") if name] if args.topics else None
    diffs = diff_logs(left, right, wanted, tolerance_of(args))
    same = all(diff.same for diff in diffs)
    print(json.dumps(_plain(diffs, same)) if args.json else _text(diffs, same))
    return 0 if same else 1


def diff_logs(
    left: LogReader, right: LogReader, topics: list[str] | None = None, tolerance: Tolerance | None = None
) -> list[TopicDiff]:
    """Compare two logs topic by topic, messages in the order of stamp, publisher and sequence number.

    Args:
        left: One log.
        right: The other.
        topics: Topics that count; None for all deterministic ones of both.
        tolerance: What counts as the same.

    Raises:
        LogError: a topic that is in neither log.
    """
    known = {*left.topics, *right.topics}
    if topics is None:
        topics = sorted({*deterministic_topics(left), *deterministic_topics(right)})
    for name in topics:
        if name not in known:
            raise LogError(f"neither log has a topic {name!r}; they have {', '.join(sorted(known))}")
    return [_diff_topic(left, right, name, tolerance) for name in topics]


def _diff_topic(left: LogReader, right: LogReader, topic: str, tolerance: Tolerance | None) -> TopicDiff:
    sides = [reader.messages([topic]) if topic in reader.topics else iter(()) for reader in (left, right)]
    counts, first = [0, 0], None
    tolerance = tolerance or Tolerance()
    for number, (ours, theirs) in enumerate(zip_longest(*sides)):
        counts[0] += ours is not None
        counts[1] += theirs is not None
        if first is None and ours is not None and theirs is not None:
            if ours.stamp_ns != theirs.stamp_ns:
                found = Difference("stamp [s]", None, ours.stamp_ns * 1e-9, theirs.stamp_ns * 1e-9)
            else:
                found = first_difference(ours.message, theirs.message, tolerance)
            if found is not None:
                first = (number, ours.stamp_ns * 1e-9, found)
    return TopicDiff(topic, (counts[0], counts[1]), first)


def _plain(diffs: list[TopicDiff], same: bool) -> dict[str, Any]:
    rows = []
    for diff in diffs:
        row: dict[str, Any] = {"topic": diff.topic, "counts": list(diff.counts), "same": diff.same}
        if diff.first:
            row["first"] = plain_difference(*diff.first)
        rows.append(row)
    return {"same": same, "topics": rows}


def plain_difference(number: int, time: float, difference: Difference) -> dict[str, Any]:
    """A difference as plain data for JSON."""
    return {
        "message": number,
        "time": time,
        "field": difference.field,
        "index": difference.index,
        "values": [_jsonable(difference.left), _jsonable(difference.right)],
    }


def _jsonable(value: Any) -> Any:
    return value if isinstance(value, (bool, int, float, str, type(None))) else repr(value)


def _text(diffs: list[TopicDiff], same: bool) -> str:
    lines = []
    for diff in diffs:
        if diff.counts[0] != diff.counts[1]:
            lines.append(f"{diff.topic}: {diff.counts[0]} and {diff.counts[1]} messages")
        if diff.first:
            number, time, difference = diff.first
            lines.append(f"{diff.topic}: message {number} at {time:.3f} s: {difference.text}")
    total = sum(diff.counts[0] for diff in diffs)
    return "\n".join(lines) if not same else f"same: {total} messages on {len(diffs)} topics"
