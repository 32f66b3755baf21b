"""What a browser does changes nothing for the graph: one that stops reading, and a window that is killed."""

import base64
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import viser

from footfall.launch.running import find_graph
from footfall.messages.log import LogReader
from footfall.messages.topics import DIAGNOSTICS, PARAMETERS
from footfall.tools.log_hash import deterministic_topics, hash_log
from footfall.tools.observe import observer, stream

pytestmark = pytest.mark.slow


def launch(folder: Path, name: str, *more: str, seed: int = 0) -> tuple[subprocess.Popen, Path]:
    """Five simulated seconds in lockstep, recorded."""
    log = folder / f"{name}.mcap"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "footfall.tools.cli", "launch", "corridor", "--set", "count=4"),
            *("--duration", "5", "--seed", str(seed), "--record", str(log)),
            *("--run-dir", str(folder / name), *more),
        ],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    return process, log


def stalled_browser(url: str) -> socket.socket:
    """A web socket that is opened and never read; its buffer is as small as the system allows."""
    host, port = re.fullmatch(r"http://(.+):(\d+)", url).groups()  # type: ignore[union-attr]
    deadline = time.monotonic() + 90
    while True:  # the address is told before the window is there
        line = socket.socket()
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        try:
            line.connect((host, int(port)))
            break
        except OSError:
            line.close()
            assert time.monotonic() < deadline
            time.sleep(0.2)
    key = base64.b64encode(os.urandom(16)).decode()
    line.sendall(
        f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
    )
    assert line.recv(12) == b"HTTP/1.1 101"
    return line


def drawing_viewer(run_dir: str) -> int:
    """The viewer's process, once it has drawn for the browser that does not read them."""
    bus = observer(find_graph(run_dir), [DIAGNOSTICS.name])
    try:
        for received in stream(bus, 90.0):
            if received.message.node == "viewer" and received.message.steps >= 2:
                return received.message.pid
    finally:
        bus.close()
    raise AssertionError("the viewer does not draw")


def what_happened(log: Path) -> str:
    """A hash of all that is the same in two runs of one seed, but for the nodes' own settings."""
    reader = LogReader(log)
    return hash_log(reader, [name for name in deterministic_topics(reader) if name != PARAMETERS.name])[0]


def test_neither_a_stalled_browser_nor_a_killed_window_changes_the_run(tmp_path):
    alone, log = launch(tmp_path, "alone")
    assert alone.communicate(timeout=200) is not None and alone.returncode == 0
    watched, seen = launch(tmp_path, "watched", "--view", "0", "--rate", "0.25")
    assert watched.stdout is not None
    url = next(match[1] for line in watched.stdout if (match := re.search(r"open (http\S+)", line)))
    browser = stalled_browser(url)
    os.kill(drawing_viewer(str(tmp_path / "watched")), signal.SIGKILL)
    assert watched.poll() is None
    watched.communicate(timeout=200)
    browser.close()
    assert LogReader(seen).span_ns[1] == pytest.approx(5e9, abs=0.2e9)  # and the run went on to its end
    assert what_happened(log) == what_happened(seen)
    other, another = launch(tmp_path, "other", seed=1)
    other.communicate(timeout=200)
    assert what_happened(another) != what_happened(log)  # what equal means
