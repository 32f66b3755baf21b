"""The bus within one process: tests, process replay, notebooks."""

from collections.abc import Callable, Mapping
from time import monotonic_ns

import msgspec

from .bus import Bound, BusError, Inlet
from .codec import Codec
from .graph import Graph, edges
from .topics import TOPICS, Topic


class MemoryHub:
    """What joins the memory buses of one graph."""

    def __init__(self, graph: Graph, topics: Mapping[str, Topic] = TOPICS) -> None:
        self.graph = graph
        self.topics = topics
        self._inlets: dict[str, list[Inlet]] = {}
        self._latched: dict[str, list[bytes | memoryview]] = {}
        self._by_subscriber: dict[str, list[Inlet]] = {}
        self.sequence: Bound = {}
        """Last sequence number by `topic@publisher`."""
        for edge in edges(graph):
            inlet = Inlet(edge, Codec(edge.topic, topics[edge.topic].type), edge.reliable, trusting=True)
            self._inlets.setdefault(inlet.source, []).append(inlet)
            self._by_subscriber.setdefault(edge.subscriber, []).append(inlet)

    def bus(self, node: str) -> "MemoryBus":
        """The bus of one node; latched messages sent before are there already."""
        inlets = self._by_subscriber.get(node, [])
        for inlet in inlets:
            if inlet.source in self._latched and not inlet.received:
                inlet.put(self._latched[inlet.source])
        return MemoryBus(self, node, inlets)

    def deliver(self, source: str, parts: list[bytes | memoryview], latched: bool) -> None:
        """Hand a message to everybody who subscribes it."""
        for inlet in self._inlets.get(source, []):
            inlet.put(parts)
        if latched:
            self._latched[source] = parts


class MemoryBus:
    """One node's end of a `MemoryHub`; messages pass through the codec as on the wire."""

    def __init__(self, hub: MemoryHub, node: str, inlets: list[Inlet]) -> None:
        self.inlets = inlets
        self._hub = hub
        self._node = node
        self._names = hub.graph.node(node).outputs
        self._codecs: dict[str, Codec] = {}

    def publish(self, topic: Topic, message: msgspec.Struct, stamp_ns: int) -> int:
        """See `Bus.publish`."""
        name = self._names.get(topic.name)
        if name is None:
            raise BusError(f"{self._node} has no output {topic.name!r} in this graph")
        codec = self._codecs.get(name)
        if codec is None:
            codec = self._codecs[name] = Codec(name, self._hub.topics[name].type)
        source = f"{name}@{self._node}"
        sequence = self._hub.sequence.get(source, -1) + 1
        head, arrays = codec.pack(message, sequence, stamp_ns, monotonic_ns())
        frames = [memoryview(array.tobytes()) for array in arrays]
        self._hub.deliver(source, [bytes(head), *frames], topic.latched)
        self._hub.sequence[source] = sequence
        return sequence

    def poll(self, timeout: float, ready: Callable[[], bool] | None = None) -> bool:
        """See `Bus.poll`; nothing can come while one waits in one process, so it does not wait."""
        return ready() if ready else any(inlet.pending for inlet in self.inlets)

    @property
    def sent(self) -> Bound:
        """See `Bus.sent`."""
        suffix = f"@{self._node}"
        return {source: last for source, last in self._hub.sequence.items() if source.endswith(suffix)}

    def close(self) -> None:
        """See `Bus.close`."""
