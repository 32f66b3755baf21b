"""Runs of real processes: the barrier, the end, failures, restarts, summaries."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from footfall.launch.run_dir import all_runs
from footfall.launch.running import find_graph
from footfall.messages.config import ConfigError
from footfall.messages.link import Link, Reply, Request

pytestmark = pytest.mark.slow
LITTLE = "little.yaml"


def test_summary_counts_every_message(launch: Callable) -> None:
    run = launch(LITTLE, "--duration", "2", "--json")
    summary = run.summary()
    assert run.process.returncode == 0
    assert summary["sim_seconds"] == 2.0
    assert summary["ended"] == "2 s simulated"
    assert (summary["dropped"], summary["first_failure"], summary["restarts"]) == (0, None, {})
    beat = summary["topics"]["beat"]
    assert beat["sent"] == 61  # 30 Hz, both ends
    assert beat["received"] == {"echoer": 61}
    assert summary["topics"]["echo"]["received"] == {"ticker": 61}
    assert summary["real_time_factor"] == pytest.approx(2.0 / summary["wall_seconds"])
    assert run.gone_within(1.0) < 1.0


def test_realtime_keeps_the_wall_clock(launch: Callable) -> None:
    summary = launch(LITTLE, "--duration", "2", "--mode", "realtime", "--rate", "2", "--json").summary()
    assert summary["wall_seconds"] == pytest.approx(1.0, abs=0.3)


def test_every_node_has_its_log_and_the_logs_stay(launch: Callable) -> None:
    code, _, err = launch(LITTLE, "--duration", "1", "--set", "at=5", "--set", "how=warn").finish()
    assert code == 0
    assert "[echoer] warning: an odd beat" in err
    run = all_runs()[-1]
    assert "an odd beat" in run.log_of("echoer").read_text()
    assert not run.alive
    assert run.path.stat().st_mode & 0o777 == 0o700
    assert not [path for path in run.path.iterdir() if path.is_socket()]


@pytest.mark.parametrize(
    ("how", "reason", "ended"),
    [
        ("raise", "RuntimeError: the echo is gone", "exit code 1"),
        ("exit", "out of here", "exit code 7"),
        ("segv", "Fatal Python error: Segmentation fault", "killed by SIGSEGV"),
    ],
)
def test_first_failure_is_named_and_all_stop(launch: Callable, how: str, reason: str, ended: str) -> None:
    run = launch(LITTLE, "--mode", "realtime", "--json", "--set", "at=10", "--set", f"how={how}")
    summary = run.summary()
    assert run.process.returncode == 1
    assert summary["first_failure"] == {"node": "echoer", "reason": reason, "ended": ended, "usage": False}
    run.gone_within(1.0)


def test_required_death_stops_the_graph_within_three_seconds(launch: Callable) -> None:
    run = launch(LITTLE, "--mode", "realtime", "--json")
    (pid,) = run.wait_for("-m echoer")
    time.sleep(0.5)
    begin = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    summary = run.summary()
    assert time.monotonic() - begin < 3.0
    assert summary["first_failure"]["node"] == "echoer"
    assert summary["first_failure"]["ended"] == "killed by SIGKILL"
    run.gone_within(1.0)


def test_restartable_node_is_back_and_counted(launch: Callable, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        f"include: [{Path(__file__).parent}/little/little.yaml]\n"
        "nodes: {echoer: {restart: {policy: on-failure, backoff: 0.1}}}"
    )
    arguments = ("--mode", "realtime", "--duration", "4", "--set", "at=20", "--set", "how=exit")
    run = launch(str(own), *arguments, "--json")
    summary = run.summary()
    assert run.process.returncode == 0
    assert summary["restarts"] == {"echoer": 1}
    assert summary["first_failure"] is None
    echoed = summary["topics"]["echo"]["sent"]  # of the second life: the first ended before it could report
    away = (121 - 20 - echoed) / 30
    assert away < 2.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def test_restarts_are_limited(launch: Callable, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        f"include: [{Path(__file__).parent}/little/little.yaml]\n"
        "nodes: {echoer: {restart: {policy: always, max: 2, backoff: 0.01}, env: {DIE_AT_IMPORT: 1}}}"
    )
    run = launch(str(own), "--mode", "realtime", "--json")
    summary = run.summary()
    assert run.process.returncode == 1
    assert summary["restarts"] == {"echoer": 2}
    assert "dead on arrival" in summary["first_failure"]["reason"]


def test_others_go_on_without_an_optional_node_but_it_is_told(launch: Callable, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        f"include: [{Path(__file__).parent}/little/little.yaml]\n"
        "nodes: {listener: {module: echoer, inputs: [beat], outputs: {echo: echo2}, required: false,"
        " lockstep: false, config: {at: 10, how: raise}}}\n"
        'topics: {echo2: "beats:ECHO2"}'
    )
    run = launch(str(own), "--mode", "realtime", "--duration", "2", "--json")
    summary = run.summary()
    assert run.process.returncode == 1
    assert summary["sim_seconds"] == 2.0
    assert summary["first_failure"]["node"] == "listener"


def test_bad_configuration_is_the_users_fault(launch: Callable) -> None:
    code, _, err = launch(LITTLE, "--set", "echoer.hwo=1").finish()
    assert code == 2
    assert "unknown key 'hwo'; did you mean 'how'?" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_stop_cleanly(launch: Callable, number: signal.Signals) -> None:
    run = launch(LITTLE, "--mode", "realtime", "--json")
    run.wait_for("-m echoer")
    time.sleep(0.8)
    run.process.send_signal(number)
    summary = run.summary(timeout=5)
    assert run.process.returncode == 128 + number
    assert summary["ended"] == f"stopped by {number.name}"
    assert summary["first_failure"] is None
    run.gone_within(1.0)


def test_interrupt_before_the_start(launch: Callable) -> None:
    run = launch(LITTLE, env={"SLOW_IMPORT": "30"})
    run.wait_for("sleep")
    run.process.send_signal(signal.SIGINT)
    assert run.finish(timeout=6)[0] == 130
    run.gone_within(1.0)


def test_hanging_node_is_killed(launch: Callable) -> None:
    run = launch(LITTLE, "--mode", "realtime", "--set", "at=5", "--set", "how=hang")
    run.wait_for("-m echoer")
    time.sleep(1.0)
    begin = time.monotonic()
    run.process.send_signal(signal.SIGINT)
    assert run.finish(timeout=8)[0] == 130
    assert time.monotonic() - begin < 4.0
    run.gone_within(1.0)


def test_second_interrupt_skips_ahead(launch: Callable) -> None:
    run = launch(LITTLE, "--mode", "realtime", "--set", "at=5", "--set", "how=hang")
    run.wait_for("-m echoer")
    time.sleep(1.0)
    begin = time.monotonic()
    for _ in range(4):
        run.process.send_signal(signal.SIGINT)
        time.sleep(0.1)
    assert run.finish(timeout=8)[0] == 130
    assert time.monotonic() - begin < 1.6  # the stages take 1.6 s otherwise
    run.gone_within(1.0)


def test_who_is_still_writing_may_finish(launch: Callable, tmp_path: Path) -> None:
    written = tmp_path / "heard.txt"
    own = tmp_path / "own.yaml"
    own.write_text(
        f"include: [{Path(__file__).parent}/little/little.yaml]\n"
        "nodes: {scribe: {module: scribe, inputs: {beat: reliable}, required: false, lockstep: false,"
        f" config: {{path: {written}}}}}}}"
    )
    run = launch(str(own), "--mode", "realtime")
    run.wait_for("-m scribe")
    time.sleep(1.0)
    run.process.send_signal(signal.SIGINT)
    assert run.finish(timeout=12)[0] == 130
    assert len(written.read_text().splitlines()) == 30  # three seconds of writing


def test_running_graph_is_found_and_obeys(launch: Callable) -> None:
    with pytest.raises(ConfigError, match="no graph is running"):
        find_graph()
    run = launch(LITTLE, "--mode", "realtime", "--json")
    run.wait_for("-m echoer")
    time.sleep(0.8)
    graph = find_graph("little")
    assert find_graph().run_dir == find_graph(graph.run_dir).run_dir == graph.run_dir
    with pytest.raises(ConfigError, match="no graph 'litle' is running; did you mean 'little'"):
        find_graph("litle")
    link = Link(graph.run_dir, "test")
    try:
        link.send(Request("control", "ecoer", "log_level", "DEBUG"))
        assert link.receive(2.0) == Reply("no node 'ecoer'; did you mean 'echoer'?")
        for name, nonsense in (("log_level", "bogus"), ("step", "abc"), ("rate", "abc"), ("rate", -1)):
            link.send(Request("control", "*", name, nonsense))  # nobody ends of it
            assert link.receive(2.0) == Reply()
        time.sleep(0.5)
        link.send(Request("stop"))
        assert link.receive(2.0) == Reply()
    finally:
        link.close()
    assert run.summary()["ended"] == "stopped on request"
    assert run.process.returncode == 0


def test_run_directory_of_ones_own(launch: Callable, runs_home: Path) -> None:
    place = runs_home / "here"
    first = launch(LITTLE, "--mode", "realtime", "--run-dir", str(place))
    first.wait_for("-m echoer")
    assert find_graph().run_dir == str(place)
    second = launch(LITTLE, "--run-dir", str(place))
    code, _, err = second.finish()
    assert code == 2
    assert "another graph runs there" in err
    first.process.send_signal(signal.SIGINT)
    first.finish()
    deep = runs_home / ("d" * 90)
    code, _, err = launch(LITTLE, "--run-dir", str(deep)).finish()
    assert code == 2
    assert "longer than 107 bytes" in err
