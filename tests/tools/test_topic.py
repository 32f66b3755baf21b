"""Topic tools and `top` on a live graph of one publishing thread."""

import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from footfall.messages.agents import AgentStates
from footfall.messages.diagnostics import Diagnostics
from footfall.messages.graph import ClockSpec, Graph, Input, NodeSpec
from footfall.messages.topics import AGENTS, CLOCK, DIAGNOSTICS
from footfall.messages.zmq_bus import ZmqBus
from footfall.tools import cli
from footfall.tools.topic_echo import lines_of
from footfall.tools.topic_rates import Arrival, bw, delay, hz


@pytest.fixture(scope="module")
def run_dir() -> Iterator[str]:
    """A graph in which `simulator` publishes agents at 100 Hz, and diagnostics."""
    folder = Path(f"/tmp/fftt{os.getpid()}")
    folder.mkdir(mode=0o700)
    names = {t.name: t.name for t in (AGENTS, CLOCK, DIAGNOSTICS)}
    graph = Graph(
        "little",
        [
            NodeSpec("simulator", "m", outputs=names),
            NodeSpec("planner", "m", inputs={"agents": Input("agents", "queue", 5)}),
        ],
        str(folder),
        ClockSpec("free"),
    )
    (folder / "graph.json").write_bytes(msgspec.json.encode(graph))
    stop = threading.Event()

    def publish() -> None:
        bus = ZmqBus(graph, "simulator")
        states = AgentStates(
            np.arange(3, dtype="i4"),
            np.full(3, -1, "i4"),
            np.ones((3, 31, 7), "f4") * np.arange(7, dtype="f4"),
        )
        number = 0
        while not stop.wait(0.01):
            bus.publish(AGENTS, states, number * 10_000_000)
            if number % 20 == 0:
                report = Diagnostics("simulator", 1, number, 0.001, 0.002, 0.25, 50 << 20)
                bus.publish(DIAGNOSTICS, report, number * 10_000_000)
            number += 1
        bus.close()

    thread = threading.Thread(target=publish)
    thread.start()
    while not (folder / "agents@simulator").exists():
        time.sleep(0.01)
    yield str(folder)
    stop.set()
    thread.join()
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()


def topic(*words: str) -> int:
    return cli.main(["topic", *words])


def test_list(run_dir: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert topic("list", "--run-dir", run_dir) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["TOPIC", "agents", "clock", "diagnostics"]
    assert lines[1].split()[1:] == ["AgentStates", "simulator", "planner"]


def test_info(run_dir: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert topic("info", "agents", "--run-dir", run_dir, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["publishers"] == ["simulator"]
    assert facts["subscribers"] == [{"node": "planner", "port": "agents", "policy": "queue: 5"}]
    assert 30 < facts["measured_hz"] <= 105
    assert facts["rejected"] == 0


def test_schema_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert topic("schema", "agents") == 0
    schema = json.loads(capsys.readouterr().out)
    Draft202012Validator.check_schema(schema)
    history = schema["$defs"]["AgentStates"]["properties"]["history"]
    assert history["x-array"] == {"dtype": "f4", "shape": ["N", 31, 7], "frame": "world"}


def test_echo(run_dir: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert topic("echo", "agents", "--once", "--run-dir", run_dir) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("# agents@simulator ")
    assert lines[1:] == [
        "ids: int32[3] [0, 1, 2]",
        "groups: int32[3] [-1, -1, -1]",
        "history: float32[3, 31, 7] from 0 to 6, mean 3",
    ]
    assert (
        topic("echo", "agents", "--count", "2", "--json", "--field", "history.2.30", "--run-dir", run_dir)
        == 0
    )
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["history.2.30"] for row in rows] == [[0, 1, 2, 3, 4, 5, 6]] * 2
    assert rows[1]["sequence"] == rows[0]["sequence"] + 1


@pytest.mark.parametrize("verb", ["hz", "bw", "delay"])
def test_rates(run_dir: str, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    assert topic(verb, "agents", "--count", "1", "--json", "--run-dir", run_dir) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["messages"] > 20
    if verb == "hz":
        assert 20 < report["hz"] <= 105


def test_figures_of_rates() -> None:
    arrivals = [Arrival(i * 20_000_000, i * 20_000_000 + 1_000_000, 500) for i in range(51)]
    assert hz(arrivals)["hz"] == 50.0
    assert bw(arrivals)["bytes_per_s"] == 25_000.0
    assert delay(arrivals)["p95_ms"] == 1.0
    assert hz([]) == {"messages": 0, "hz": 0.0}


def test_user_errors(run_dir: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words, text in (
        (("echo", "agnts", "--run-dir", run_dir), "no topic 'agnts'; did you mean 'agents'?"),
        (("list", "--run-dir", "/nowhere"), "/nowhere: holds no graph.json"),
        (("echo", "agents", "--once", "--field", "histry", "--run-dir", run_dir), "did you mean 'history'?"),
        (("echo", "agents", "--once", "--field", "ids.9", "--run-dir", run_dir), "beyond the 3"),
        (("echo", "agents", "--connect", "tcp://127.0.0.1:1"), "needs --keys FILE"),
    ):
        assert topic(*words) == 2
        assert text in capsys.readouterr().err


def test_lines_of_nested_values() -> None:
    value = {"a": [{"b": 1, "c": [1.5, 2]}, {"b": 2, "c": []}], "d": {}, "e": "x"}
    assert lines_of(value, False) == [
        "a:",
        "  - b: 1",
        "    c: [1.5, 2]",
        "  - b: 2",
        "    c: []",
        "d: {}",
        'e: "x"',
    ]


def test_top(run_dir: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["top", "--once", "--json", "--run-dir", run_dir]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [row["node"] for row in out["nodes"]] == ["simulator"]
    assert out["nodes"][0]["cpu"] == 0.25
    assert cli.main(["top", "--once", "--run-dir", run_dir]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:3] == ["NODE", "CPU", "MB"]
    assert lines[2].split()[:3] == ["simulator", "25%", "50.0"]
