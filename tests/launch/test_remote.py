"""A graph that listens to another one over TCP, each known to the other by its key."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from footfall.launch.check import check
from footfall.launch.launch_file import load_launch
from footfall.launch.prepare import prepare
from footfall.launch.wiring import complete, with_recorder
from footfall.messages.config import ConfigError
from footfall.messages.graph import Graph, Input, NodeSpec, edges, remote_edges
from footfall.messages.secure import new_keys
from footfall.messages.topics import TOPICS

LITTLE = Path(__file__).parent / "little"
HERE = """
name: here
args: {{duration: null}}
duration: $duration
clock: {{mode: realtime}}
topics: {{beat: "beats:BEAT", echo: "beats:ECHO"}}
security: {{secret_key_file: keys/{who}.key_secret}}
remotes:
  robot:
    server_key_file: keys/robot.key
    topics: {{clock: "tcp://{host}:{port}", beat: "tcp://{host}:{next}"}}
nodes:
  echoer: {{module: echoer, inputs: {{beat: {{queue: 20}}}}, outputs: [echo]}}
"""
THERE = """
name: there
include: [{little}]
clock: {{mode: realtime}}
security: {{secret_key_file: keys/robot.key_secret, authorized_keys_dir: keys/list}}
nodes:
  ticker: {{expose: {{clock: "tcp://{host}:{port}", beat: "tcp://{host}:{next}"}}}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Keys of the robot, of a friend on its list and of a stranger."""
    for name in ("robot", "friend", "stranger"):
        new_keys(tmp_path / "keys", name)
    (tmp_path / "keys" / "list").mkdir()
    shutil.copy(tmp_path / "keys" / "friend.key", tmp_path / "keys" / "list")
    return tmp_path


def write(folder: Path, host: str = "127.0.0.1", who: str = "friend") -> tuple[str, str]:
    """Launch files of both sides, on two free ports."""
    with socket.socket() as one, socket.socket() as two:
        one.bind(("127.0.0.1", 0))
        two.bind(("127.0.0.1", 0))
        ports = {"port": one.getsockname()[1], "next": two.getsockname()[1]}
    (folder / "here.yaml").write_text(HERE.format(host=host, who=who, **ports))
    (folder / "there.yaml").write_text(THERE.format(host=host, little=LITTLE / "little.yaml", **ports))
    return str(folder / "there.yaml"), str(folder / "here.yaml")


def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Graph:
    monkeypatch.syspath_prepend(str(LITTLE))
    return load_launch(Path(write(folder)[1]))


def test_wires(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, topics = prepare(here(folder, monkeypatch))
    wires = {(e.topic, e.publisher, e.subscriber) for e in remote_edges(graph)}
    assert wires == {
        ("beat", "robot", "echoer"),
        ("clock", "robot", "echoer"),
        ("clock", "robot", "launcher"),
    }
    assert not any(edge.publisher == "robot" for edge in edges(graph))
    assert graph.remotes["robot"].server_key_file == str(folder / "keys" / "robot.key")
    recorded = with_recorder(graph, {"path": "x.mcap"}, topics).node("recorder").inputs
    assert (recorded["beat"].policy, recorded["echo"].policy) == ("queue", "reliable")
    check(with_recorder(graph, {"path": "x.mcap"}, topics), topics)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("mode: realtime", "mode: lockstep", "the clock is that of robot, elsewhere, which waits for nobody"),
        ("queue: 20", "policy: reliable", "input 'beat' comes from elsewhere, where nobody waits for it"),
        ("  robot:\n", "  echoer:\n", "'echoer' is the name of a node here; choose another"),
        ("tcp://127.0.0.1", "udp://127.0.0.1", "must be tcp://HOST:PORT"),
        ("tcp://127.0.0.1", "tcp://*", "names no machine to connect to"),
        ("{clock:", "{clokc:", "no topic 'clokc'; did you mean 'clock'?"),
        ("keys/robot.key", "keys/robt.key", "no such file"),
        ("security:", "topics: {}\nduration: null #", "needs keys"),
        ("outputs: [echo]", "outputs: [echo, clock]", "nodes echoer and robot do"),
        ("topics: {clock", "topcs: {clock", "unknown key 'topcs'; did you mean 'topics'?"),
    ],
)
def test_refused(folder: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, sentence: str) -> None:
    monkeypatch.syspath_prepend(str(LITTLE))
    path = Path(write(folder)[1])
    text = path.read_text()
    if new.startswith("topics: {}"):
        text = "\n".join(line for line in text.splitlines() if not line.startswith("security"))
    else:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        prepare(load_launch(path))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_exposing_needs_a_list() -> None:
    source = NodeSpec(
        "sim", "footfall.nodes.simulator", outputs={"clock": "clock"}, expose={"clock": "tcp://*:7000"}
    )
    listener = NodeSpec("a", "footfall.nodes.planner", {"clock": Input("clock")})
    from footfall.messages.graph import Security

    with pytest.raises(ConfigError, match="authorized_keys_dir"):
        check(complete(Graph("g", [source, listener], security=Security("x.key_secret"))), TOPICS)


@pytest.mark.slow
def test_a_graph_hears_another_one(launch: Callable, folder: Path) -> None:
    there, here = write(folder)
    robot = launch(there)
    robot.wait_for("-m ticker")
    time.sleep(1.5)
    log = folder / "run.mcap"
    summary = launch(here, "--duration", "2", "--json", "--record", str(log)).summary()
    assert summary["first_failure"] is None
    assert summary["ended"] == "2 s simulated"
    assert summary["sim_seconds"] > 2.0  # on the robot's clock, which was running already
    assert summary["topics"]["beat"]["received"]["echoer"] >= 55
    assert summary["topics"]["echo"]["sent"] >= 30
    rows = subprocess.run(
        [sys.executable, "-m", "footfall.tools.cli", "topic", "list", "--log", str(log), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    found = {(row["topic"], row["publisher"]): row["messages"] for row in json.loads(rows.stdout)}
    assert found["beat", "robot"] >= 55


@pytest.mark.slow
def test_a_stranger_hears_nothing(launch: Callable, folder: Path, runs_home: Path) -> None:
    there, here = write(folder, who="stranger")
    robot = launch(there)
    robot.wait_for("-m ticker")
    time.sleep(1.5)
    stranger = launch(here, "--json")
    deadline = time.monotonic() + 20
    while not any("refused" in log.read_text() for log in runs_home.rglob("ticker.jsonl")):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    time.sleep(3.0)
    stranger.process.send_signal(signal.SIGINT)
    summary = stranger.summary()
    assert summary["sim_seconds"] == 0.0
    assert summary["topics"]["beat"]["received"] == {"echoer": 0}
    robot.process.send_signal(signal.SIGINT)
    _, _, err = robot.finish()
    assert "refused 127.0.0.1: its key" in err


@pytest.fixture
def two_machines() -> Iterator[tuple[str, str]]:
    """Two network namespaces with a cable between them; the first has the address 10.213.0.1."""
    names = (f"ffa{os.getpid()}", f"ffb{os.getpid()}")
    commands = [
        *(f"netns add {name}" for name in names),
        f"-n {names[0]} link add cable type veth peer name cable netns {names[1]}",
        *(f"-n {name} addr add 10.213.0.{n}/24 dev cable" for n, name in enumerate(names, 1)),
        *(f"-n {name} link set {link} up" for name in names for link in ("lo", "cable")),
    ]
    try:
        for command in commands:
            done = subprocess.run(["ip", *command.split()], capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"no network namespaces here: {done.stderr.strip()}")
        yield names
    except FileNotFoundError:
        pytest.skip("no `ip` command here")
    finally:
        for name in names if shutil.which("ip") else ():
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


@pytest.mark.slow
def test_between_two_machines(
    launch: Callable, folder: Path, two_machines: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    there, here = write(folder, host="10.213.0.1")
    first, second = two_machines
    robot = launch(there, before=("ip", "netns", "exec", first))
    robot.wait_for("-m ticker")
    time.sleep(1.5)
    listener = launch(here, "--duration", "2", "--json", before=("ip", "netns", "exec", second))
    summary = listener.summary()
    assert summary["first_failure"] is None
    assert summary["topics"]["beat"]["received"]["echoer"] >= 55
