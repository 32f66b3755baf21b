import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep

import pytest

from footfall.messages.link import Link, Reply, Request
from footfall.messages.log import LogReader
from footfall.messages.topics import AGENTS, CLOCK, MAP, SCORE

pytestmark = pytest.mark.slow


def stamps(path: Path) -> list[float]:
    """Ticks in the order of sending [s]."""
    reader = LogReader(path)
    wanted = ["clock"] if "clock" in reader.topics else []
    ticks = [m for m in reader.messages(wanted, order="sent") if not m.message.paused]
    return [round(m.stamp_ns * 1e-9, 3) for m in ticks]


def test_rate_max_loses_nothing_and_is_fast(tiny_run):
    facts = tiny_run.json("replay", tiny_run.log, "--rate", "max")
    assert facts["lossless"] and facts["lost"] == {} and facts["first_failure"] is None
    assert facts["sent"] == {"agents": 121, "clock": 361, "map": 1, "score": 122}
    assert facts["delivered"] == {"sink": facts["sent"]}
    assert facts["sim_seconds"] == pytest.approx(12.0)
    assert facts["real_time_factor"] > 10


def test_what_is_played_is_what_was_recorded(tiny_run, tmp_path):
    again = tmp_path / "again.mcap"
    tiny_run.json("replay", tiny_run.log, "--rate", "max", "--record", again)
    before, after = LogReader(tiny_run.log), LogReader(again)
    for topic in (AGENTS, SCORE, MAP):
        old, new = list(before.read(topic)), list(after.read(topic))
        assert [(m.stamp_ns, m.record) for m in old] == [(m.stamp_ns, m.record) for m in new]
        assert {m.publisher for m in new} == {"player"}
    diff = tiny_run.json("log", "diff", tiny_run.log, again, "--topics", "agents,score,map,clock")
    assert diff["same"]


def test_a_live_node_does_the_same_again(tiny_run, tmp_path):
    """Only the walker is played; in lockstep the live keeper gives exactly what was recorded."""
    again = tmp_path / "again.mcap"
    options = ["--rate", "max", "--replace", "walker", "--record", again]
    facts = tiny_run.json("replay", tiny_run.log, *options)
    assert facts["lossless"] and facts["delivered"]["keeper"]["agents"] == 121
    old, new = (list(LogReader(path).read(SCORE)) for path in (tiny_run.log, again))
    assert [(m.stamp_ns, m.record) for m in old] == [(m.stamp_ns, m.record) for m in new]
    assert {m.publisher for m in new} == {"keeper"}


def test_another_launch_file(tiny_run, tmp_path):
    text = (tiny_run.folder / "yard.yaml").read_text()
    (tiny_run.folder / "other.yaml").write_text(text.replace("gain: 2.0", "gain: 4.0"))
    again = tmp_path / "again.mcap"
    options = ["--launch", "other.yaml", "--replace", "walker", "--rate", "max", "--record", again]
    tiny_run.json("replay", tiny_run.log, *options)
    old, new = (list(LogReader(path).read(SCORE))[-1].message for path in (tiny_run.log, again))
    assert new.agent_seconds == pytest.approx(2 * old.agent_seconds)


def test_start_duration_rate_and_selection(tiny_run, tmp_path):
    again = tmp_path / "again.mcap"
    options = ["--start", "6", "--duration", "2", "--rate", "2", "--topics", "map,agents", "--record", again]
    facts = tiny_run.json("replay", tiny_run.log, *options)
    assert facts["sent"] == {"agents": 20, "clock": 60, "map": 1}
    assert facts["wall_seconds"] == pytest.approx(1.0, abs=0.3)
    reader = LogReader(again)
    assert stamps(again)[0] == 6.0 and stamps(again)[-1] == pytest.approx(7.967)
    assert [m.stamp_ns for m in reader.read(MAP)] == [0]  # latched, from before the start
    assert min(m.stamp_ns for m in reader.read(AGENTS)) == 6_000_000_000


def test_remap(tiny_run, tmp_path):
    (tiny_run.folder / "own.py").write_text(
        "from footfall.messages.agents import AgentStates\n"
        "from footfall.messages.topics import Topic\n"
        'GHOSTS = Topic("ghosts", AgentStates)\n'
    )
    text = (tiny_run.folder / "yard.yaml").read_text()
    (tiny_run.folder / "ghosts.yaml").write_text(text + "topics: {ghosts: 'own:GHOSTS'}\n")
    options = ["--launch", "ghosts.yaml", "--remap", "agents:=ghosts", "--rate", "max"]
    facts = tiny_run.json("replay", tiny_run.log, *options)
    assert facts["delivered"]["sink"]["ghosts"] == 121 and "agents" not in facts["sent"]


