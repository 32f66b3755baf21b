"""`footfall param`: see and change the parameters of running nodes."""

import argparse
import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..messages.graph import Graph

TIMEOUT = 3.0
"""Longest wait for the nodes' parameters [s]."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `param` to the command line."""
    parser = subparsers.add_parser(
        "param",
        help="see and change parameters of running nodes: list, set",
        description="Look at the parameters of running nodes and change them.",
    )
    verbs = parser.add_subparsers(required=True, dest="verb", metavar="VERB")
    listing = verbs.add_parser("list", help="parameters of all nodes, or of one")
    listing.add_argument("node", nargs="?")
    listing.add_argument("--json", action="store_true", help="print one JSON object")
    setting = verbs.add_parser("set", help="change one; `log_level` is one of every node")
    setting.add_argument("node", help="a node, or * for all")
    setting.add_argument("key")
    setting.add_argument("value", help="as YAML")
    for verb in verbs.choices.values():
        verb.add_argument("--graph", metavar="NAME", help="which running graph (default: the only one)")


def run(args: argparse.Namespace) -> int:
    """Do it; returns 0, or 2 when the launcher refuses."""
    from ..launch.running import find_graph
    from ..messages.link import Request
    from .control import ask

    graph = find_graph(args.graph)
    if args.verb == "list":
        return _list(graph, args.node, args.json)
    ask(graph, Request("control", args.node, args.key, _value(graph, args)))
    return 0


def _value(graph: "Graph", args: argparse.Namespace) -> Any:
    """The value to set, if the node has such a parameter."""
    import yaml

    from ..messages.config import ConfigError, near

    value = yaml.safe_load(args.value)
    if isinstance(value, (list, dict)):
        raise ConfigError(
            f"param set {args.node} {args.key}: only numbers, texts and booleans can be set live"
        )
    known = parameters(graph)
    if args.node in known and args.key not in (names := {*known[args.node], "log_level"}):
        raise ConfigError(f"node {args.node} has no parameter {args.key!r}; {near(args.key, names)}")
    return value


def _list(graph: "Graph", node: str | None, as_json: bool) -> int:
    from ..messages.config import ConfigError, near

    found = parameters(graph)
    if node is not None:
        if node not in found:
            raise ConfigError(f"no parameters of a node {node!r}; {near(node, found)}")
        found = {node: found[node]}
    if as_json:
        print(json.dumps(found))
        return 0
    for name, values in found.items():
        for key, value in values.items():
            print(f"{name}.{key} = {json.dumps(value)}")
    return 0


def parameters(graph: "Graph") -> dict[str, dict[str, Any]]:
    """What every node runs with, from the latched topic `parameters`."""
    from time import monotonic

    from ..messages.bus import take
    from ..messages.topics import PARAMETERS
    from .observe import observer

    bus = observer(graph, [PARAMETERS.name])
    found: dict[str, dict[str, Any]] = {}
    deadline = monotonic() + TIMEOUT
    publishers = graph.publishers(PARAMETERS.name)
    try:
        while set(found) < set(publishers) and bus.poll(max(0.0, min(0.5, deadline - monotonic()))):
            for received in take(bus):
                found[received.message.node] = json.loads(received.message.values)
    finally:
        bus.close()
    return {node: found[node] for node in publishers if node in found}
