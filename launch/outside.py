"""Messages from outside the graph, `footfall topic pub`: checked, numbered, handed to whoever listens."""

from collections.abc import Mapping
from time import monotonic_ns

from ..messages.codec import Codec, Header
from ..messages.config import ConfigError, near
from ..messages.graph import LAUNCHER, Graph
from ..messages.link import Deliver, Publish
from ..messages.topics import Topic
from .wiring import COMMON


class Outside:
    """The door for messages from outside.

    Args:
        graph: Who listens to what.
        topics: Topics by name, built-in and custom.
    """

    def __init__(self, graph: Graph, topics: Mapping[str, Topic]) -> None:
        self._topics = topics
        self._sent: dict[str, int] = {}
        self._listeners: dict[str, list[str]] = {}
        for node in graph.nodes:
            for topic in {wire.topic for wire in node.inputs.values()} - COMMON:
                if node.name != LAUNCHER:
                    self._listeners.setdefault(topic, []).append(node.name)

    def take(self, line: Publish, stamp_ns: int) -> tuple[list[str], Deliver]:
        """Who gets a message, and what each of them is sent.

        Raises:
            ConfigError: nobody listens to the topic, or it is one of the graph's own.
            MessageError: the message is not what the topic promises.
        """
        if line.topic in COMMON:
            raise ConfigError(f"{line.topic} is the graph's own; see `footfall control` and `footfall param`")
        if line.topic not in self._listeners:
            raise ConfigError(f"nobody listens to {line.topic!r}; {near(line.topic, self._listeners)}")
        codec = Codec(line.topic, self._topics[line.topic].type)
        codec.decode(line.body)
        number = self._sent[line.topic] = self._sent.get(line.topic, -1) + 1
        header = Header(number, stamp_ns, monotonic_ns(), codec.schema, 0)
        return self._listeners[line.topic], Deliver(line.topic, header.pack() + line.body)
