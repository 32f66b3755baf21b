"""Messages from the command line: what they are made of, who gets them, and what stands in the log."""

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from footfall.launch.outside import Outside
from footfall.messages.codec import Codec, Header, MessageError, plain
from footfall.messages.config import ConfigError
from footfall.messages.graph import OUTSIDE, Graph, Input, NodeSpec
from footfall.messages.link import Publish
from footfall.messages.log import LogReader
from footfall.messages.samples import sample
from footfall.messages.topics import AGENTS, FALLS, OBJECTIVES, STEERING, TOPICS, Topic
from footfall.tools.topic_pub import record_of

FALL = "{ids: [1, 2], positions: [[0, 0, 1], [2.5, 0, 1]], handling: report}"


def as_json(value: object) -> object:
    """As `topic echo --json` prints a message."""
    return json.loads(
        json.dumps(value, default=lambda item: item.tolist() if hasattr(item, "tolist") else item)
    )


@pytest.mark.parametrize("topic", TOPICS.values(), ids=lambda topic: topic.name)
@pytest.mark.parametrize("scale", [1, 4])
def test_what_echo_prints_can_be_published(topic: Topic, scale: int) -> None:
    message = sample(topic.type, scale)
    record = record_of(topic, as_json(plain(message)))
    again = Codec(topic.name, topic.type).decode(record)
    np.testing.assert_equal(plain(again), plain(message))


