"""`footfall log hash`: one SHA-256 of what happened; two lockstep runs of one seed share it.

Counted are the topics that are deterministic, in the order of simulation time, topic, publisher and sequence
number, each message without its volatile fields. Wall-clock times, publishers' names and sequence numbers are
not part of the sum.
"""

import argparse
import hashlib
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ..messages.codec import plain
from ..messages.log import LogReader


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command line takes."""
    parser.add_argument("log", type=Path, help="recorded log (.mcap)")
    parser.add_argument(
        "--topics", metavar="TOPIC,...", help="only these (default: all that are deterministic)"
    )
    parser.add_argument("--per-topic", action="store_true", help="a hash for each topic too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print the hash."""
    topics = [name for name in args.topics.split(",") if name] if args.topics else None
    total, by_topic = hash_log(LogReader(args.log), topics)
    if args.json:
        print(json.dumps({"hash": total} | ({"topics": by_topic} if args.per_topic else {})))
        return 0
    if args.per_topic:
        for topic, digest in by_topic.items():
            print(f"{digest}  {topic}")
    print(total)
    return 0


def hash_log(reader: LogReader, topics: Collection[str] | None = None) -> tuple[str, dict[str, str]]:
    """SHA-256 of a log in hexadecimal, and that of each topic by itself.

    Args:
        reader: The log.
        topics: Topics that count; None for all deterministic ones.

    Raises:
        LogError: an unknown topic.
    """
    wanted = deterministic_topics(reader) if topics is None else topics
    total = hashlib.sha256()
    by_topic = {name: hashlib.sha256() for name in sorted(wanted)}
    for item in reader.messages(wanted):
        data = canonical(item.topic, item.stamp_ns, item.message)
        total.update(data)
        by_topic[item.topic].update(data)
    return total.hexdigest(), {name: digest.hexdigest() for name, digest in by_topic.items()}


def deterministic_topics(reader: LogReader) -> list[str]:
    """Topics that are the same in two lockstep runs of one seed."""
    return sorted({channel.topic for channel in reader.channels if channel.deterministic})


def canonical(topic: str, stamp_ns: int, message: Any) -> bytes:
    """The bytes of a message that count: fields by name in order, arrays with dtype and shape."""
    fields = plain(message, volatile=False)
    return msgspec.msgpack.encode([topic, stamp_ns, _ordered(fields)])


def _ordered(value: Any) -> Any:
    if isinstance(value, dict):
        return [[key, _ordered(value[key])] for key in sorted(value)]
    if isinstance(value, list):
        return [_ordered(item) for item in value]
    if isinstance(value, np.ndarray):
        return [value.dtype.str, list(value.shape), value.tobytes()]
    return value
