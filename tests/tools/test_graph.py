"""`footfall graph`: arrows, Graphviz and JSON of a launch file."""

import json
import re

import pytest

from footfall.messages.graph import Graph, edges
from footfall.tools import cli


def test_diagram_shows_every_wire_once(capsys: pytest.CaptureFixture) -> None:
    assert cli.main(["graph", "crossing"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^map_server +=+map=+> simulator, planner", text, re.MULTILINE)
    assert re.search(r"^referee only listens$", text, re.MULTILINE)
    assert "diagnostics" not in text


def test_json_is_the_whole_graph_and_dot_has_its_wires(capsys: pytest.CaptureFixture) -> None:
    import msgspec

    assert cli.main(["graph", "crossing", "--json"]) == 0
    graph = msgspec.convert(json.loads(capsys.readouterr().out), Graph)
    assert cli.main(["graph", "crossing", "--dot", "--all"]) == 0
    drawn = re.findall(r'^  "(\w+)" -> "(\w+)" \[label="(\w+)"', capsys.readouterr().out, re.MULTILINE)
    assert sorted(drawn) == sorted((e.publisher, e.subscriber, e.topic) for e in edges(graph))
