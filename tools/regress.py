"""`footfall regress`: replay a node's inputs step by step and compare what it gives with the log."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .log_diff import add_tolerance_arguments, plain_difference, tolerance_of

if TYPE_CHECKING:
    from .regress_node import Result


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `regress` to the command line."""
    parser = subparsers.add_parser(
        "regress",
        help="replay a node's inputs and compare its outputs with a log",
        description="Give a fresh node exactly the inputs each of its steps had, and compare its outputs "
        "with the recorded ones. Returns 0 if they are the same, 1 if not.",
    )
    parser.add_argument("log", type=Path, help="recorded log (.mcap)")
    parser.add_argument("--node", required=True, help="name of the node in the recorded graph")
    add_tolerance_arguments(parser)
    parser.add_argument("--update", type=Path, metavar="OUT", help="write a log with the new outputs")
    parser.add_argument("--json", action="store_true", help="print one JSON object, last line")


def run(args: argparse.Namespace) -> int:
    """Compare; returns 0 if nothing differs, else 1."""
    from ..messages.log import LogReader
    from .regress_node import regress, write_update

    if os.getcwd() not in sys.path:  # where nodes of one's own were found when they ran
        sys.path.append(os.getcwd())
    reader = LogReader(args.log)
    result = regress(reader, args.node, tolerance_of(args))
    if args.update:
        write_update(reader, args.node, result, args.update)
    print(json.dumps(_plain(result)) if args.json else _text(result), flush=True)
    return 0 if result.same or args.update else 1


def _plain(result: "Result") -> dict[str, Any]:
    first = result.first
    return {
        "node": result.node,
        "same": result.same,
        "steps": result.steps,
        "topics": {topic: {"recorded": a, "now": b} for topic, (a, b) in sorted(result.counts.items())},
        "first": first and {"topic": first[0]} | plain_difference(*first[1:]),
        "wall_seconds": result.wall_seconds,
    }


def _text(result: "Result") -> str:
    lines = [
        f"{topic}: {recorded} messages recorded, {now} now"
        for topic, (recorded, now) in sorted(result.counts.items())
        if recorded != now
    ]
    if result.first:
        topic, number, time, difference = result.first
        lines.append(f"{topic}: message {number} at {time:.3f} s: {difference.text}")
    total = sum(now for _, now in result.counts.values())
    verdict = "same" if result.same else "differs"
    return "\n".join([*lines, f"{verdict}: {result.steps} steps of {result.node}, {total} messages"])
