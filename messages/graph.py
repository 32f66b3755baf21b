"""The resolved graph: which node publishes and subscribes what, and how each is run."""

import math
from typing import Any, Literal

import msgspec

from .clock import Mode

LAUNCHER = "launcher"
"""The launcher's own name among the publishers: it sends `control` and `graph`."""
OUTSIDE = "outside"
"""The publisher of messages that come by way of the launcher: `footfall topic pub`."""

WATCHDOG = 10.0
"""Longest time without a sign of life where the launch file does not say [s]."""


class Restart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What to do when a node's process ends by itself."""

    policy: Literal["never", "on-failure", "always"] = "never"
    max: int = 3
    """Restarts allowed within the window."""
    window: float = 60.0
    """[s]"""
    backoff: float = 0.2
    """Wait before the first restart [s]; doubles with each one in the window."""


class Input(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How one port of a node is fed."""

    topic: str
    policy: Literal["latest", "queue", "reliable"] = "latest"
    depth: int = 1
    """Messages kept for the node: 1 for `latest`, N for `queue: N`; for `reliable` the bound at which
    the publisher has to wait."""
    timeout: float = 5.0
    """Longest wait of a publisher for a `reliable` subscriber [s]."""


class NodeSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One process of the graph."""

    name: str
    module: str
    inputs: dict[str, Input] = {}
    """By port: the name of a topic in the node's code."""
    outputs: dict[str, str] = {}
    """Topic by port."""
    config: dict[str, Any] = {}
    required: bool = True
    """The graph stops when this node ends in failure."""
    restart: Restart = Restart()
    threads: int = 1
    """Threads its numerical libraries may use."""
    env: dict[str, str] = {}
    lockstep: bool = True
    """Takes part in lockstep: the clock waits for it every tick."""
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL"] = "INFO"
    expose: dict[str, str] = {}
    """TCP address by output port for subscribers elsewhere, `plans: tcp://0.0.0.0:7000`; needs keys."""
    watchdog: float | None = None
    """Longest time without a sign of life, after which the process is ended [s]; 0 is never, None is
    `patience`'s own choice."""


class ClockSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How simulation time passes."""

    mode: Mode = "lockstep"
    rate: float | None = None
    """Simulated per wall second; None is 1 in `realtime`, and as fast as it goes in `lockstep`."""
    timeout: float = 30.0
    """Lockstep: longest wait for a node's work on one tick [s]."""


class Security(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Keys of everything exposed over TCP."""

    secret_key_file: str
    """CURVE certificate of this graph, readable by its owner only."""
    authorized_keys_dir: str = ""
    """Public certificates of the clients that may connect; anybody else is refused. Needed where something
    is exposed."""


class Remote(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A graph elsewhere, whose exposed topics are heard here."""

    topics: dict[str, str]
    """TCP address by topic, `agents: tcp://192.168.1.7:7000`."""
    server_key_file: str
    """The public certificate of that graph."""


class Graph(msgspec.Struct, frozen=True):
    """The whole graph as started; stands as `graph.json` in the run directory."""

    name: str
    nodes: list[NodeSpec]
    run_dir: str = ""
    clock: ClockSpec = ClockSpec()
    seed: int = 0
    duration: float | None = None
    """Simulated time after which the graph ends [s]."""
    custom_topics: dict[str, str] = {}
    """Topics beyond the built-in ones: name -> `package.module:Topic object`."""
    security: Security | None = None
    versions: dict[str, str] = {}
    """Releases of the packages it runs with."""
    remotes: dict[str, Remote] = {}
    """Graphs elsewhere by the name under which they publish here."""

    def node(self, name: str) -> NodeSpec:
        """The node of that name.

        Raises:
            KeyError: there is none.
        """
        for node in self.nodes:
            if node.name == name:
                return node
        raise KeyError(f"no node {name!r} in the graph; it has {', '.join(n.name for n in self.nodes)}")

    def publishers(self, topic: str) -> list[str]:
        """Names of the nodes that publish a topic, in launch order."""
        return [node.name for node in self.nodes if topic in node.outputs.values()]

    def remote_publishers(self, topic: str) -> list[str]:
        """Names of the graphs elsewhere from which a topic comes."""
        return [name for name, remote in self.remotes.items() if topic in remote.topics]


class Edge(msgspec.Struct, frozen=True):
    """One wire: a topic from one publisher to one port of one subscriber."""

    topic: str
    publisher: str
    subscriber: str
    port: str
    input: Input
    reliable: bool
    """Has a socket of its own on which the publisher waits instead of dropping."""
    in_step: bool
    """Joins two participants of lockstep: what crosses it in one tick is seen in the next."""


def patience(graph: Graph, node: NodeSpec) -> float:
    """How long a node may give no sign of life before it counts as hanging [s]; infinite without a watchdog.

    By default ten seconds, but longer than its reliable subscribers may keep it waiting; in lockstep a little
    less than the clock waits for it, so that it is the node that is named and not the clock.
    """
    if node.watchdog is not None:
        return node.watchdog or math.inf
    if node.lockstep and graph.clock.mode == "lockstep":
        return 0.9 * graph.clock.timeout
    waits = [edge.input.timeout for edge in edges(graph) if edge.reliable and edge.publisher == node.name]
    return max([WATCHDOG, *(2 * wait for wait in waits)])


def edges(graph: Graph) -> list[Edge]:
    """All wires of the graph; in lockstep those between its participants are all reliable."""
    in_step = {node.name for node in graph.nodes if node.lockstep and graph.clock.mode == "lockstep"}
    return [
        Edge(
            topic=wire.topic,
            publisher=publisher,
            subscriber=node.name,
            port=port,
            input=wire,
            reliable=wire.policy == "reliable" or {publisher, node.name} <= in_step,
            in_step={publisher, node.name} <= in_step,
        )
        for node in graph.nodes
        for port, wire in node.inputs.items()
        for publisher in graph.publishers(wire.topic)
    ]


def remote_edges(graph: Graph) -> list[Edge]:
    """All wires from graphs elsewhere; nobody there waits for a subscriber here."""
    return [
        Edge(wire.topic, remote, node.name, port, wire, reliable=False, in_step=False)
        for node in graph.nodes
        for port, wire in node.inputs.items()
        for remote in graph.remote_publishers(wire.topic)
    ]
