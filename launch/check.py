"""What must be right about a graph before any process is started."""

import importlib.util
import os
import socket
from collections.abc import Mapping
from pathlib import Path

from ..messages.bus import PortError
from ..messages.config import ConfigError, near
from ..messages.graph import LAUNCHER, Graph, NodeSpec, edges
from ..messages.topics import CLOCK, Topic
from .check_remotes import check_remotes, tcp_address
from .wiring import clock_owners


def check(graph: Graph, topics: Mapping[str, Topic]) -> None:
    """Refuse a graph that cannot work.

    Args:
        graph: The completed graph.
        topics: Topics by name, built-in and custom.

    Raises:
        ConfigError: one sentence that names the node and topic, and what would be right.
    """
    nodes = [node for node in graph.nodes if node.name != LAUNCHER]
    if not nodes:
        raise ConfigError(f"{graph.name}: has no nodes")
    for node in nodes:
        _check_module(graph, node)
        for port, wire in node.inputs.items():
            _check_port(graph, node, "input", port, wire.topic, topics)
        for port, topic in node.outputs.items():
            _check_port(graph, node, "output", port, topic, topics)
        follows = node.lockstep and graph.clock.mode == "lockstep"
        if follows and not node.required and node.restart.policy == "never":
            raise ConfigError(
                f"{graph.name}: node {node.name} is not required, but in lockstep the clock waits for it;"
                " say `lockstep: false` or give it a `restart` policy"
            )
        if CLOCK.name in node.outputs and node.restart.policy != "never":
            raise ConfigError(
                f"{graph.name}: node {node.name} owns the clock, and with it time would begin anew;"
                " it cannot have a `restart` policy"
            )
    check_remotes(graph, topics)
    _check_clock(graph)
    _check_publishers(graph, topics)
    _check_exposed(graph)


def _check_module(graph: Graph, node: NodeSpec) -> None:
    try:
        found = importlib.util.find_spec(node.module)
    except (ImportError, ValueError):
        found = None
    if found is None:
        shipped = Path(__file__).parent.parent / "nodes"
        known = [f"footfall.nodes.{path.stem}" for path in shipped.glob("[a-z]*.py")]
        raise ConfigError(
            f"{graph.name}: node {node.name}: no module {node.module!r}; {near(node.module, known)}"
            f" (modules of your own are looked for in {os.getcwd()})"
        )


def _check_port(
    graph: Graph, node: NodeSpec, kind: str, port: str, name: str, topics: Mapping[str, Topic]
) -> None:
    where = f"{graph.name}: node {node.name}: {kind} {port!r}"
    if port not in topics:
        raise ConfigError(f"{where}: a port is called as its topic in the node's code; {near(port, topics)}")
    if name not in topics:
        raise ConfigError(f"{where}: no topic {name!r}; {near(name, topics)}")
    ours, theirs = topics[port].type, topics[name].type
    if ours is not theirs:
        raise ConfigError(f"{where} holds {ours.__name__}, but topic {name!r} carries {theirs.__name__}")


def _check_clock(graph: Graph) -> None:
    owners = clock_owners(graph)
    elsewhere = graph.remote_publishers(CLOCK.name)
    if not owners and len(elsewhere) == 1:
        if graph.clock.mode == "lockstep":
            raise ConfigError(
                f"{graph.name}: the clock is that of {elsewhere[0]}, elsewhere, which waits for nobody here;"
                " say `clock: {mode: realtime}`"
            )
        return
    owners += elsewhere
    if len(owners) != 1:
        found = f"nodes {' and '.join(owners)} do" if owners else "none does"
        raise ConfigError(f"{graph.name}: exactly one node must own the clock (output `clock`); {found}")
    if (name := graph.node(owners[0]).outputs[CLOCK.name]) != CLOCK.name:
        raise ConfigError(f"{graph.name}: node {owners[0]}: the clock cannot be renamed to {name!r}")


def _check_publishers(graph: Graph, topics: Mapping[str, Topic]) -> None:
    for node in graph.nodes:
        for port, wire in node.inputs.items():
            if not graph.publishers(wire.topic) and not graph.remote_publishers(wire.topic):
                raise ConfigError(
                    f"{graph.name}: nobody publishes {wire.topic!r}, which node {node.name} takes as {port!r}"
                )
    for name in {name for node in graph.nodes for name in node.outputs.values()}:
        publishers = graph.publishers(name) + graph.remote_publishers(name)
        if len(publishers) > 1 and not topics[name].shared:
            raise ConfigError(
                f"{graph.name}: {name!r} may have one publisher;"
                f" nodes {' and '.join(publishers)} both publish it"
            )


def _check_exposed(graph: Graph) -> None:
    """Everything exposed is an output, has keys that work, and a port that is free."""
    from ..messages.secure import load_secret, require_keys

    exposed = [(node, port, address) for node in graph.nodes for port, address in node.expose.items()]
    for node, port, address in exposed:
        where = f"{graph.name}: node {node.name}: expose {port!r}"
        if port not in node.outputs:
            raise ConfigError(f"{where}: not an output of the node; {near(port, node.outputs)}")
        try:
            security = require_keys(where, address, graph.security)
            load_secret(security.secret_key_file)
        except PortError as error:
            raise ConfigError(str(error)) from None
        host, number = tcp_address(where, address)
        if not any(Path(security.authorized_keys_dir).glob("*.key")):
            raise ConfigError(f"{where}: no keys in {security.authorized_keys_dir}, so nobody could connect")
        _check_free(where, host, number)


def _check_free(where: str, host: str, port: int) -> None:
    host = "0.0.0.0" if host == "*" else host  # the test that nobody listens there yet
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise ConfigError(f"{where}: cannot listen on {host}:{port}: {error.strerror}") from None


def check_paths(graph: Graph) -> None:
    """Refuse a run directory so deep that its sockets' paths are too long.

    Raises:
        ConfigError: it is.
    """
    from ..messages.zmq_bus import endpoint

    try:
        for edge in edges(graph):
            endpoint(graph.run_dir, edge.topic, edge.publisher, edge.subscriber)
    except PortError as error:
        raise ConfigError(f"{graph.name}: {error}") from None
