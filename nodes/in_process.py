"""A whole graph in one process, in lockstep: tests, notebooks, quick experiments.

Sends exactly the messages the same graph sends as processes in lockstep mode.
"""

from collections.abc import Callable
from typing import Any

from ..messages.bus import Bound, Received, take
from ..messages.clock import Clock
from ..messages.graph import Graph
from ..messages.memory_bus import MemoryBus, MemoryHub
from ..messages.topics import CLOCK, Outgoing
from .node import Node, Stepper

Listener = Callable[[str, Outgoing, int], None]
"""Called with node name, message and stamp [ns] for everything that is sent."""


class InProcess:
    """Runs nodes of a graph; the one with a `clock_rate_hz` owns time.

    Args:
        graph: Who publishes and subscribes what; nodes without an object in `nodes` are left out.
        nodes: The node objects by name.
        listener: Sees every message.
    """

    def __init__(self, graph: Graph, nodes: dict[str, Node], listener: Listener | None = None) -> None:
        hub = MemoryHub(graph)
        self._listener = listener
        self._buses: dict[str, MemoryBus] = {name: hub.bus(name) for name in nodes}
        self._steppers = {name: Stepper(node, name) for name, node in nodes.items()}
        self._owner = next(name for name, node in nodes.items() if node.clock_rate_hz is not None)
        self._sent: Bound = {}
        self.now_ns = 0
        self._tick = 0
        for name, node in nodes.items():
            self._publish(name, list(node.start()))
        self._sent = self._all_sent()
        for name in nodes:
            self._deliver(name, self._sent, [])

    def run(self, seconds: float) -> None:
        """Let simulated time pass; returns early when the owner of time has finished."""
        owner = self._steppers[self._owner]
        rate = owner.node.clock_rate_hz
        assert rate is not None
        end_ns = self.now_ns + round(seconds * 1e9)
        while self._tick * 1_000_000_000 // rate <= end_ns and owner.node.finished is None:
            self.now_ns = self._tick * 1_000_000_000 // rate
            self._deliver(self._owner, self._sent, [])
            self._publish(self._owner, owner.step())
            bound = self._sent | self._buses[self._owner].sent
            clock = Clock(self._tick, 1_000_000_000 // rate, "lockstep", sent=bound)
            self._publish(self._owner, [CLOCK(clock)])
            for name, stepper in self._steppers.items():
                if name != self._owner:
                    self._deliver(name, bound, [CLOCK.name])
                    if stepper.due:
                        self._publish(name, stepper.step())
            self._sent = self._all_sent()
            self._tick += 1

    def _deliver(self, name: str, bound: Bound, unbound: list[str]) -> None:
        bus = self._buses[name]
        messages: list[Received[Any]] = []
        for inlet in bus.inlets:
            if inlet.edge.port in unbound:
                messages += inlet.take(None)
        self._steppers[name].deliver(messages + take(bus, bound), self.now_ns)

    def _publish(self, name: str, outgoing: list[Outgoing]) -> None:
        for item in outgoing:
            self._buses[name].publish(item.topic, item.message, self.now_ns)
            if self._listener:
                self._listener(name, item, self.now_ns)

    def _all_sent(self) -> Bound:
        return {source: n for bus in self._buses.values() for source, n in bus.sent.items()}
