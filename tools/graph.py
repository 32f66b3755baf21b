"""`footfall graph`: a graph as arrows, of a launch file or of what runs now."""

import argparse
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..messages.graph import Edge, Graph


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `graph` to the command line."""
    parser = subparsers.add_parser(
        "graph",
        help="draw a graph",
        description="Draw who sends what to whom: of a launch file or scene, or of the graph that runs.",
    )
    parser.add_argument("name", nargs="?", help="launch file, scene or running graph (default: what runs)")
    parser.add_argument(
        "--all", action="store_true", help="also clock, control, diagnostics, log and the like"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--dot", action="store_true", help="print Graphviz")
    form.add_argument("--json", action="store_true", help="print the resolved graph")


def run(args: argparse.Namespace) -> int:
    """Print the graph."""
    import msgspec

    graph = _find(args.name)
    if args.json:
        print(json.dumps(msgspec.to_builtins(graph)))
        return 0
    print(dot(graph, args.all) if args.dot else diagram(graph, args.all))
    return 0


def _find(name: str | None) -> "Graph":
    from ..launch.find import find_launch
    from ..launch.launch_file import load_launch
    from ..launch.prepare import prepare
    from ..launch.running import find_graph
    from ..messages.config import ConfigError

    if name is None:
        return find_graph()
    try:
        target = find_launch(name)
    except ConfigError as error:
        try:
            return find_graph(name)
        except ConfigError:
            raise error from None
    return prepare(load_launch(target.path, target.args, name=target.name))[0]


def _wires(graph: "Graph", everything: bool) -> "list[Edge]":
    from ..launch.wiring import COMMON
    from ..messages.graph import LAUNCHER, edges

    wires = edges(graph)
    if everything:
        return wires
    return [w for w in wires if w.topic not in COMMON and LAUNCHER not in (w.publisher, w.subscriber)]


def diagram(graph: "Graph", everything: bool = False) -> str:
    """Publishers on the left, topics on the arrows, subscribers on the right.

    `=>` waits for its subscriber, `->` does not; in lockstep all arrows between those in step wait.
    """
    by_source: dict[str, dict[str, list[Edge]]] = {
        node.name: {topic: [] for topic in node.outputs.values()} for node in graph.nodes
    }
    wires = _wires(graph, everything)
    for wire in wires:
        by_source[wire.publisher][wire.topic].append(wire)
    shown = {name: {t: w for t, w in topics.items() if w} for name, topics in by_source.items()}
    name_width = max((len(name) for name in shown), default=0)
    topic_width = max((len(topic) for topics in shown.values() for topic in topics), default=0)
    rate = f" x{graph.clock.rate:g}" if graph.clock.rate else ""
    lines = [f"{graph.name}: {len(graph.nodes) - 1} nodes, {graph.clock.mode}{rate}, seed {graph.seed}", ""]
    for name, topics in shown.items():
        left = name
        for topic, found in topics.items():
            waits = any(wire.reliable for wire in found)
            shaft = "=" if waits else "-"
            to = ", ".join(_subscriber(wire) for wire in found)
            arrow = f"{shaft * 2}{topic:{shaft}<{topic_width}}{shaft}>"
            lines.append(f"{left:<{name_width}} {arrow} {to}")
            left = ""
    silent = [name for name, topics in shown.items() if not topics and name != "launcher"]
    heard = {wire.subscriber for wire in wires}
    lines += [f"{name} {'only listens' if name in heard else 'stands alone'}" for name in silent]
    return "\n".join(lines)


def _subscriber(wire: "Edge") -> str:
    port = "" if wire.port == wire.topic else f".{wire.port}"
    policy = "" if wire.input.policy == "latest" else f" ({wire.input.policy} {wire.input.depth})"
    return f"{wire.subscriber}{port}{policy}"


def dot(graph: "Graph", everything: bool = False) -> str:
    """The graph for Graphviz; bold arrows wait for their subscriber."""
    lines = [f'digraph "{graph.name}" {{', "  rankdir=LR; node [shape=box];"]
    for wire in _wires(graph, everything):
        style = ", style=bold" if wire.reliable else ""
        lines.append(f'  "{wire.publisher}" -> "{wire.subscriber}" [label="{wire.topic}"{style}];')
    return "\n".join([*lines, "}"])
