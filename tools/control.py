"""`footfall control`: rule the clock of a running graph, or end it."""

import argparse
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..messages.graph import Graph
    from ..messages.link import Request, Steer

VERBS = {
    "pause": "stop the clock",
    "resume": "let the clock run on",
    "step": "take so many ticks while paused (default 1)",
    "rate": "simulated per wall time; 0 is as fast as it goes",
    "seek": "go to a simulated second of the log that is played",
    "stop": "end the graph",
}
TIMEOUT = 3.0
"""Longest wait for the launcher's answer [s]."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `control` to the command line."""
    parser = subparsers.add_parser(
        "control",
        help="pause, resume, step, rate, seek, stop",
        description="Rule the clock of a running graph.",
    )
    verbs = parser.add_subparsers(required=True, dest="verb", metavar="VERB")
    for verb, text in VERBS.items():
        ruling = verbs.add_parser(verb, help=text)
        if verb == "step":
            ruling.add_argument("value", type=int, nargs="?", default=1)
        elif verb in ("rate", "seek"):
            ruling.add_argument("value", type=float)
        ruling.add_argument("--graph", metavar="NAME", help="which running graph (default: the only one)")


def run(args: argparse.Namespace) -> int:
    """Ask the launcher; an error says why it refuses."""
    from ..launch.running import find_graph
    from ..messages.config import ConfigError
    from ..messages.link import Request

    verb, value = args.verb, getattr(args, "value", None)
    if verb in ("rate", "seek") and value is not None and not 0.0 <= value < float("inf"):
        raise ConfigError(f"control {verb}: is {value:g}, must be a number from 0 on")
    ask(find_graph(args.graph), Request("stop") if verb == "stop" else Request("control", "*", verb, value))
    return 0


def ask(graph: "Graph", request: "Request | Steer") -> None:
    """Send a request to the launcher of a graph.

    Raises:
        ConfigError: it refuses, or does not answer.
    """
    from ..messages.config import ConfigError
    from ..messages.link import Link, Reply

    link = Link(graph.run_dir, f"client-{os.getpid()}")
    try:
        link.send(request)
        reply = link.receive(TIMEOUT)
    finally:
        link.close()
    if not isinstance(reply, Reply):
        raise ConfigError(f"the launcher of {graph.name} does not answer")
    if reply.error:
        raise ConfigError(reply.error)
