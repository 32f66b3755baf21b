import csv
import json
from pathlib import Path

import numpy as np
import pytest

from footfall.messages.agents import STATE_COLUMNS, AgentStates
from footfall.messages.clock import Clock
from footfall.messages.diagnostics import LogLine
from footfall.messages.graph import ClockSpec, Graph, NodeSpec
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.plan import Plans
from footfall.messages.topics import AGENTS, CLOCK, LOG, PLANS, SCORE
from footfall.tools import log_export
from footfall.tools.cli import main

TICK_NS = 100_000_000
GRAPH = Graph(
    "yard", [NodeSpec("simulator", "x")], clock=ClockSpec("lockstep"), seed=7, versions={"numpy": "9"}
)


def states(tick: int) -> AgentStates:
    history = np.zeros((2, 31, 7), np.float32)
    history[:, -1] = [[tick, 0, 0.5, 1.25, 0.4, 0.5, 1], [tick, 1, -0.5, 1.5, 0.4, 0.5, 1]]
    return AgentStates(np.array([3, 8], np.int32), np.array([-1, 2], np.int32), history)


def write(path: Path, ticks: int = 30, nudge: float = 0.0, wall: int = 0, chunk_bytes: int = 4000) -> Path:
    """A small run; `wall` moves all that depends on wall time, `nudge` one element of one plan."""
    with LogWriter(path, GRAPH, chunk_bytes=chunk_bytes) as writer:
        for k in range(ticks):
            stamp, sent = k * TICK_NS, wall + k * 1000
            writer.write_message(AGENTS, "simulator", k, stamp, sent, states(k))
            writer.write_message(CLOCK, "simulator", k, stamp, sent + 1, Clock(k, TICK_NS, "lockstep"))
            if k % 5 == 0:
                positions = np.zeros((2, 1, 50, 2), np.float32)
                positions[1, 0, 7, 0] = nudge if k == 10 else 0.0
                plans = Plans(
                    np.array([3, 8], np.int32),
                    np.zeros(2, np.int32),
                    positions,
                    positions[..., 0],
                    positions[..., 1],
                    "orca",
                    planning_time=0.1 + wall,
                )
                writer.write_message(PLANS, "planner", k // 5, stamp, sent + 2, plans)
        for n in range(wall + 1):
            writer.write_message(LOG, "planner", n, 0, n, LogLine("planner", "INFO", str(n)))
    return path


def call(capsys, *arguments: object) -> tuple[int, str]:
    code = main(["log", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out if code != 2 else captured.err


def test_info(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    code, text = call(capsys, "info", path, "--json")
    facts = json.loads(text)
    assert code == 0 and facts["complete"] and facts["seed"] == 7 and facts["graph"] == "yard"
    assert facts["mode"] == "lockstep" and facts["versions"] == {"numpy": "9"}
    assert facts["messages"] == 67 and facts["duration"] == pytest.approx(2.9)
    rows = {row["topic"]: row for row in facts["topics"]}
    assert rows["agents"]["count"] == 30 and rows["agents"]["rate"] == pytest.approx(10)
    assert rows["agents"]["publisher"] == "simulator" and rows["agents"]["type"] == "AgentStates"
    assert rows["agents"]["last"] == pytest.approx(2.9) and rows["agents"]["bytes"] > 30 * 2 * 31 * 7 * 4
    assert rows["plans"]["count"] == 6 and rows["clock"]["latched"]
    code, text = call(capsys, "info", path)
    assert code == 0 and "67 messages" in text and "seed 7" in text and "AgentStates" in text


def test_info_prints_schema_and_graph(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    _, text = call(capsys, "info", path, "--schema", "plans")
    assert json.loads(text)["$ref"] == "#/$defs/Plans"
    _, text = call(capsys, "info", path, "--graph")
    assert json.loads(text)["nodes"][0]["name"] == "simulator"
    assert call(capsys, "info", path, "--schema", "plan")[0] == 2


def test_recover(tmp_path, capsys):
    whole = write(tmp_path / "a.mcap")
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole.read_bytes()[: LogReader(whole).index.chunks[6].offset + 10])
    code, text = call(capsys, "info", cut)
    assert code == 0 and "not finished by its recorder" in text
    code, text = call(capsys, "recover", cut, "-o", out, "--json")
    assert code == 0 and json.loads(text)["damaged"] == 0
    before = [(m.source, m.sequence, m.sent_ns, m.record) for m in LogReader(cut).messages(order="file")]
    reader = LogReader(out)
    assert reader.index.complete and 10 < len(before) < 67
    assert [(m.source, m.sequence, m.sent_ns, m.record) for m in reader.messages(order="file")] == before
    assert reader.graph == GRAPH and reader.versions == {"numpy": "9"}
    code, text = call(capsys, "recover", cut, "-o", out)
    assert code == 2 and "exists already" in text


def test_recover_leaves_out_a_damaged_chunk(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    chunks = LogReader(path).index.chunks
    data = bytearray(path.read_bytes())
    data[chunks[1].offset + chunks[1].length - 3] ^= 0xFF
    path.write_bytes(data)
    assert call(capsys, "hash", path)[0] == 2
    code, text = call(capsys, "recover", path, "-o", tmp_path / "out.mcap")
    assert code == 0 and "1 damaged records left out" in text
    reader = LogReader(tmp_path / "out.mcap")
    assert 50 < reader.message_count < 67
    assert call(capsys, "hash", tmp_path / "out.mcap")[0] == 0


def test_hash_is_of_what_happened(tmp_path, capsys):
    """Not of wall times, log lines or the size of chunks."""
    a, b = write(tmp_path / "a.mcap"), write(tmp_path / "b.mcap", wall=5, chunk_bytes=900)
    c = write(tmp_path / "c.mcap", nudge=1e-6)
    hashes = [json.loads(call(capsys, "hash", path, "--json", "--per-topic")[1]) for path in (a, b, c)]
    assert hashes[0] == hashes[1]
    assert hashes[0]["hash"] != hashes[2]["hash"]
    changed = {t for t, digest in hashes[0]["topics"].items() if digest != hashes[2]["topics"][t]}
    assert changed == {"plans"} and set(hashes[0]["topics"]) == {"agents", "clock", "plans"}
    only = call(capsys, "hash", c, "--topics", "agents,clock")[1]
    assert only == call(capsys, "hash", a, "--topics", "agents,clock")[1] and len(only.strip()) == 64


def test_diff(tmp_path, capsys):
    a, b = write(tmp_path / "a.mcap"), write(tmp_path / "b.mcap", wall=5)
    assert call(capsys, "diff", a, b) == (0, "same: 66 messages on 3 topics\n")
    c = write(tmp_path / "c.mcap", nudge=0.5, ticks=29)
    code, text = call(capsys, "diff", a, c)
    assert code == 1
    assert "plans: message 2 at 1.000 s: positions[1, 0, 7, 0]: 0.0 and 0.5" in text
    assert "agents: 30 and 29 messages" in text
    code, text = call(capsys, "diff", a, c, "--topics", "plans", "--json")
    row = json.loads(text)["topics"][0]
    assert row["first"] == {
        "message": 2,
        "time": 1.0,
        "field": "positions",
        "index": [1, 0, 7, 0],
        "values": [0.0, 0.5],
    }
    tolerances = ["--tolerance", "positions=0.5", "--ignore", "headings"]
    assert call(capsys, "diff", a, c, "--topics", "plans", *tolerances)[0] == 0
    assert call(capsys, "diff", a, c, "--tolerance", "positions")[0] == 2
    assert call(capsys, "diff", a, c, "--topics", "plants")[0] == 2


def test_export_agents_as_csv(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    assert call(capsys, "export", path, "--topics", "agents", "-o", tmp_path / "agents.csv")[0] == 0
    with (tmp_path / "agents.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60 and set(STATE_COLUMNS) <= set(rows[0])
    assert (float(rows[41]["x"]), rows[41]["id"], rows[41]["group"]) == (20.0, "8", "2")
    assert float(rows[41]["time"]) == pytest.approx(2.0)


def test_export_every_topic(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    code, text = call(capsys, "export", path, "--format", "npz", "-o", tmp_path / "out", "--json")
    assert code == 0 and set(json.loads(text)) == {"agents", "clock", "plans", "log"}
    arrays = np.load(tmp_path / "out" / "agents.npz")
    assert arrays["history"].shape == (30, 2, 31, 7) and arrays["stamp_ns"][3] == 3 * TICK_NS
    code, text = call(capsys, "export", path, "--topics", "clock", "--format", "jsonl", "-o", "-")
    lines = [json.loads(line) for line in text.splitlines()]
    assert lines[4]["message"]["step"] == 4 and lines[4]["publisher"] == "simulator"


def test_arrays_of_changing_length(tmp_path, capsys):
    with LogWriter(tmp_path / "a.mcap") as writer:
        for k in range(3):
            ids = np.arange(k, dtype=np.int32)
            writer.write_message(
                AGENTS, "s", k, k, k, AgentStates(ids, ids, np.full((k, 31, 7), k, np.float32))
            )
    assert call(capsys, "export", tmp_path / "a.mcap", "--format", "npz", "-o", tmp_path)[0] == 0
    arrays = np.load(tmp_path / "agents.npz")
    assert arrays["ids"].tolist() == [0, 0, 1] and arrays["ids.lengths"].tolist() == [0, 1, 2]
    assert arrays["history"].shape == (3, 31, 7)


def test_too_wide_for_csv(tmp_path, capsys, monkeypatch):
    path, old = write(tmp_path / "a.mcap"), tmp_path / "plans.csv"
    monkeypatch.setattr(log_export, "MAX_COLUMNS", 20)
    old.write_text("old")
    code, text = call(capsys, "export", path, "--topics", "plans", "-o", old)
    assert code == 2 and "use --format npz" in text
    assert old.read_text() == "old" and sorted(tmp_path.iterdir()) == [path, old]
    code, text = call(capsys, "export", path, "-o", tmp_path / "all", "--json")  # all others are written
    assert code == 0 and set(json.loads(text)) == {"agents", "clock", "log"}
    assert {p.stem for p in (tmp_path / "all").iterdir()} == {"agents", "clock", "log"}


@pytest.mark.parametrize("verb", ["info", "hash", "export", "recover", "diff"])
def test_bad_files_are_one_line_and_exit_2(tmp_path, capsys, verb):
    (tmp_path / "a.mcap").write_text("hello")
    more = {"diff": [tmp_path / "a.mcap"]}.get(
        verb, [] if verb in ("info", "hash") else ["-o", tmp_path / "b.mcap"]
    )
    for path, reason in ((tmp_path / "a.mcap", "is not an MCAP file"), (tmp_path / "no.mcap", "no such log")):
        code, text = call(capsys, verb, path, *more)
        assert code == 2 and reason in text and text.count("\n") == 1


def test_unknown_topic_names_the_nearest(tmp_path, capsys):
    path = write(tmp_path / "a.mcap")
    code, text = call(capsys, "hash", path, "--topics", "agentz")
    assert code == 2 and "did you mean 'agents'?" in text
    assert SCORE.name not in LogReader(path).topics
