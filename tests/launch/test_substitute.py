import pytest

from footfall.launch.substitute import substitute
from footfall.launch.wiring import complete
from footfall.messages.config import ConfigError
from footfall.messages.graph import Graph, Input, NodeSpec


def node(name: str, inputs: str = "", outputs: str = "", **more) -> NodeSpec:
    return NodeSpec(
        name,
        f"footfall.nodes.{name}",
        {topic: Input(topic) for topic in inputs.split()},
        {topic: topic for topic in outputs.split()},
        **more,
    )


@pytest.fixture
def graph() -> Graph:
    nodes = [
        node("map_server", "", "map"),
        node("simulator", "body_actions", "clock agents body_states falls"),
        node("planner", "map agents", "plans"),
        node("controller", "plans body_states", "body_actions"),
        node("recorder", "agents", lockstep=False),
    ]
    return complete(Graph("yard", nodes, duration=5.0))


RECORDED = {
    "map_server": {"map", "diagnostics", "steps"},
    "simulator": {"clock", "agents", "body_states", "log"},
    "planner": {"plans", "parameters"},
    "controller": {"body_actions"},
    "launcher": {"control", "graph"},
    "recorder": {"diagnostics"},
}


def names(graph: Graph) -> list[str]:
    return [node.name for node in graph.nodes]


def test_everything_is_played(graph):
    result = substitute(graph, RECORDED, {"path": "x"})
    assert names(result) == ["player", "sink"]
    played = {"map", "agents", "body_states", "falls", "plans", "body_actions"}
    assert set(result.node("player").outputs) == played | {"clock"}
    assert set(result.node("sink").inputs) == played | {"clock"}
    assert {wire.policy for wire in result.node("sink").inputs.values()} == {"reliable"}
    assert result.duration is None and result.node("player").config == {"path": "x"}


def test_some_nodes_stay(graph):
    result = substitute(graph, RECORDED, {}, replace=["simulator", "map_server"])
    assert names(result) == ["player", "planner", "controller", "sink"]
    assert set(result.node("player").outputs) == {"clock", "map", "agents", "body_states", "falls"}
    completed = complete(result)
    assert completed.node("player").inputs["done"].policy == "reliable"
    assert "clock" in completed.node("planner").inputs


def test_selection_and_other_names(graph):
    result = substitute(graph, RECORDED, {}, topics=["agents", "map"], exclude=["map"])
    assert set(result.node("player").outputs) == {"clock", "agents"}
    result = substitute(graph, RECORDED, {}, remap={"agents": "ghosts"})
    assert result.node("player").outputs["agents"] == "ghosts"
    assert "ghosts" in result.node("sink").inputs and "agents" not in result.node("sink").inputs


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"replace": ["simulatr"]}, "nothing of a node 'simulatr'; did you mean 'simulator'"),
        ({"replace": ["planner"]}, "simulator would run live and own the clock"),
        ({"replace": ["simulator"], "exclude": ["agents"]}, "planner listens to 'agents'"),
        ({"topics": ["agent"]}, "did you mean 'agents'"),
        ({"remap": {"clock": "time"}}, "'clock' is not among those played"),
    ],
)
def test_refusals(graph, options, reason):
    with pytest.raises(ConfigError, match=reason):
        substitute(graph, RECORDED, {}, **options)
