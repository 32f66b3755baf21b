"""`footfall top`: the nodes of a running graph, once a second: work, memory, losses, ages."""

import argparse
import json
import sys
from collections.abc import Iterable
from time import monotonic
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..messages.diagnostics import Diagnostics
    from ..messages.zmq_bus import ZmqBus

PATIENCE = 2.5
"""Nodes report about once a second; who has not for so long is shown as silent [s]."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `top`."""
    from .observe import add_source_arguments

    parser = subparsers.add_parser("top", help="watch the nodes of a running graph")
    add_source_arguments(parser, log=False, remote=False)
    parser.add_argument("--once", action="store_true", help="print once and end")
    parser.add_argument("--json", action="store_true", help="print one JSON object a time")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print until stopped; 1 if no node reports."""
    from ..messages.topics import CLOCK, DIAGNOSTICS
    from .observe import graph_of, observer

    graph = graph_of(args)
    expected = sorted(node.name for node in graph.nodes if DIAGNOSTICS.name in node.outputs.values())
    bus = observer(graph, [DIAGNOSTICS.name, CLOCK.name])
    reports: dict[str, tuple[float, Diagnostics]] = {}
    now_ns = [0]
    try:
        while True:
            _gather(bus, reports, now_ns, expected, 1.0 if reports else PATIENCE)
            rows = [_row(name, reports.get(name)) for name in expected]
            _show(args, graph.name, now_ns[0] * 1e-9, rows)
            if args.once:
                return 0 if reports else 1
    finally:
        bus.close()


def _gather(
    bus: "ZmqBus",
    reports: "dict[str, tuple[float, Diagnostics]]",
    now_ns: list[int],
    expected: Iterable[str],
    seconds: float,
) -> None:
    """Take reports for some time, or at first until everybody has reported once."""
    from ..messages.bus import take
    from ..messages.diagnostics import Diagnostics

    first = not reports
    end = monotonic() + seconds
    while (left := end - monotonic()) > 0 and not (first and set(expected) <= set(reports)):
        bus.poll(min(left, 0.1))
        for received in take(bus):
            now_ns[0] = max(now_ns[0], received.stamp_ns)
            if isinstance(received.message, Diagnostics):
                reports[received.message.node] = monotonic(), received.message


def _row(name: str, report: "tuple[float, Diagnostics] | None") -> dict[str, Any]:
    """What is shown of a node; None where it is silent."""
    if report is None:
        return {"node": name, "silent": True}
    when, one = report
    ages = [(entry.age, f"{entry.topic}@{entry.publisher}") for entry in one.inputs if entry.age is not None]
    return {
        "node": name,
        "silent": monotonic() - when > PATIENCE,
        "pid": one.pid,
        "cpu": round(one.cpu, 3),
        "memory_mb": round(one.memory / 2**20, 1),
        "steps": one.steps,
        "step_ms": round(one.step_time * 1e3, 3),
        "step_max_ms": round(one.step_time_max * 1e3, 3),
        "dropped": sum(entry.dropped for entry in one.inputs),
        "skipped": sum(entry.skipped for entry in one.inputs),
        "rejected": sum(entry.rejected for entry in one.inputs),
        "refused": sum(entry.refused for entry in one.outputs),
        "youngest_input_ms": round(min(ages)[0] * 1e3, 1) if ages else None,
        "errors": one.errors,
        "facts": one.facts,
    }


_COLUMNS = {
    "NODE": "node",
    "CPU": "cpu",
    "MB": "memory_mb",
    "STEPS": "steps",
    "STEP ms": "step_ms",
    "MAX ms": "step_max_ms",
    "DROPPED": "dropped",
    "SKIPPED": "skipped",
    "REJECTED": "rejected",
    "REFUSED": "refused",
    "AGE ms": "youngest_input_ms",
    "ERRORS": "errors",
}


def _show(args: argparse.Namespace, graph: str, now: float, rows: list[dict[str, Any]]) -> None:
    if args.json:
        print(json.dumps({"graph": graph, "sim_seconds": now, "nodes": rows}), flush=True)
        return
    table = [list(_COLUMNS)]
    for row in rows:
        cells = [row.get(key) for key in _COLUMNS.values()]
        text = [
            "-" if cell is None else f"{cell:.0%}" if key == "cpu" else str(cell)
            for key, cell in zip(_COLUMNS.values(), cells, strict=True)
        ]
        table.append([text[0] + (" (silent)" if row["silent"] else ""), *text[1:]])
    widths = [max(len(row[column]) for row in table) for column in range(len(_COLUMNS))]
    lines = [f"{graph}: {now:.1f} s simulated"]
    for row in table:
        rest = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *rest]))
    clear = "\x1b[H\x1b[J" if sys.stdout.isatty() and not args.once else ""
    print(clear + "\n".join(lines), flush=True)
