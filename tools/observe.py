"""Looking at topics from outside: of a running graph, of an address on the network, of a log."""

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from ..launch.running import find_graph
from ..messages.bus import Inlet, Received, take
from ..messages.config import ConfigError, near
from ..messages.custom_topics import resolve_topics
from ..messages.graph import ClockSpec, Edge, Graph, Input, NodeSpec
from ..messages.link import load_graph
from ..messages.remote import connect_remotes
from ..messages.secure import ClientKeys
from ..messages.topics import TOPICS, Topic
from ..messages.zmq_bus import ZmqBus


def add_source_arguments(parser: argparse.ArgumentParser, *, log: bool, remote: bool) -> None:
    """The options that say where to look."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--graph", metavar="NAME", help="which running graph, if there are several")
    group.add_argument("--run-dir", metavar="DIR", help="run directory of the graph")
    if log:
        group.add_argument("--log", metavar="FILE", help="look at a log instead of a running graph")
    if remote:
        group.add_argument("--connect", metavar="ADDRESS", help="listen to tcp://host:port from elsewhere")
        parser.add_argument("--keys", metavar="FILE", help="own secret certificate (with --connect)")
        parser.add_argument("--server-key", metavar="FILE", help="the graph's public certificate")


def graph_of(args: argparse.Namespace) -> Graph:
    """The graph the options name.

    Raises:
        ConfigError: there is none, or it is not clear which.
    """
    if args.run_dir:
        path = Path(args.run_dir) / "graph.json"
        if not path.is_file():
            raise ConfigError(f"{args.run_dir}: holds no graph.json; give the run directory of a graph")
        return load_graph(str(path))
    return find_graph(args.graph)


def known_topic(name: str, topics: Mapping[str, Topic], among: Iterable[str] | None = None) -> Topic:
    """The topic of that name.

    Raises:
        ConfigError: there is none; names the closest.
    """
    names = sorted(topics if among is None else among)
    if name not in names:
        raise ConfigError(f"no topic {name!r}; {near(name, names)}")
    return topics[name]


def published(graph: Graph) -> list[str]:
    """Names of the topics somebody publishes, sorted."""
    local = {topic for node in graph.nodes for topic in node.outputs.values()}
    return sorted(local.union(*(remote.topics for remote in graph.remotes.values())))


def observer(graph: Graph, names: Iterable[str], depth: int = 1000) -> ZmqBus:
    """A bus that sees every message of some topics and disturbs nobody: nobody waits for it."""
    inputs = {name: Input(name, "queue", depth) for name in names}
    me = NodeSpec(f"observer-{os.getpid()}", __name__, inputs, lockstep=False)
    seen = msgspec.structs.replace(graph, nodes=[*graph.nodes, me])
    topics = resolve_topics(graph)
    bus = ZmqBus(seen, me.name, topics)
    connect_remotes(bus, seen, me.name, topics)
    return bus


def remote(args: argparse.Namespace, topic: Topic) -> ZmqBus:
    """A bus that listens to an exposed topic.

    Raises:
        ConfigError: keys are missing.
        PortError: they cannot be used.
    """
    if not args.keys or not args.server_key:
        raise ConfigError("--connect needs --keys FILE and --server-key FILE; `footfall keys new` makes them")
    me = NodeSpec(f"observer-{os.getpid()}", __name__)
    bus = ZmqBus(Graph("remote", [me], clock=ClockSpec("free")), me.name)
    edge = Edge(topic.name, args.connect, me.name, topic.name, Input(topic.name, "queue", 1000), False, False)
    try:
        bus.connect(edge, topic, args.connect, ClientKeys(args.keys, args.server_key))
    except BaseException:
        bus.close()
        raise
    return bus


def open_source(args: argparse.Namespace, name: str) -> ZmqBus:
    """A bus that sees a topic, live or from elsewhere, as the options say."""
    if getattr(args, "connect", None):
        return remote(args, known_topic(name, TOPICS))
    graph = graph_of(args)
    known_topic(name, resolve_topics(graph), published(graph))
    return observer(graph, [name])


def stream(bus: ZmqBus, timeout: float | None) -> Iterator[Received[Any]]:
    """Messages as they come, until none comes for `timeout` [s]."""
    while wait(bus, timeout):
        yield from take(bus)
        complain(bus.inlets)


def wait(bus: ZmqBus, timeout: float | None) -> bool:
    """Wait for messages; says whether any came."""
    deadline = None if timeout is None else monotonic() + timeout
    while not bus.poll(0.1):
        complain(bus.inlets)
        if deadline is not None and monotonic() > deadline:
            return False
    return True


def complain(inlets: Iterable[Inlet]) -> None:
    """Say on the error channel what was not as promised."""
    for inlet in inlets:
        while inlet.faults:
            print(f"rejected {inlet.faults.pop(0)}", file=sys.stderr)
