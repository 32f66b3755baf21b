"""A graph in which a player takes the place of recorded nodes."""

from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from ..messages.config import ConfigError, near
from ..messages.graph import LAUNCHER, Graph, Input, NodeSpec
from ..messages.topics import CLOCK, CONTROL, DIAGNOSTICS, DONE, LOG, PARAMETERS, STEERING, STEPS
from .wiring import clock_owners

PLAYER = "player"
SINK = "sink"
RECORDER_MODULE = "footfall.nodes.recorder"
SINK_DEPTH = 1000
"""Messages of one topic on their way to the sink before the player waits."""
_OF_EVERY_NODE = {topic.name for topic in (CLOCK, DIAGNOSTICS, DONE, LOG, PARAMETERS, STEPS)}


def substitute(
    graph: Graph,
    recorded: Mapping[str, Collection[str]],
    config: Mapping[str, Any],
    replace: Collection[str] | None = None,
    topics: Collection[str] | None = None,
    exclude: Collection[str] = (),
    remap: Mapping[str, str] | None = None,
) -> Graph:
    """Put a player in the place of recorded nodes; it owns the clock.

    Args:
        graph: The graph that was recorded, or another one.
        recorded: Topics in the log by publisher.
        config: Configuration of `footfall.nodes.player`.
        replace: Nodes to replace; None for all that were recorded.
        topics: Play only these; None for all.
        exclude: Do not play these.
        remap: Other names for played topics.

    Returns:
        The graph, to be completed: player, the nodes that stay, and a sink that takes what is played.

    Raises:
        ConfigError: a node or topic that is not there, or a graph that would have two clocks.
    """
    nodes = {node.name: node for node in graph.nodes if not _is_left_out(node)}
    replaced = _replaced(nodes, recorded, replace)
    live = [node for name, node in nodes.items() if name not in replaced]
    played = {name for node in replaced for name in _topics_of(node, nodes, recorded)} - _OF_EVERY_NODE
    for name in (*(topics or ()), *exclude, *(remap or {})):
        if name not in played:
            raise ConfigError(f"topic {name!r} is not among those played; {near(name, played)}")
    played = (played if topics is None else played & {*topics}) - {*exclude}
    if owners := clock_owners(msgspec.structs.replace(graph, nodes=live)):
        raise ConfigError(
            f"{owners[0]} would run live and own the clock, which the player does; replace {owners[0]} too"
        )
    outputs = {name: (remap or {}).get(name, name) for name in sorted(played)}
    _check_sources(live, outputs)
    player = NodeSpec(
        PLAYER,
        "footfall.nodes.player",
        {
            CONTROL.name: Input(CONTROL.name, "queue", 100),
            DIAGNOSTICS.name: Input(DIAGNOSTICS.name, "queue", 1000),
        },
        {CLOCK.name: CLOCK.name, **outputs},
        dict(config),
    )
    wires = {name: Input(name, "reliable", SINK_DEPTH) for name in (*outputs.values(), CLOCK.name)}
    sink = NodeSpec(SINK, "footfall.nodes.sink", wires, required=True, lockstep=False)
    return msgspec.structs.replace(
        graph, name=f"replay-{graph.name}", nodes=[player, *live, sink], duration=None, run_dir=""
    )


def _is_left_out(node: NodeSpec) -> bool:
    """The launcher is added anew, recorders are asked for anew."""
    return node.name in (LAUNCHER, PLAYER, SINK) or node.module == RECORDER_MODULE


def _replaced(
    nodes: Mapping[str, NodeSpec], recorded: Mapping[str, Collection[str]], replace: Collection[str] | None
) -> list[str]:
    if replace is None:
        return [name for name in recorded if name != LAUNCHER]
    for name in replace:
        if name not in recorded:
            raise ConfigError(f"--replace: the log has nothing of a node {name!r}; {near(name, recorded)}")
    return [*replace]


def _topics_of(name: str, nodes: Mapping[str, NodeSpec], recorded: Mapping[str, Collection[str]]) -> set[str]:
    """What a replaced node has published, and what it might have."""
    declared = set(nodes[name].outputs.values()) if name in nodes else set()
    return {*recorded.get(name, ()), *declared}


def _check_sources(live: list[NodeSpec], outputs: Mapping[str, str]) -> None:
    """Whatever the live nodes listen to must come from the log or from one of them."""
    own = {topic for node in live for topic in node.outputs.values()}
    given = own | {*outputs.values()} | _OF_EVERY_NODE | {CONTROL.name, STEERING.name}
    for node in live:
        for wire in node.inputs.values():
            if wire.topic not in given:
                raise ConfigError(
                    f"{node.name} listens to {wire.topic!r}, which is neither played nor published by a "
                    "live node"
                )
