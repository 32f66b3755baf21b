"""`footfall log info`: topics, counts, rates, sizes, times, the graph and the releases of a log."""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..messages.log import LogError, LogReader


@dataclass
class Row:
    """One publisher on one topic."""

    topic: str
    publisher: str
    type: str
    schema: str
    latched: bool
    count: int = 0
    bytes: int = 0
    first: float = float("inf")
    """Stamp of the first message [s]."""
    last: float = float("-inf")
    restarts: int = 0

    @property
    def rate(self) -> float | None:
        """Messages per simulated second."""
        return (self.count - 1) / (self.last - self.first) if self.last > self.first else None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command line takes."""
    parser.add_argument("log", type=Path, help="recorded log (.mcap)")
    parser.add_argument("--schema", metavar="TOPIC", help="print the JSON Schema of a topic's messages")
    parser.add_argument("--graph", action="store_true", help="print the graph the log was recorded from")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print what is in a log."""
    reader = LogReader(args.log)
    if args.schema:
        reader.check_topics([args.schema])
        channel = next(channel for channel in reader.channels if channel.topic == args.schema)
        print(json.dumps(channel.json_schema, indent=2))
    elif args.graph:
        if reader.graph is None:
            raise LogError(f"{args.log}: no graph is attached")
        print(reader.index.attachments["graph.json"].decode())
    else:
        facts = describe(reader)
        print(json.dumps(facts) if args.json else _text(facts))
    return 0


def rows_of(reader: LogReader) -> list[Row]:
    """What stands in a log by topic and publisher; reads it through."""
    rows: dict[str, Row] = {}
    for channel in reader.channels:
        row = rows.setdefault(
            channel.source,
            Row(channel.topic, channel.publisher, channel.type_name, channel.schema, channel.latched),
        )
        row.restarts = max(row.restarts, channel.life)
    for item in reader.messages(order="file"):
        row = rows[item.source]
        row.count += 1
        row.bytes += len(item.record)
        row.first = min(row.first, item.stamp_ns * 1e-9)
        row.last = max(row.last, item.stamp_ns * 1e-9)
    return [rows[source] for source in sorted(rows)]


def describe(reader: LogReader) -> dict[str, Any]:
    """Everything `info` says, as plain data."""
    first_ns, last_ns = reader.span_ns
    graph = reader.graph
    return {
        "path": str(reader.path),
        "bytes": reader.index.size,
        "complete": reader.index.complete,
        "recovered": not reader.index.complete,
        "damaged": reader.index.damaged,
        "start": first_ns * 1e-9,
        "end": last_ns * 1e-9,
        "duration": (last_ns - first_ns) * 1e-9,
        "messages": reader.message_count,
        "chunks": len(reader.index.chunks),
        "graph": reader.run.get("graph"),
        "nodes": [node.name for node in graph.nodes] if graph else [],
        "mode": graph.clock.mode if graph else None,
        "seed": int(reader.run["seed"]) if "seed" in reader.run else None,
        "recorded": reader.run.get("recorded"),
        "versions": reader.versions,
        "repeated": reader.repeated,
        "topics": [
            {
                "topic": row.topic,
                "publisher": row.publisher,
                "type": row.type,
                "schema": row.schema,
                "latched": row.latched,
                "count": row.count,
                "rate": row.rate,
                "bytes": row.bytes,
                "first": row.first if row.count else None,
                "last": row.last if row.count else None,
                "restarts": row.restarts,
            }
            for row in rows_of(reader)
        ],
    }


def _text(facts: dict[str, Any]) -> str:
    state = "" if facts["complete"] else " (not finished by its recorder; complete chunks recovered)"
    versions = " ".join(f"{name} {release}" for name, release in facts["versions"].items())
    lines = [
        f"{facts['path']}: {_size(facts['bytes'])}, {facts['messages']} messages{state}",
        f"time      {facts['start']:.3f} to {facts['end']:.3f} s ({facts['duration']:.3f} s)",
        f"recorded  {facts['recorded'] or 'unknown'}",
        f"graph     {facts['graph'] or 'none attached'}, {facts['mode']} clock, seed {facts['seed']}",
        f"versions  {versions or 'unknown'}",
        "",
        f"{'topic':<18}{'publisher':<13}{'type':<16}{'schema':<18}{'count':>8}{'Hz':>8}{'size':>10}"
        f"{'first':>10}{'last':>10}",
    ]
    for row in facts["topics"]:
        rate = "" if row["rate"] is None else f"{row['rate']:.2f}"
        first, last = ("" if row[key] is None else f"{row[key]:.3f}" for key in ("first", "last"))
        lines.append(
            f"{row['topic']:<18}{row['publisher']:<13}{row['type']:<16}{row['schema']:<18}{row['count']:>8}"
            f"{rate:>8}{_size(row['bytes']):>10}{first:>10}{last:>10}"
        )
    return "\n".join(lines)


def _size(count: int) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}" if unit != "B" else f"{count} B"
        count /= 1000  # type: ignore[assignment]
    return f"{count:.3g} GB"
