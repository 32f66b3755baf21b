"""`footfall record`: record a graph that is running.

It listens as one more subscriber, so a slow disk does not slow the graph down; what it misses is counted.
To lose nothing, record from the start with `footfall launch --record`.
"""

import argparse
import json
import os
import signal
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..messages.graph import Graph

DEPTH = 100_000
"""Messages of one topic kept while the disk is busy."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `record` to the command line."""
    parser = subparsers.add_parser(
        "record",
        help="record a running graph",
        description="Record topics of a running graph until it ends or Ctrl-C.",
    )
    parser.add_argument("output", type=Path, help="log to write (.mcap)")
    parser.add_argument("--graph", metavar="NAME", help="which running graph (default: the only one)")
    parser.add_argument("--topics", metavar="TOPIC,...", help="only these (default: all that are recorded)")
    parser.add_argument("--exclude", metavar="TOPIC,...", default="", help="not these")
    parser.add_argument("--duration", type=float, metavar="S", help="stop after this simulated time [s]")
    parser.add_argument("--split-size", type=float, metavar="MB", help="begin a new file at this size")
    parser.add_argument("--split-duration", type=float, metavar="S", help="and after this simulated time")
    parser.add_argument("--quota", type=float, metavar="MB", help="stop when the log reaches this size")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing log")
    parser.add_argument("--strict", action="store_true", help="return 1 if anything was lost")
    parser.add_argument("--json", action="store_true", help="print the counts as one JSON object, last line")


def listening_graph(graph: "Graph", node: str, topics: list[str] | None, exclude: list[str]) -> "Graph":
    """The graph with a subscriber of recorded topics, for opening its sockets only.

    Raises:
        ConfigError: an unknown topic.
    """
    import msgspec

    from ..messages.config import ConfigError, near
    from ..messages.custom_topics import resolve_topics
    from ..messages.graph import Input, NodeSpec

    known = resolve_topics(graph)
    published = sorted({name for spec in graph.nodes for name in spec.outputs.values()})
    for name in [*(topics or ()), *exclude]:
        if name not in published:
            raise ConfigError(f"nobody publishes {name!r}; {near(name, published)}")
    wanted = [name for name in published if known[name].recorded] if topics is None else topics
    inputs = {name: Input(name, "queue", DEPTH) for name in wanted if name not in exclude}
    spec = NodeSpec(node, "", inputs, lockstep=False)
    return msgspec.structs.replace(graph, nodes=[*graph.nodes, spec])


def run(args: argparse.Namespace) -> int:
    """Record; returns 0, or 1 if recording had to stop, or with `--strict` if anything was lost."""
    from ..launch.running import find_graph
    from ..messages.custom_topics import resolve_topics
    from ..messages.zmq_bus import ZmqBus
    from ..nodes.recorder import Config, Recorder

    graph = find_graph(args.graph)
    topics, exclude = args.topics and _names(args.topics), _names(args.exclude)
    node = f"record-{os.getpid()}"
    known = resolve_topics(graph)
    config = Config(
        str(args.output),
        overwrite=args.overwrite,
        split_size=args.split_size,
        split_duration=args.split_duration,
        quota=args.quota,
    )
    listening = listening_graph(graph, node, topics, exclude)
    recorder = Recorder(config, graph, known)
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda n, _: stopped.append(n))
    bus = ZmqBus(listening, node, known)
    first_ns: int | None = None
    try:
        checked = monotonic()
        while not stopped and recorder.full is None:
            bus.poll(0.1)
            recorder.take(bus.inlets)
            recorder.tick()
            first_ns = first_ns if first_ns is not None else (recorder.now_ns or None)
            if args.duration and first_ns is not None and recorder.now_ns - first_ns >= args.duration * 1e9:
                break
            if monotonic() - checked > 1.0:
                checked = monotonic()
                if not _runs(graph):
                    break
    finally:
        recorder.take(bus.inlets)
        recorder.close()
        bus.close()
    tallies = recorder.tallies(bus.inlets)
    lost = sum(tally.lost for tally in tallies.values())
    if args.json:
        facts = {
            source: {"received": t.received, "written": t.written, "lost": t.lost}
            for source, t in tallies.items()
        }
        files = [str(path) for path in recorder.paths]
        print(json.dumps({"topics": facts, "lost": lost, "bytes": recorder.size, "files": files}))
    else:
        print("\n".join(recorder.summary(bus.inlets)))
    if recorder.full is not None:
        print(recorder.full)
    return int(recorder.full is not None or (args.strict and lost > 0))


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def _runs(graph: "Graph") -> bool:
    from ..launch.run_dir import RunDir

    return RunDir(Path(graph.run_dir)).alive
