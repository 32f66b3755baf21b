"""Listening to graphs elsewhere: over TCP, encrypted, each side known to the other by its key."""

from collections.abc import Mapping

from .bus import PortError
from .graph import Graph, remote_edges
from .secure import ClientKeys
from .topics import Topic
from .zmq_bus import ZmqBus


def connect_remotes(bus: ZmqBus, graph: Graph, node: str, topics: Mapping[str, Topic]) -> None:
    """Subscribe what a node of this graph hears from graphs elsewhere.

    Who is there is not waited for: messages come from the moment the other side is up and lets us in, and
    come again when it is restarted.

    Raises:
        PortError: an address or a key cannot be used.
    """
    for edge in remote_edges(graph):
        if edge.subscriber != node:
            continue
        remote = graph.remotes[edge.publisher]
        if graph.security is None:
            raise PortError(f"{node}: hearing {edge.topic} of {edge.publisher} needs keys: set `security`")
        keys = ClientKeys(graph.security.secret_key_file, remote.server_key_file)
        bus.connect(edge, topics[edge.topic], remote.topics[edge.topic], keys)
