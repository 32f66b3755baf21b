"""Graphs that cannot work are refused before any process is started; shipped ones close."""

import socket
from pathlib import Path

import msgspec
import pytest

from footfall.launch.check import check, check_paths
from footfall.launch.expand import SHIPPED
from footfall.launch.find import shipped_launches
from footfall.launch.launch_file import load_launch
from footfall.launch.prepare import prepare
from footfall.launch.wiring import complete, with_recorder
from footfall.messages.config import ConfigError
from footfall.messages.graph import LAUNCHER, ClockSpec, Graph, Input, NodeSpec, Security, edges
from footfall.messages.secure import new_keys
from footfall.messages.topics import TOPICS

MODULE = "footfall.nodes.map_server"


def node(
    name: str, inputs: dict[str, str] | None = None, outputs: dict[str, str] | None = None, **more
) -> NodeSpec:
    wires = {port: Input(topic) for port, topic in (inputs or {}).items()}
    return NodeSpec(name, more.pop("module", MODULE), wires, outputs or {}, **more)


CLOCK = node("sim", outputs={"clock": "clock", "agents": "agents"})


def graph(*nodes: NodeSpec, **more) -> Graph:
    return Graph("g", list(nodes), **more)


@pytest.mark.parametrize("name", shipped_launches())
def test_shipped_launch_files_close(name: str, tmp_path: Path) -> None:
    ready, topics = prepare(load_launch(SHIPPED / f"{name}.yaml"), record=tmp_path / "run.mcap")
    recorder = ready.node("recorder")
    assert {wire.policy for wire in recorder.inputs.values()} == {"reliable"}
    recorded = {name for name, topic in topics.items() if topic.recorded and ready.publishers(name)}
    assert recorded <= {wire.topic for wire in recorder.inputs.values()}


@pytest.mark.parametrize(
    ("nodes", "sentence"),
    [
        ([], "g: has no nodes"),
        ([node("a")], "exactly one node must own the clock (output `clock`); none does"),
        ([CLOCK, node("b", outputs={"clock": "clock"})], "nodes sim and b do"),
        ([CLOCK, node("a", {"plans": "plans"})], "nobody publishes 'plans', which node a takes as 'plans'"),
        ([CLOCK, node("a", {"plams": "plans"})], "input 'plams': a port is called as its topic"),
        ([CLOCK, node("a", {"plans": "plams"})], "input 'plans': no topic 'plams'; did you mean 'plans'?"),
        (
            [CLOCK, node("a", {"plans": "agents"})],
            "'plans' holds Plans, but topic 'agents' carries AgentStates",
        ),
        (
            [CLOCK, node("a", outputs={"map": "map"}), node("b", outputs={"map": "map"})],
            "'map' may have one publisher; nodes a and b both publish it",
        ),
        (
            [CLOCK, node("a", module="footfall.nodes.referree")],
            "node a: no module 'footfall.nodes.referree'; did you mean 'footfall.nodes.referee'?",
        ),
        ([CLOCK, node("a", required=False)], "is not required, but in lockstep the clock waits for it"),
        ([CLOCK, node("a", outputs={"map": "map"}, expose={"mpa": "tcp://*:7000"})], "did you mean 'map'?"),
        ([CLOCK, node("a", outputs={"map": "map"}, expose={"map": "7000"})], "must be like tcp://"),
        ([CLOCK, node("a", outputs={"map": "map"}, expose={"map": "tcp://0.0.0.0:7000"})], "needs keys"),
        ([CLOCK, node("a", outputs={"map": "map"}, expose={"map": "tcp://127.0.0.1:7000"})], "needs keys"),
    ],
)
def test_refused(nodes: list[NodeSpec], sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check(complete(graph(*nodes)), TOPICS)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_exposed_needs_a_free_port_and_good_keys(tmp_path: Path) -> None:
    public, secret = new_keys(tmp_path / "own", "graph")
    _, _ = new_keys(tmp_path / "friends", "friend")
    keys = Security(str(secret), str(tmp_path / "friends"))

    def exposed(address: str, security: Security) -> Graph:
        publisher = node("a", outputs={"map": "map"}, expose={"map": address})
        return complete(graph(CLOCK, publisher, security=security))

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ConfigError, match=r"cannot listen on 127.0.0.1:.*in use"):
            check(exposed(address, keys), TOPICS)
    check(exposed(address, keys), TOPICS)
    for wrong, sentence in (
        (Security("/gone", keys.authorized_keys_dir), "no such file"),
        (Security(str(public), keys.authorized_keys_dir), "holds no secret key"),
        (Security(str(secret), str(tmp_path)), "so nobody could connect"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            check(exposed(address, wrong), TOPICS)
    with pytest.raises(ConfigError, match="must be tcp://HOST:PORT"):
        check(exposed("tcp://127.0.0.1:99999", keys), TOPICS)


def test_deep_run_directory_is_refused() -> None:
    deep = complete(graph(CLOCK, run_dir="/tmp/" + "x" * 90))
    with pytest.raises(ConfigError, match="longer than 107 bytes"):
        check_paths(deep)


def test_custom_topics_must_be_topics(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="topic odd: cannot import 'nowhere:X'"):
        prepare(graph(CLOCK, custom_topics={"odd": "nowhere:X"}))
    with pytest.raises(ConfigError, match="must be a Topic named 'odd'"):
        prepare(graph(CLOCK, custom_topics={"odd": "footfall.messages.topics:MAP"}))


def test_every_node_gets_the_common_ports() -> None:
    follower, bystander = node("a", {"agents": "agents"}), node("b", lockstep=False, required=False)
    ready = complete(graph(CLOCK, follower, bystander))
    assert ready.node("a").inputs["clock"] == Input("clock")
    assert ready.node("a").inputs["control"] == Input("control", "queue", 100)
    assert {"diagnostics", "log", "parameters", "steps", "done"} == set(ready.node("a").outputs)
    assert "done" not in ready.node("b").outputs
    assert "clock" not in ready.node("sim").inputs
    assert ready.node("sim").inputs["done"].policy == "reliable"
    assert ready.nodes[-1].name == LAUNCHER
    assert complete(ready) == ready
    free = complete(msgspec.structs.replace(ready, clock=ClockSpec("free")))
    assert not any("done" in (*n.inputs, *n.outputs) for n in free.nodes)


def test_recorder_hears_every_recorded_topic_reliably() -> None:
    recorded = with_recorder(complete(graph(CLOCK, node("a", {"agents": "agents"}))), {"path": "x.mcap"})
    heard = {edge.topic for edge in edges(recorded) if edge.subscriber == "recorder" and edge.reliable}
    published = {topic for n in recorded.nodes for topic in n.outputs.values()}
    assert heard == {name for name in published if TOPICS[name].recorded}
    assert {"agents", "clock", "control", "diagnostics", "graph", "log", "steps"} <= heard
    assert "done" in published - heard
    assert not any(edge.in_step for edge in edges(recorded) if edge.subscriber == "recorder")


def test_recording_never_replaces_what_is_not_a_log(tmp_path: Path) -> None:
    letter = tmp_path / "letter.txt"
    letter.write_text("dear friend")
    plain = graph(CLOCK, node("a", {"agents": "agents"}))
    with pytest.raises(ConfigError, match="exists and is not a log"):
        prepare(plain, record=letter)
    with pytest.raises(ConfigError, match="is a directory"):
        prepare(plain, record=tmp_path)
