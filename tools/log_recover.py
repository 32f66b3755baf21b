"""`footfall log recover`: every complete chunk of a log that was cut short or damaged, as a whole log."""

import argparse
import json
from pathlib import Path

from ..messages.log import LogReader, LogWriter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command line takes."""
    parser.add_argument("log", type=Path, help="log that was not finished")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT", help="the whole log")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Recover a log."""
    facts = recover(args.log, args.output)
    if args.json:
        print(json.dumps(facts))
    else:
        lost = f"; {facts['damaged']} damaged records left out" if facts["damaged"] else ""
        print(f"{args.output}: {facts['messages']} messages up to {facts['end']:.3f} s{lost}")
    return 0


def recover(source: Path, output: Path) -> dict[str, object]:
    """Copy everything readable of `source` to a new log.

    Raises:
        LogError: `source` is not a log, or `output` exists.
    """
    reader = LogReader(source, salvage=True)
    with LogWriter(output, metadata=reader.index.metadata) as writer:
        for name, data in reader.index.attachments.items():
            writer.attach(name, "application/json", data)
        for item in reader.messages(order="file"):
            writer.copy(item)
    return {
        "output": str(output),
        "messages": reader.message_count,
        "damaged": reader.index.damaged,
        "end": reader.span_ns[1] * 1e-9,
    }
