"""The front-end: quick help, near matches, errors in one line, quiet pipes."""

import argparse
import subprocess
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path

import pytest

from footfall.messages.bus import BusError, PortError
from footfall.messages.config import ConfigError
from footfall.tools import cli

CLI = [sys.executable, "-m", "footfall.tools.cli"]


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    times = []
    shown = ""
    for _ in range(3):
        begin = time.perf_counter()
        shown = subprocess.run([*CLI, "--help"], capture_output=True, text=True, check=True).stdout
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.3
    assert all(verb in shown for verb in cli.VERBS)
    script = (
        "import sys, footfall.tools.cli as c\ntry: c.main(['--help'])\nexcept SystemExit: pass\n"
        "print([m for m in sys.modules if m in ('numpy', 'zmq', 'yaml', 'msgspec')])"
    )
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("verb", sorted(cli.VERBS))
def test_every_verb_has_a_module_with_a_parser(verb: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main([*verb.split(), "--help"])
    assert caught.value.code == 0
    assert f"usage: footfall {verb}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["lunch"], "no command 'lunch'; did you mean 'launch'?"),
        (["import", "bwi"], "no command 'import bwi'; did you mean 'biwi'?"),
        (["launch", "crossing", "--duratoin", "3"], "unrecognized arguments: --duratoin"),
        (["launch", "crosing"], "no launch file or scene 'crosing'; did you mean 'crossing'?"),
        (["launch"], "which launch file or scene? shipped are"),
        (["launch", "crossing", "--set", "x"], "--set x: must be ARGUMENT=VALUE or NODE.KEY=VALUE"),
        (["launch", "crossing", "--set", "scen=x"], "no argument 'scen'; did you mean 'scene'?"),
        (["launch", "crossing", "--set", "scene=["], "the value is not valid YAML"),
        (["launch", "crossing", "--rate", "0"], "--rate 0: must be above 0"),
        (["graph", "gone.yaml"], "no launch file or scene folder gone.yaml"),
    ],
)
def test_users_errors_are_one_line(words: list[str], sentence: str, capsys: pytest.CaptureFixture) -> None:
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("footfall: error: ")
    assert sentence in err
    assert err.count("\n") == 1


def test_groups_and_nothing_show_help(capsys: pytest.CaptureFixture) -> None:
    assert cli.main([]) == 2
    assert "launch" in capsys.readouterr().out
    assert cli.main(["import"]) == 2
    shown = capsys.readouterr().out
    assert "import biwi" in shown
    assert "launch a" not in shown
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("footfall 0.")


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Makes `footfall doctor` raise."""

    def fail_with(error: BaseException) -> None:
        module = types.ModuleType("footfall.tools.failing")

        def run(args: argparse.Namespace) -> int:
            raise error

        module.__dict__.update(add_parser=lambda sub: sub.add_parser("doctor"), run=run)
        monkeypatch.setitem(sys.modules, "footfall.tools.failing", module)
        monkeypatch.setitem(cli.VERBS, "doctor", ("failing", ""))

    return fail_with


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ConfigError("a: b\n  c"), "a: b c"),
        (PortError("no socket"), "no socket"),
        (FileNotFoundError(2, "No such file or directory", "x.mcap"), "x.mcap: No such file or directory"),
        (PermissionError(13, "Permission denied", "/root/x"), "/root/x: Permission denied"),
    ],
)
def test_faults_of_the_user_give_two(failing: Callable, error: Exception, text: str, capsys) -> None:
    failing(error)
    assert cli.main(["doctor"]) == 2
    assert capsys.readouterr().err == f"footfall: error: {text}\n"
    with pytest.raises(type(error)):
        cli.main(["doctor", "--traceback"])


def test_what_fails_says_why_and_gives_one(failing: Callable, capsys: pytest.CaptureFixture) -> None:
    failing(BusError("nobody reads"))
    assert cli.main(["doctor"]) == 1
    assert capsys.readouterr().err == "footfall: error: nobody reads\n"


def test_faults_of_the_program_are_not_hidden(failing: Callable) -> None:
    for error in (ValueError("a bug"), KeyError("x"), FileNotFoundError("no name")):
        failing(error)
        with pytest.raises(type(error)):
            cli.main(["doctor"])


def test_interrupt_gives_130(failing: Callable) -> None:
    failing(KeyboardInterrupt())
    assert cli.main(["doctor"]) == 130


def test_closed_pipe_is_quiet(tmp_path: Path) -> None:
    done = subprocess.run(
        f"{sys.executable} -m footfall.tools.cli launch --schema | head -1",
        shell=True,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "{\n"
    assert done.stderr == ""
