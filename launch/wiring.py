"""From the nodes of a launch file to a closed graph: ports every node has, launcher, recorder, viewer."""

from collections.abc import Mapping
from typing import Any

import msgspec

from ..messages.graph import LAUNCHER, Graph, Input, NodeSpec
from ..messages.topics import (
    CLOCK,
    CONTROL,
    DIAGNOSTICS,
    DONE,
    GRAPH,
    LOG,
    PARAMETERS,
    SCORE,
    STEERING,
    STEPS,
    TOPICS,
    Topic,
)

RECORDER_DEPTH = 1000
"""Messages of one topic the recorder may lag behind before the publisher waits for it."""

RECORDER_WATCHDOG = 60.0
"""A disk may take its time, and what the recorder holds is lost with it [s]."""

COMMON = {topic.name for topic in (CLOCK, CONTROL, DIAGNOSTICS, DONE, GRAPH, LOG, PARAMETERS, STEPS)}
"""Topics every graph has."""


def clock_owners(graph: Graph) -> list[str]:
    """Names of the nodes that publish the clock; a sound graph has one."""
    return [node.name for node in graph.nodes if CLOCK.name in node.outputs]


def complete(graph: Graph) -> Graph:
    """Add what every graph has: clock, control, diagnostics, log, traces, lockstep's `done`, the launcher.

    What is there already stays, so that a resolved graph may be changed and completed again.
    """
    nodes = [_with_common_ports(node, graph) for node in graph.nodes if node.name != LAUNCHER]
    followed = any(DONE.name in node.outputs for node in nodes)
    nodes = [_with_done_input(node) if CLOCK.name in node.outputs and followed else node for node in nodes]
    return msgspec.structs.replace(graph, nodes=[*nodes, _launcher(nodes)])


def _with_common_ports(node: NodeSpec, graph: Graph) -> NodeSpec:
    owns_clock = CLOCK.name in node.outputs
    inputs = {port: wire for port, wire in node.inputs.items() if port != DONE.name}
    outputs = {port: topic for port, topic in node.outputs.items() if port != DONE.name}
    if not owns_clock:
        inputs.setdefault(CLOCK.name, Input(CLOCK.name))
    inputs.setdefault(CONTROL.name, Input(CONTROL.name, "queue", 100))
    for topic in (DIAGNOSTICS, LOG, PARAMETERS, STEPS):
        outputs.setdefault(topic.name, topic.name)
    if graph.clock.mode == "lockstep" and node.lockstep and not owns_clock:
        outputs[DONE.name] = DONE.name
    return msgspec.structs.replace(node, inputs=inputs, outputs=outputs)


def _with_done_input(node: NodeSpec) -> NodeSpec:
    return msgspec.structs.replace(node, inputs={**node.inputs, DONE.name: Input(DONE.name, "reliable", 100)})


def _launcher(nodes: list[NodeSpec]) -> NodeSpec:
    inputs = {topic.name: Input(topic.name, "queue", 1000) for topic in (DIAGNOSTICS, LOG)}
    inputs[CLOCK.name] = Input(CLOCK.name)
    if any(SCORE.name in node.outputs.values() for node in nodes):
        inputs[SCORE.name] = Input(SCORE.name)
    outputs = {topic.name: topic.name for topic in (CONTROL, GRAPH, STEERING)}
    return NodeSpec(LAUNCHER, "footfall.launch.runner", inputs, outputs, lockstep=False)


def with_node(graph: Graph, node: NodeSpec) -> Graph:
    """The graph with one more node, completed."""
    others = [other for other in graph.nodes if other.name != node.name]
    return complete(msgspec.structs.replace(graph, nodes=[*others, node]))


def with_recorder(graph: Graph, config: Mapping[str, Any], topics: Mapping[str, Topic] = TOPICS) -> Graph:
    """The graph with a recorder that hears every recorded topic and loses nothing.

    Args:
        graph: The graph to record.
        config: Configuration of `footfall.nodes.recorder`.
        topics: Topics by name, built-in and custom.
    """
    recorder = NodeSpec(
        "recorder",
        "footfall.nodes.recorder",
        config=dict(config),
        required=False,
        lockstep=False,
        watchdog=RECORDER_WATCHDOG,
    )
    graph = with_node(graph, recorder)
    published = {topic for node in graph.nodes for topic in node.outputs.values()}
    published.update(*(remote.topics for remote in graph.remotes.values()))
    wire = {
        name: Input(name, "queue" if graph.remote_publishers(name) else "reliable", RECORDER_DEPTH)
        for name, topic in topics.items()
        if topic.recorded and name in published
    }
    return with_node(graph, msgspec.structs.replace(recorder, inputs=wire))
