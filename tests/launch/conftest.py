"""A little graph in real processes, and a way to find all that they leave behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from footfall.launch.running import find_graph

LITTLE = Path(__file__).parent / "little"


class Launched:
    """`footfall launch` as a process of its own, in a session of its own."""

    def __init__(
        self, arguments: tuple[str, ...], env: dict[str, str], cwd: Path, before: tuple[str, ...] = ()
    ) -> None:
        self.mark = uuid.uuid4().hex
        self.process = subprocess.Popen(
            [*before, sys.executable, "-m", "footfall.tools.cli", "launch", *arguments],
            cwd=cwd,
            env={**os.environ, **env, "FOOTFALL_TEST_MARK": self.mark},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def survivors(self) -> dict[int, str]:
        """Processes that have this run's mark in their environment, whoever their parent is."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes():
                    words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    if words:  # zombies have none
                        found[int(folder.name)] = words
            except OSError:
                continue
        return found

    def wait_for(self, word: str, count: int = 1, timeout: float = 20.0) -> list[int]:
        """Ids of processes with `word` in their command line, once there are `count`."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            found = [pid for pid, words in self.survivors().items() if word in words]
            if len(found) >= count:
                return found
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.01)
        raise AssertionError(f"no {count} processes with {word!r}: {self.survivors()}")

    def wait_until_running(self) -> None:
        """Wait until the graph ticks: every node has reported."""
        logs = Path(find_graph().run_dir) / "log"
        wait_until(lambda: len(list(logs.glob("*.jsonl"))) > 0)
        time.sleep(1.5)

    def gone_within(self, seconds: float) -> float:
        """Wait until nothing is left; returns how long that took."""
        begin = time.monotonic()
        while left := self.survivors():
            assert time.monotonic() - begin < seconds, f"still there after {seconds} s: {left}"
            time.sleep(0.02)
        return time.monotonic() - begin

    def finish(self, timeout: float = 40.0) -> tuple[int, str, str]:
        """Exit code, stdout, stderr."""
        out, err = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, err

    def summary(self, timeout: float = 40.0) -> dict:
        """The JSON object in the last line of stdout."""
        code, out, err = self.finish(timeout)
        assert out.strip(), (code, err)
        return json.loads(out.strip().splitlines()[-1])


@pytest.fixture
def runs_home(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A place for run directories with a short path."""
    home = tempfile.mkdtemp(prefix="ff")
    monkeypatch.setenv("XDG_RUNTIME_DIR", home)
    yield Path(home)
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture
def launch(runs_home: Path) -> Iterator[Callable[..., Launched]]:
    """Start `footfall launch`; whatever it leaves is killed after the test."""
    started: list[Launched] = []

    def start(
        *arguments: str,
        env: dict[str, str] | None = None,
        cwd: Path = LITTLE,
        before: tuple[str, ...] = (),
    ) -> Launched:
        started.append(Launched(arguments, env or {}, cwd, before))
        return started[-1]

    yield start
    for one in started:
        for pid in one.survivors():
            os.kill(pid, signal.SIGKILL)
        one.process.communicate()


def wait_until(condition: Callable[[], bool], timeout: float = 20.0) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)
