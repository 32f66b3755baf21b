"""A node is a pure step between messages: the base class, and what a step sees."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Generic, TypeVar

import msgspec

from ..messages.bus import Received
from ..messages.config import ConfigError, configure
from ..messages.topics import CONTROL, Outgoing, Topic

M = TypeVar("M", bound=msgspec.Struct)
C = TypeVar("C", bound=msgspec.Struct)


class NodeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every node's configuration: its defaults are the shipped behaviour."""


class Inbox:
    """What a step sees: the time, the newest message of each input, and what is new since the last step."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._latest: dict[str, Received[Any]] = {}
        self._new: dict[str, list[Received[Any]]] = {}

    @property
    def now(self) -> float:
        """Simulation time [s]."""
        return self.now_ns * 1e-9

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message of an input, or None before the first."""
        received = self._latest.get(topic.name)
        return received.message if received else None

    def require(self, topic: Topic[M]) -> M:
        """The newest message of an input the node lists in `requires`."""
        return self._latest[topic.name].message

    def stamp_ns(self, topic: Topic) -> int | None:
        """Stamp of the newest message of an input."""
        received = self._latest.get(topic.name)
        return received.stamp_ns if received else None

    def new(self, topic: Topic[M]) -> Sequence[M]:
        """Messages of an input that came since the last step, oldest first."""
        return [received.message for received in self._new.get(topic.name, ())]

    def received(self, topic: Topic[M]) -> Sequence[Received[M]]:
        """Like `new`, with stamps and publishers."""
        return self._new.get(topic.name, ())

    def deliver(self, messages: Iterable[Received[Any]]) -> None:
        """Put messages in, oldest first."""
        for message in messages:
            self._latest[message.port] = message
            self._new.setdefault(message.port, []).append(message)

    def consumed(self) -> dict[str, list[int]]:
        """Sequence numbers of what is new, by `topic@publisher`."""
        numbers: dict[str, list[int]] = {}
        for messages in self._new.values():
            for message in messages:
                numbers.setdefault(message.source, []).append(message.sequence)
        return numbers

    def next_step(self) -> None:
        """Nothing is new any more."""
        self._new = {}

    def forget(self) -> None:
        """Forget all but latched messages: time has jumped."""
        self._new = {}


class Node(ABC, Generic[C]):
    """A node: what goes in, what comes out, and a step without sockets, clocks or globals."""

    Config: ClassVar[type[NodeConfig]] = NodeConfig
    inputs: ClassVar[tuple[Topic, ...]] = ()
    outputs: ClassVar[tuple[Topic, ...]] = ()
    requires: ClassVar[tuple[Topic, ...]] = ()
    """Inputs without which no step can be taken."""
    trigger: ClassVar[Topic | None] = None
    """The input whose messages cause a step; None: any input does."""
    clock_rate_hz: int | None = None
    """Ticks per simulated second of a node that owns the clock; None for all others."""

    def __init__(self, config: C, seed: int = 0) -> None:
        self.config = config
        self.seed = seed
        self.finished: str | None = None
        """Set by a step to end the run: why."""
        self.facts: dict[str, float] = {}
        """Numbers for the diagnostics."""

    def start(self) -> Iterable[Outgoing]:
        """Messages sent once before the first tick."""
        return ()

    @abstractmethod
    def step(self, inbox: Inbox) -> Iterable[Outgoing]:
        """Take what has come, give what goes out."""

    def configure(self, config: C) -> None:
        """Take a configuration changed while running."""
        self.config = config

    def on_time_jump(self) -> None:
        """Time has jumped backwards: forget what was derived from the past."""

    def close(self) -> None:
        """Let go of files and processes."""


class Stepper:
    """Drives a node's steps from delivered messages: the same live, in replay and in tests."""

    def __init__(self, node: Node, name: str) -> None:
        self.node = node
        self.name = name
        self.inbox = Inbox()
        self.steps = 0
        self._triggered = False
        self.reconfigured = False
        """Whether parameters have changed since this was last cleared."""

    def deliver(self, messages: Sequence[Received[Any]], now_ns: int) -> None:
        """Put messages into the inbox at a time; control messages change the configuration.

        Raises:
            ConfigError: a control message names a parameter or value the node does not have.
        """
        if now_ns < self.inbox.now_ns:
            self.inbox.forget()
            self.node.on_time_jump()
        self.inbox.now_ns = now_ns
        self.inbox.deliver(messages)
        trigger = self.node.trigger
        if any(trigger is None or message.port == trigger.name for message in messages):
            self._triggered = True
        for message in messages:
            if message.port == CONTROL.name and message.message.node in ("*", self.name):
                self._control(message.message.name, message.message.value)

    def _control(self, name: str, value: Any) -> None:
        config = self.node.config
        if name not in config.__struct_fields__:
            return
        values = msgspec.to_builtins(config) | {name: value}
        self.node.configure(configure(type(config), values, f"{self.name}: control"))
        self.reconfigured = True

    @property
    def ready(self) -> bool:
        """Whether every input has come without which no step can be taken."""
        return all(self.inbox.latest(topic) is not None for topic in self.node.requires)

    @property
    def due(self) -> bool:
        """Whether a step is to be taken now."""
        return self._triggered and self.ready

    def step(self) -> list[Outgoing]:
        """Take one step."""
        outgoing = list(self.node.step(self.inbox))
        self.inbox.next_step()
        self._triggered = False
        self.steps += 1
        return outgoing


def build(node_type: type[Node], values: dict[str, Any], name: str, seed: int) -> Node:
    """A node from plain configuration values.

    Raises:
        ConfigError: the values do not fit its configuration.
    """
    return node_type(configure(node_type.Config, copy.deepcopy(values), f"{name}: config"), seed)


__all__ = ["ConfigError", "Inbox", "Node", "NodeConfig", "Stepper", "build"]
