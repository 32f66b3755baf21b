import shutil

import msgspec
import pytest

from footfall.messages.diagnostics import StepTrace
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.score import Score
from footfall.messages.topics import AGENTS, MAP, SCORE, STEPS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("node", ["walker", "keeper"])
def test_nothing_differs(tiny_run, node):
    """The owner of the clock, too."""
    facts = tiny_run.json("regress", tiny_run.log, "--node", node)
    assert facts["same"] and facts["first"] is None
    counts = {topic: (row["recorded"], row["now"]) for topic, row in facts["topics"].items()}
    expected = {"keeper": {"score": (122, 122)}, "walker": {"agents": (121, 121), "map": (1, 1)}}
    assert counts == expected[node]
    assert facts["steps"] == {"keeper": 121, "walker": 361}[node]


@pytest.fixture
def changed(tiny_run, tmp_path):
    """The same run, beside a keeper that counts otherwise from 5 s on."""
    run = type(tiny_run)(tmp_path)
    shutil.copy(tiny_run.log, run.log)
    source = (tmp_path / "keeper.py").read_text()
    line = "        return [score(len(inbox"
    assert line in source
    (tmp_path / "keeper.py").write_text(
        source.replace(line, f"        self.total += 1e-7 if inbox.now > 4.95 else 0.0\n{line}")
    )
    return run


def test_first_difference_is_named(changed):
    facts = changed.json("regress", changed.log, "--node", "keeper", code=1)
    first = facts["first"]
    assert (first["topic"], first["message"], first["field"]) == ("score", 51, "agent_seconds")
    assert first["time"] == pytest.approx(5.0) and first["index"] is None
    assert first["values"][1] - first["values"][0] == pytest.approx(1e-7)
    done = changed.footfall("regress", changed.log, "--node", "keeper")
    assert "score: message 51 at 5.000 s: agent_seconds: " in done.stdout


def test_tolerance_and_ignore(changed):
    assert changed.json("regress", changed.log, "--node", "keeper", "--tolerance", "agent_seconds=1e-4")[
        "same"
    ]
    assert changed.json("regress", changed.log, "--node", "keeper", "--ignore", "agent_seconds")["same"]


def test_update_writes_the_new_outputs(changed):
    new = changed.folder / "new.mcap"
    assert changed.footfall("regress", changed.log, "--node", "keeper", "--update", new).returncode == 0
    assert changed.json("regress", new, "--node", "keeper")["same"]
    assert changed.json("log", "diff", changed.log, new, code=1)["topics"]
    old_scores = list(LogReader(changed.log).read(SCORE))
    new_scores = list(LogReader(new).read(SCORE))
    assert [m.sequence for m in new_scores] == [m.sequence for m in old_scores]
    assert LogReader(new).message_count == LogReader(changed.log).message_count


def test_fewer_messages_are_a_difference(changed):
    source = (changed.folder / "keeper.py").read_text()
    line = "        for agents in"
    assert line in source
    silence = f"        if 7.95 < inbox.now < 8.05:\n            return []\n{line}"
    (changed.folder / "keeper.py").write_text(source.replace(line, silence))
    facts = changed.json("regress", changed.log, "--node", "keeper", "--ignore", "agent_seconds", code=1)
    assert facts["first"]["field"] == "number of messages of the step"
    assert facts["first"]["values"] == [1, 0] and facts["first"]["time"] == pytest.approx(8.0)
    assert facts["topics"]["score"] == {"recorded": 122, "now": 121}


def test_users_errors(tiny_run, tmp_path):
    def error(*arguments: object) -> str:
        done = tiny_run.footfall("regress", *arguments)
        assert done.returncode == 2, done.stdout + done.stderr
        return done.stderr

    assert "no node 'keepr'; did you mean 'keeper'?" in error(tiny_run.log, "--node", "keepr")
    assert "no such log" in error(tmp_path / "no.mcap", "--node", "keeper")
    assert "must be one" in error(tiny_run.log, "--node", "recorder")

    def copy(name: str, skip: str, number: int | None = None):
        """The log without a topic, or without one message of it."""
        reader, path = LogReader(tiny_run.log), tmp_path / name
        with LogWriter(path, reader.graph) as writer:
            for item in reader.messages(order="file"):
                if item.topic != skip or number not in (None, item.sequence):
                    writer.copy(item)
        return path

    assert "holds no steps of keeper" in error(copy("a.mcap", "steps"), "--node", "keeper")
    text = error(copy("b.mcap", "agents", 7), "--node", "keeper")
    assert "lacks message 7 of agents@walker, which step 7 of keeper took" in text


def test_a_restarted_node_begins_anew(tiny_run, tmp_path):
    """The second life's numbers start at 1 << 32; its sum starts at 0 again."""
    recorded = LogReader(tiny_run.log)
    agents = list(recorded.read(AGENTS))
    (place,) = recorded.read(MAP)

    def score(count: int, total: float) -> Score:
        return Score(count, count, 0, 0, total, 0.0, 0.0, 0)

    path = tmp_path / "lives.mcap"
    with LogWriter(path, recorded.graph) as writer:
        writer.copy(place)
        for life, (first, last) in enumerate([(10, 14), (20, 23)]):
            base, total = life << 32, 0.0
            writer.write_message(SCORE, "keeper", base, 0, 0, score(0, 0.0))
            for number, item in enumerate(agents[first:last]):
                writer.copy(item)
                total += 2.0 * float(item.message.now[:, 0].sum())
                writer.write_message(SCORE, "keeper", base + number + 1, item.stamp_ns, 0, score(2, total))
                consumed = {item.source: [item.sequence]}
                if number == 0:
                    consumed[place.source] = [place.sequence]
                trace = StepTrace("keeper", number, consumed, {"score": [base + number + 1]})
                writer.write_message(STEPS, "keeper", base + number, item.stamp_ns, 0, trace)
    facts = tiny_run.json("regress", path, "--node", "keeper")
    assert facts["same"] and facts["steps"] == 7
    assert facts["topics"] == {"score": {"recorded": 9, "now": 9}}


def test_the_graph_must_be_attached(tiny_run, tmp_path):
    reader = LogReader(tiny_run.log)
    with LogWriter(tmp_path / "a.mcap") as writer:
        for item in reader.messages(order="file"):
            writer.copy(item)
    done = tiny_run.footfall("regress", tmp_path / "a.mcap", "--node", "keeper")
    assert done.returncode == 2 and "no graph is attached" in done.stderr
    assert msgspec.json.encode(reader.graph)
