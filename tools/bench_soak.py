"""`footfall bench soak`: memory of every process of a graph over half an hour, and what was lost on the way."""

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import psutil

from ..messages.bus import take
from ..messages.diagnostics import Diagnostics
from ..messages.graph import LAUNCHER, Graph, edges
from ..messages.topics import CLOCK, DIAGNOSTICS
from .launched import Launched, set_words
from .results import table, write_section

WARM_UP = 1 / 3
"""Share of the run in which caches fill; the slope is of what follows."""
FLAT = 10.0
"""Slope up to which memory counts as flat [MB/h]."""
_MB = 2**20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bench."""
    parser.add_argument(
        "name", nargs="?", default="crossing", help="launch file or scene (default: crossing)"
    )
    parser.add_argument("--minutes", type=float, default=30.0, help="wall time (default: 30)")
    parser.add_argument("--mode", choices=("realtime", "free", "lockstep"), default="realtime")
    parser.add_argument("--every", type=float, default=10.0, metavar="S", help="between two looks")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as of `launch`")
    parser.add_argument("--record", type=Path, metavar="FILE", help="record as well")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the memory of every process")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")


@dataclass
class Soak:
    """What was seen."""

    graph: Graph
    memory: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Resident memory by process: time since the first look [s], [MB]."""
    reports: dict[str, Diagnostics] = field(default_factory=dict)
    """Last report of each node."""
    sim_seconds: float = 0.0

    def lost(self) -> dict[str, int]:
        """Messages lost on inputs that may lose none, by `topic@publisher > subscriber`; none are left out."""
        promised = {(e.topic, e.publisher, e.subscriber) for e in edges(self.graph) if e.reliable}
        lost = {
            f"{wire.topic}@{wire.publisher} > {node}": wire.dropped + wire.rejected
            for node, report in self.reports.items()
            for wire in report.inputs
            if (wire.topic, wire.publisher, node) in promised
        }
        lost |= {
            f"{output.topic}@{node}, refused": output.refused
            for node, report in self.reports.items()
            for output in report.outputs
        }
        return {name: count for name, count in lost.items() if count}

    def reliable_messages(self) -> int:
        """Messages received on inputs that may lose none."""
        promised = {(e.topic, e.publisher, e.subscriber) for e in edges(self.graph) if e.reliable}
        return sum(
            wire.received
            for node, report in self.reports.items()
            for wire in report.inputs
            if (wire.topic, wire.publisher, node) in promised
        )


def run(args: argparse.Namespace) -> int:
    """Watch a graph; 1 if memory grows, a process fails or something is lost."""
    settings = set_words(args.set)
    recording = ["--record", str(args.record)] if args.record else []
    arguments = [*settings, *recording]
    with Launched(args.name, args.mode, topics=[DIAGNOSTICS.name], arguments=arguments) as launched:
        soak = watch(launched, args.minutes * 60, args.every)
        launched.process.send_signal(signal.SIGINT)
        summary = launched.summary()
    facts = judge(soak, summary)
    if args.plot:
        plot(soak, args.plot)
    words = " ".join(
        ["footfall bench soak", args.name, f"--minutes {args.minutes:g} --mode {args.mode}", *settings]
    )
    text = markdown(facts, words)
    print(json.dumps(facts) if args.json else text)
    if args.write:
        write_section(args.write, "soak", text)
    return 0 if facts["passed"] else 1


def watch(launched: Launched, seconds: float, every: float) -> Soak:
    """Look at all processes every so often [s], until the time is over or the graph ends."""
    soak = Soak(launched.graph)
    begin = monotonic()
    next_look = begin
    while launched.process.poll() is None and monotonic() - begin < seconds:
        launched.bus.poll(0.5, lambda: False)
        for received in take(launched.bus):
            if received.topic == DIAGNOSTICS.name:
                soak.reports[received.message.node] = received.message
            elif received.topic == CLOCK.name:
                soak.sim_seconds = received.stamp_ns * 1e-9
        if monotonic() >= next_look:
            next_look += every
            for process in launched.survivors():
                with suppress(psutil.Error):
                    rows = soak.memory.setdefault(role(process.cmdline()), [])
                    rows.append((monotonic() - begin, process.memory_info().rss / _MB))
            _progress(soak, seconds)
    return soak