def test_an_unfinished_log_is_played_unasked(tiny_run, tmp_path):
    cut = tmp_path / "cut.mcap"
    index = LogReader(tiny_run.log).index
    place = index.chunks[-1]
    cut.write_bytes(tiny_run.log.read_bytes()[: place.offset + place.length])
    facts = tiny_run.json("replay", cut, "--rate", "max")
    assert facts["lossless"] and facts["sent"]["agents"] > 0


def test_users_errors(tiny_run, tmp_path):
    def error(*arguments: object) -> str:
        done = tiny_run.footfall("replay", *arguments)
        assert done.returncode == 2, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stderr

    log = tiny_run.log
    assert "no such log" in error(tmp_path / "no.mcap")
    assert "nothing of a node 'walkr'; did you mean 'walker'?" in error(log, "--replace", "walkr")
    assert "walker would run live and own the clock" in error(log, "--replace", "keeper")
    assert "has no topic 'agent'; did you mean 'agents'?" in error(log, "--exclude", "agent")
    assert "keeper listens to 'agents'" in error(log, "--replace", "walker", "--exclude", "agents")
    assert "must be OLD:=NEW" in error(log, "--remap", "agents")
    assert "--rate" in error(log, "--rate", "fast")
    assert "nothing to play there; it goes from 0 to 12 s" in error(log, "--start", "99")


class Session:
    """A replay under way, and the line to its launcher."""

    def __init__(self, tiny_run, folder: Path, *options: object) -> None:
        self.log = folder / "again.mcap"
        run_dir = folder / "run"
        arguments = ["replay", tiny_run.log, "--run-dir", run_dir, "--record", self.log, "--json", *options]
        self.process = subprocess.Popen(
            tiny_run.command(*arguments), cwd=tiny_run.folder, stdout=subprocess.PIPE, text=True
        )
        deadline = monotonic() + 20
        while not (run_dir / "launcher").exists() and monotonic() < deadline:
            sleep(0.05)
        self.link = Link(str(run_dir), "test")

    def control(self, name: str, value: float | None = None, wait: float = 0.4) -> None:
        self.link.send(Request("control", "player", name, value))
        reply = self.link.receive(15)
        assert reply == Reply()
        sleep(wait)

    def finish(self) -> dict:
        assert self.process.stdout
        out = self.process.stdout.read()
        assert self.process.wait(30) == 0
        return json.loads(out.splitlines()[-1])

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(20)
        assert self.process.stdout
        self.process.stdout.close()
        self.link.close()


@pytest.fixture
def session(tiny_run, tmp_path, request) -> Iterator[Session]:
    session = Session(tiny_run, tmp_path, *request.param)
    yield session
    session.close()


def wait_for(session: Session, ready, timeout: float = 20.0) -> None:
    """Until the growing log says so."""
    deadline = monotonic() + timeout
    while monotonic() < deadline:
        if session.log.exists() and session.log.stat().st_size and ready(stamps(session.log)):
            return
        sleep(0.2)
    raise AssertionError("the replay did not get there")


@pytest.mark.parametrize("session", [("--pause", "--rate", "4")], indirect=True)
def test_pause_step_seek_resume(session):
    wait_for(session, lambda ticks: ticks == [0.0])
    session.control("step")
    session.control("step")
    session.control("seek", 10.0)
    session.control("step")
    session.control("seek", 4.0)
    session.control("seek", 11.5)
    begin = monotonic()
    session.control("resume", wait=0)
    facts = session.finish()
    assert monotonic() - begin < 10
    ticks = stamps(session.log)
    assert ticks[:7] == [0.0, 0.033, 0.067, 10.0, 10.033, 4.0, 11.5]
    assert ticks[6:] == [round(k / 30, 3) for k in range(345, 361)]
    reader = LogReader(session.log)
    assert len(list(reader.read(MAP))) == 4  # at the start and after each seek
    assert facts["lossless"]
    scores = [round(m.stamp_ns * 1e-9, 2) for m in reader.messages(["score"], order="sent")]
    assert 9.9 in scores and 3.9 in scores  # the last before each seek


@pytest.mark.parametrize("session", [("--rate", "0.5")], indirect=True)
def test_rate_can_be_changed(session):
    wait_for(session, lambda ticks: len(ticks) > 5)
    session.control("rate", 1000.0, wait=0)
    facts = session.finish()
    assert facts["lossless"] and facts["sent"]["clock"] == 361 and facts["wall_seconds"] < 15


@pytest.mark.parametrize(
    "session",
    [("--loop", "--start", "9", "--duration", "0.5", "--rate", "5", "--topics", "map,agents")],
    indirect=True,
)
def test_loop_jumps_back_and_repeats_latched_messages(session):
    wait_for(session, lambda ticks: len(ticks) > 45)
    session.process.terminate()
    session.process.wait(20)
    ticks = stamps(session.log)
    one = [round(k / 30, 3) for k in range(270, 285)]
    assert ticks[:45] == one * 3
    maps = len(list(LogReader(session.log).read(MAP)))
    assert maps >= 3 and len(list(LogReader(session.log).read(CLOCK))) >= 45