@pytest.mark.parametrize(
    ("topic", "values", "sentence"),
    [
        (FALLS, {"id": [1]}, "falls: no field 'id'; did you mean 'ids'?"),
        (FALLS, [1], "falls: must be a mapping with ids, positions, handling"),
        (FALLS, {"ids": "x", "positions": []}, r"falls: ids: must be an array \(N,\) of int32"),
        (FALLS, {"ids": [1.5], "positions": []}, r"falls: ids: must be an array \(N,\) of int32"),
        (FALLS, {"ids": [2**40], "positions": []}, r"falls: ids: must be an array \(N,\) of int32"),
        (FALLS, {"ids": [[1], [1, 2]], "positions": []}, r"falls: ids: must be an array \(N,\) of int32"),
        (
            OBJECTIVES,
            {"agents": [{"id": 1, "objectives": [{"type": "Waypiont"}]}]},
            "did you mean 'Waypoint'",
        ),
        (STEERING, {"command": {"agent": 3}}, "steering: command: must say its `type`"),
    ],
)
def test_near_matches(topic: Topic, values: object, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        record_of(topic, values)


def test_wrong_values_are_named_by_their_field() -> None:
    fall = {"ids": [1], "positions": [[0, 0]], "handling": "report"}
    for wrong, sentence in (
        ({}, r"positions: has shape \(1, 2\), must be \(N, 3\)"),
        ({"positions": [[0, 0, float("nan")]]}, "positions: holds NaN"),
        ({"positions": [[0, 0, 1]], "handling": 3}, "handling: Expected `str`"),
    ):
        with pytest.raises(MessageError, match=sentence):
            record_of(FALLS, fall | wrong)


def test_the_launcher_checks_numbers_and_addresses() -> None:
    listener = NodeSpec("referee", "m", {"falls": Input("falls"), "clock": Input("clock")})
    outside = Outside(Graph("g", [listener]), TOPICS)
    body = record_of(FALLS, {"ids": [], "positions": [], "handling": "report"})
    for number in range(3):
        names, line = outside.take(Publish("falls", body), 7)
        header = Header.unpack("falls", line.message)
        assert (names, line.topic, header.sequence, header.stamp_ns) == (["referee"], "falls", number, 7)
        assert line.message[Header.SIZE :] == body
    for topic, sentence in (
        ("clock", "clock is the graph's own"),
        ("fals", "nobody listens to 'fals'; did you mean 'falls'"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            outside.take(Publish(topic, body), 0)
    with pytest.raises(MessageError, match="falls"):
        outside.take(Publish("falls", b"\x80"), 0)


@pytest.fixture
def yard(tiny_run, tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    """The tiny graph, running and recorded."""
    arguments = ("launch", "yard.yaml", "--duration", "600", "--rate", "1", "--record", tmp_path / "run.mcap")
    run = subprocess.Popen(
        tiny_run.command(*arguments, "--json", "--run-dir", tmp_path / "run"),
        cwd=tiny_run.folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 30
    while not list((tmp_path / "run" / "log").glob("keeper.jsonl")) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(2.0)
    yield run
    run.terminate()
    run.communicate()


@pytest.mark.slow
def test_the_nodes_and_the_log_see_what_is_published(tiny_run, yard, tmp_path: Path) -> None:
    where = ("--run-dir", tmp_path / "run")
    assert tiny_run.footfall("topic", "pub", "falls", FALL, *where).returncode == 0
    assert (
        tiny_run.footfall("topic", "pub", "falls", FALL, "--rate", "20", "--count", "3", *where).returncode
        == 0
    )
    for words, sentence in (
        (("fals", FALL), "no topic 'fals'; did you mean 'falls'?"),
        (("falls", "{id: [1]}"), "falls: no field 'id'; did you mean 'ids'?"),
        (("falls", "{ids: ["), "neither YAML nor JSON"),
        (("clock", "{}"), "clock"),
    ):
        wrong = tiny_run.footfall("topic", "pub", *words, *where)
        assert wrong.returncode == 2 and len(wrong.stderr.splitlines()) == 1
        assert sentence in wrong.stderr
    time.sleep(0.5)
    yard.terminate()
    summary = json.loads(yard.communicate(timeout=30)[0].splitlines()[-1])
    assert summary["topics"]["falls"]["received"]["keeper"] == 4
    assert (summary["dropped"], summary["topics"]["falls"]["rejected"]) == (0, 0)
    log = LogReader(tmp_path / "run.mcap")
    published = [one for one in log.messages([FALLS.name]) if one.publisher == OUTSIDE]
    assert len(published) == 4
    message = published[0].received(FALLS.name).message
    np.testing.assert_array_equal(message.ids, [1, 2])
    assert tiny_run.footfall("regress", tmp_path / "run.mcap", "--node", "keeper").returncode == 0
    assert tiny_run.footfall("replay", tmp_path / "run.mcap", "--rate", "max").returncode == 0


@pytest.mark.parametrize("verb", ["echo", "list", "info"])
def test_topics_of_a_log(tiny_run, verb: str) -> None:
    """What the tools say of a log is what the log says of itself."""
    reader = LogReader(tiny_run.log)
    states = [one for one in reader.messages([AGENTS.name])]
    if verb == "echo":
        done = tiny_run.footfall("topic", "echo", "agents", "--log", tiny_run.log, "--json", "--field", "ids")
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        assert [row["stamp_ns"] for row in rows] == [one.stamp_ns for one in states]
        assert rows[0] == {
            "topic": "agents", "publisher": "walker", "sequence": 0, "stamp_ns": 0, "ids": [1, 2]
        }  # fmt: skip
        once = tiny_run.footfall("topic", "echo", "agents", "--log", tiny_run.log, "--once").stdout
        assert once.splitlines()[:2] == ["# agents@walker 0 at 0.000 s", "ids: int32[2] [1, 2]"]
    elif verb == "list":
        rows = json.loads(tiny_run.footfall("topic", "list", "--log", tiny_run.log, "--json").stdout)
        assert {f"{row['topic']}@{row['publisher']}" for row in rows} == {c.source for c in reader.channels}
        assert {"agents": len(states)}.items() <= {row["topic"]: row["messages"] for row in rows}.items()
        assert "agents" in tiny_run.footfall("topic", "list", "--log", tiny_run.log).stdout
    else:
        (row,) = json.loads(
            tiny_run.footfall("topic", "info", "agents", "--log", tiny_run.log, "--json").stdout
        )
        assert (row["type"], row["publisher"], row["messages"]) == ("AgentStates", "walker", len(states))
    wrong = tiny_run.footfall("topic", verb, "agnts", "--log", tiny_run.log)
    if verb != "list":
        assert wrong.returncode == 2
        assert "no topic 'agnts'; did you mean 'agents'?" in wrong.stderr


def test_link_lines_carry_bytes() -> None:
    line = Publish("falls", bytes(range(256)))
    assert msgspec.json.decode(msgspec.json.encode(line), type=Publish) == line