def role(words: Sequence[str]) -> str:
    """What a process of a run is, by its command line."""
    if "--node" in words:
        return words[words.index("--node") + 1]
    return "watchdog" if any(word.endswith("watchdog.py") for word in words) else LAUNCHER


def _progress(soak: Soak, seconds: float) -> None:
    if sys.stderr.isatty():
        now = max(rows[-1][0] for rows in soak.memory.values())
        total = sum(rows[-1][1] for rows in soak.memory.values())
        print(f"\r{now:.0f} of {seconds:.0f} s, {total:.0f} MB ", end="", file=sys.stderr, flush=True)


def slope(rows: Sequence[tuple[float, float]]) -> float:
    """Growth after the warm-up [MB/h]: the median of the slopes between all pairs (Theil and Sen).

    Args:
        rows: Times [s] and memory [MB].
    """
    times, memory = np.array(rows).T
    late = times >= times[0] + WARM_UP * (times[-1] - times[0])
    i, j = np.triu_indices(int(late.sum()), 1)
    if not len(i):
        return 0.0
    x, y = times[late], memory[late]
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])) * 3600)


def judge(soak: Soak, summary: dict[str, Any]) -> dict[str, Any]:
    """The figures: memory by process, losses, and whether all is well."""
    processes = {}
    for name, rows in soak.memory.items():
        memory = [value for _, value in rows]
        processes[name] = {
            "first_mb": round(memory[0], 1),
            "warm_mb": round(memory[int(WARM_UP * len(memory))], 1),
            "last_mb": round(memory[-1], 1),
            "peak_mb": round(max(memory), 1),
            "slope_mb_per_hour": round(slope(rows), 2),
        }
    grows = [name for name, facts in processes.items() if facts["slope_mb_per_hour"] > FLAT]
    lost, failure = soak.lost(), summary.get("first_failure")
    return {
        "sim_seconds": round(soak.sim_seconds, 1),
        "real_time_factor": round(summary.get("real_time_factor") or 0.0, 3),
        "processes": processes,
        "grows": grows,
        "reliable_messages": soak.reliable_messages(),
        "lost_on_reliable_inputs": lost,
        "dropped": summary.get("dropped"),
        "restarts": summary.get("restarts"),
        "first_failure": failure,
        "passed": not grows and not lost and failure is None,
    }


def markdown(facts: dict[str, Any], words: str) -> str:
    """The figures as a titled table."""
    head = ("process", "at first [MB]", "warm [MB]", "at last [MB]", "peak [MB]", "slope [MB/h]")
    rows = [(name, *(f"{value:.1f}" for value in row.values())) for name, row in facts["processes"].items()]
    lost = facts["lost_on_reliable_inputs"]
    lines = [
        f"### Half an hour of one graph (`{words}`)" if facts["sim_seconds"] > 1700 else f"### `{words}`",
        "",
        f"{facts['sim_seconds']:.0f} s simulated; {facts['reliable_messages']} messages on inputs that may lose"
        f" none, {sum(lost.values()) or 'none'} of them lost{': ' if lost else ''}"
        f"{', '.join(f'{name} {count}' for name, count in lost.items())}."
        f" The slope is of the last two thirds.",
        "",
        table(head, rows),
    ]
    return "\n".join(lines)


def plot(soak: Soak, path: Path) -> None:
    """Draw the memory of every process over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, rows in sorted(soak.memory.items(), key=lambda item: -item[1][-1][1]):
        times, memory = np.array(rows).T
        axes.plot(times / 60, memory, label=f"{name} ({slope(rows):+.1f} MB/h)")
    axes.set(
        xlabel="wall time [min]",
        ylabel="resident memory [MB]",
        title=f"{soak.graph.name}, {soak.graph.clock.mode}",
    )
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
