"""Process replay: one node, in this process, on the inputs each of its recorded steps had."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any

from ..messages.bus import LIFE_BITS, Received
from ..messages.compare import Difference, Tolerance, first_difference
from ..messages.config import ConfigError, near
from ..messages.custom_topics import resolve_topics
from ..messages.diagnostics import StepTrace
from ..messages.graph import NodeSpec
from ..messages.log import LogError, Logged, LogReader, LogWriter
from ..messages.topics import CLOCK, STEPS, Outgoing, Topic
from ..nodes.node import Node, Stepper, build

_BOOKKEEPING = ("diagnostics", "log", "parameters", "steps", "done", CLOCK.name)
"""Topics the process around a node publishes, not the node."""


@dataclass
class Step:
    """What one step of the node gave, beside what it had given when recorded."""

    number: int
    """From 0; -1 for what the node sends at its start."""
    stamp_ns: int
    recorded: dict[str, list[Logged[Any]]]
    given: dict[str, list[Any]]
    """New messages by topic."""


@dataclass
class Result:
    """What process replay has found."""

    node: str
    steps: int = 0
    counts: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    """Messages recorded and now, by topic."""
    first: tuple[str, int, float, Difference] | None = None
    """Topic, number of the message on it, time [s], and where it differs."""
    replayed: list[Step] = field(default_factory=list)
    wall_seconds: float = 0.0

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.first is None and all(a == b for a, b in self.counts.values())


def node_type_of(spec: NodeSpec) -> type[Node]:
    """The node class of a module: `NODE`, or the only `Node` it defines.

    Raises:
        ConfigError: the module cannot be imported or does not have exactly one.
    """
    try:
        module = import_module(spec.module)
    except (ImportError, SyntaxError) as error:
        raise ConfigError(f"{spec.name}: cannot import {spec.module}: {error}") from None
    if isinstance(found := getattr(module, "NODE", None), type) and issubclass(found, Node):
        return found
    own = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Node) and value.__module__ == module.__name__
    ]
    if len(own) != 1:
        raise ConfigError(
            f"{spec.name}: {spec.module} defines {len(own)} nodes, must be one (or name it `NODE`); "
            "it cannot be replayed step by step"
        )
    return own[0]


def regress(reader: LogReader, name: str, tolerance: Tolerance | None = None) -> Result:
    """Replay a node on its recorded inputs.

    Args:
        reader: The log, with the graph attached and the node's `steps` recorded.
        name: The node.
        tolerance: What counts as the same.

    Raises:
        LogError: the log lacks the graph, the steps or an input.
        ConfigError: no such node, or its class cannot be found.
    """
    begin = perf_counter()
    result = Result(name)
    for step in replay(reader, name):
        result.replayed.append(step)
        for topic in sorted({*step.recorded, *step.given}):
            recorded, given = step.recorded.get(topic, []), step.given.get(topic, [])
            for number, (ours, theirs) in enumerate(zip(recorded, given, strict=False)):
                if result.first is None and (found := first_difference(ours.message, theirs, tolerance)):
                    position = result.counts[topic][0] + number
                    result.first = (topic, position, step.stamp_ns * 1e-9, found)
            if result.first is None and len(recorded) != len(given):
                found = Difference("number of messages of the step", None, len(recorded), len(given))
                position = result.counts[topic][0] + min(len(recorded), len(given))
                result.first = (topic, position, step.stamp_ns * 1e-9, found)
            result.counts[topic][0] += len(recorded)
            result.counts[topic][1] += len(given)
    result.steps = sum(step.number >= 0 for step in result.replayed)
    result.wall_seconds = perf_counter() - begin
    return result


def replay(reader: LogReader, name: str) -> Iterator[Step]:
    """The start messages and then each step of a node, recorded and anew.

    Raises:
        LogError: see `regress`.
        ConfigError: see `regress`.
    """
    graph = reader.graph
    if graph is None:
        raise LogError(f"{reader.path}: no graph is attached, so the node's configuration is not known")
    names = [node.name for node in graph.nodes]
    if name not in names:
        raise ConfigError(f"{reader.path}: no node {name!r}; {near(name, names)}")
    spec = graph.node(name)
    node_type = node_type_of(spec)
    reader = LogReader(reader.path, resolve_topics(graph))
    traces, inputs, outputs = _read(reader, spec)
    if not traces:
        raise LogError(f"{reader.path}: holds no steps of {name}; record the topic `steps`")
    for life, own_traces in _by_life(traces).items():
        node = build(node_type, spec.config, name, graph.seed)
        stepper = Stepper(node, name)
        produced = {
            (topic, n) for trace in own_traces for topic, ns in trace.message.produced.items() for n in ns
        }
        first = [
            item
            for (topic, n), item in outputs.items()
            if n >> LIFE_BITS == life and (topic, n) not in produced
        ]
        yield Step(-1, 0, _grouped(first), _given(node.start(), spec))
        for trace in own_traces:
            messages = [
                _find(reader, inputs, spec, source, n, trace) for source, n in _consumed(trace.message)
            ]
            messages.sort(key=lambda m: (m.stamp_ns, m.topic, m.publisher, m.sequence))
            stepper.deliver(messages, trace.stamp_ns)
            given = _given(stepper.step(), spec)
            recorded = [
                outputs[topic, n]
                for topic, numbers in trace.message.produced.items()
                for n in numbers
                if (topic, n) in outputs
            ]
            yield Step(trace.message.step, trace.stamp_ns, _grouped(recorded), given)
        node.close()


_Key = tuple[str, int]


def _read(
    reader: LogReader, spec: NodeSpec
) -> tuple[list[Logged[StepTrace]], dict[_Key, Logged[Any]], dict[_Key, Logged[Any]]]:
    """Traces of the node; its inputs by source and number; its outputs by topic and number."""
    wired = {wire.topic for wire in spec.inputs.values()}
    own = {topic for port, topic in spec.outputs.items() if port not in _BOOKKEEPING}
    wanted = ((wired | own) & {*reader.topics}) - {"done", "diagnostics", "log"} | (wired & {*reader.topics})
    traces: list[Logged[StepTrace]] = []
    if STEPS.name in reader.topics:
        traces = list(reader.read(STEPS, publisher=spec.name))
        traces.sort(key=lambda trace: trace.sequence)
    inputs: dict[_Key, Logged[Any]] = {}
    outputs: dict[_Key, Logged[Any]] = {}
    for item in reader.messages(wanted, order="sent"):
        if item.topic in wired:
            inputs[item.source, item.sequence] = item
        if item.publisher == spec.name and item.topic in own:
            outputs[item.topic, item.sequence] = item
    return traces, inputs, outputs


def _by_life(traces: Iterable[Logged[StepTrace]]) -> dict[int, list[Logged[StepTrace]]]:
    """Traces by how often the node had been restarted; a new life starts from nothing."""
    lives: dict[int, list[Logged[StepTrace]]] = defaultdict(list)
    for trace in traces:
        lives[trace.sequence >> LIFE_BITS].append(trace)
    return lives


def _consumed(trace: StepTrace) -> list[_Key]:
    return [(source, n) for source, numbers in trace.consumed.items() for n in numbers]


def _find(
    reader: LogReader,
    inputs: dict[_Key, Logged[Any]],
    spec: NodeSpec,
    source: str,
    sequence: int,
    trace: Logged[StepTrace],
) -> Received[Any]:
    """A consumed message, as the bus had delivered it."""
    item = inputs.get((source, sequence))
    if item is None:
        raise LogError(
            f"{reader.path}: lacks message {sequence} of {source}, which step {trace.message.step} of "
            f"{spec.name} took; record all its inputs"
        )
    port = next(port for port, wire in spec.inputs.items() if wire.topic == item.topic)
    return item.received(port)


def _grouped(items: list[Logged[Any]]) -> dict[str, list[Logged[Any]]]:
    groups: dict[str, list[Logged[Any]]] = defaultdict(list)
    for item in items:
        groups[item.topic].append(item)
    return dict(groups)


def _given(outgoing: Iterable[Outgoing], spec: NodeSpec) -> dict[str, list[Any]]:
    given: dict[str, list[Any]] = defaultdict(list)
    for item in outgoing:
        given[spec.outputs.get(item.topic.name, item.topic.name)].append(item.message)
    return dict(given)


def write_update(reader: LogReader, name: str, result: Result, path: Path) -> None:
    """Write a copy of the log in which the node's outputs are the new ones.

    Messages keep number and times where there was one in their place; further ones come at the step's time.

    Raises:
        LogError: the new log exists.
    """
    topics = resolve_topics(reader.graph) if reader.graph else {}
    replaced = {
        (item.topic, item.sequence)
        for step in result.replayed
        for row in step.recorded.values()
        for item in row
    }
    with LogWriter(path, metadata=reader.index.metadata) as writer:
        for file, data in reader.index.attachments.items():
            writer.attach(file, "application/json", data)
        for item in reader.messages(order="file"):
            if item.publisher != name or (item.topic, item.sequence) not in replaced:
                writer.copy(item)
        _write_outputs(writer, name, result, topics)


def _write_outputs(writer: LogWriter, name: str, result: Result, topics: dict[str, Topic]) -> None:
    next_number: dict[str, int] = defaultdict(int)
    for step in result.replayed:
        for topic, messages in step.given.items():
            recorded = step.recorded.get(topic, [])
            for position, message in enumerate(messages):
                if position < len(recorded):
                    old = recorded[position]
                    number, stamp_ns, sent_ns = old.sequence, old.stamp_ns, old.sent_ns
                else:
                    number, stamp_ns, sent_ns = next_number[topic], step.stamp_ns, 0
                next_number[topic] = max(next_number[topic], number + 1)
                writer.write_message(topics[topic], name, number, stamp_ns, sent_ns, message)
