import errno
import os
import subprocess
import sys
from pathlib import Path
from time import monotonic

import numpy as np
import pytest
from mcap.reader import make_reader

from footfall.messages.clock import Clock
from footfall.messages.log import DiskFullError, LogError, LogReader, LogWriter
from footfall.messages.map import SemanticMap
from footfall.messages.topics import CLOCK, MAP

RNG = np.random.default_rng(0)


def noise_map() -> SemanticMap:
    """Some 10 kB that do not compress."""
    return SemanticMap("noise", ["x"], RNG.integers(0, 255, (1, 100, 100), np.uint8), 1.0, (0.0, 0.0))


def fill(writer: LogWriter, count: int) -> None:
    for n in range(count):
        writer.write_message(CLOCK, "simulator", n, n, n, Clock(n, 1, "free"))
        writer.write_message(MAP, "map_server", n, n, n, noise_map())


def independent_count(path: Path) -> int:
    """Messages by the reference reader, checksums checked."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())


def test_tick_closes_a_chunk_after_the_flush_period(tmp_path):
    writer = LogWriter(tmp_path / "a.mcap", flush_period=1.0)
    fill(writer, 1)
    writer.tick(monotonic() + 0.5)
    assert LogReader(writer.path).message_count == 0
    writer.tick(monotonic() + 1.5)
    assert LogReader(writer.path).message_count == 2  # though nobody has closed the file
    writer.close()
    assert independent_count(writer.path) == 2


def test_large_messages_get_chunks_of_their_own(tmp_path):
    with LogWriter(tmp_path / "a.mcap", chunk_bytes=1000) as writer:
        fill(writer, 5)
    assert [c.end_ns for c in LogReader(tmp_path / "a.mcap").index.chunks] == [0, 1, 2, 3, 4]


def test_closing_twice_is_harmless(tmp_path):
    writer = LogWriter(tmp_path / "a.mcap")
    writer.close()
    size = writer.path.stat().st_size
    writer.close()
    assert writer.path.stat().st_size == size
    assert independent_count(writer.path) == 0


def test_a_closed_log_takes_no_more(tmp_path):
    writer = LogWriter(tmp_path / "a.mcap")
    writer.close()
    with pytest.raises(LogError, match="is closed"):
        fill(writer, 1)


def test_no_room_to_begin(tmp_path):
    with pytest.raises(LogError, match="cannot be written: the quota of 10 bytes is reached"):
        LogWriter(tmp_path / "a.mcap", quota=10)


def test_quota_stops_with_a_finished_file(tmp_path):
    writer = LogWriter(tmp_path / "a.mcap", chunk_bytes=20_000, quota=100_000)
    with pytest.raises(DiskFullError, match="the quota of 100000 bytes is reached; recording has stopped"):
        fill(writer, 100)
    reader = LogReader(writer.path)
    assert reader.index.complete
    assert reader.message_count == writer.messages == independent_count(writer.path)
    assert 60_000 < writer.path.stat().st_size < 110_000


@pytest.mark.parametrize("room", [0, 300, 3_000, 40_000])
def test_full_disk_injected(tmp_path, monkeypatch, room):
    """The disk takes `room` more bytes from some point on, the last write only in part."""
    writer = LogWriter(tmp_path / "a.mcap", chunk_bytes=20_000)
    fill(writer, 10)
    writer.flush()
    good, limit = writer.messages, writer.path.stat().st_size + room
    real_write = os.write

    def short_of_room(file: int, data: memoryview) -> int:
        left = limit - os.lseek(file, 0, os.SEEK_CUR)
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real_write(file, data[:left])

    monkeypatch.setattr(os, "write", short_of_room)
    with pytest.raises(DiskFullError, match="No space left on device; recording has stopped") as error:
        fill(writer, 100)
    monkeypatch.undo()
    reader = LogReader(writer.path)
    assert reader.index.complete  # a chunk was given up where the summary had no room
    count = independent_count(writer.path)
    assert reader.message_count == count == writer.messages
    assert good - 4 <= count <= good + 10
    assert sum(error.value.given_up.values()) > 0
    assert f"the {count} messages" in str(error.value)


FILL = """
import resource, sys
from footfall.messages.log import DiskFullError, LogWriter
sys.path.insert(0, {folder!r})
from test_log_writer import fill
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
writer = LogWriter({path!r}, chunk_bytes=30_000)
try:
    fill(writer, 200)
except DiskFullError as error:
    print(error)
    sys.exit(7)
"""


def test_full_disk_for_real(tmp_path):
    """The kernel refuses to let the file grow (RLIMIT_FSIZE)."""
    path = tmp_path / "a.mcap"
    script = FILL.format(folder=str(Path(__file__).parent), path=str(path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 7, done.stderr
    assert "File too large; recording has stopped" in done.stdout
    reader = LogReader(path)
    assert reader.index.complete and path.stat().st_size <= 300_000
    assert reader.message_count == independent_count(path) > 40


def test_writing_keeps_up_with_a_crowd(tmp_path):
    """Thirty people's joint states at 30 Hz make 1.1 MB/s; well over ten times that must pass."""
    from footfall.messages.body import BodyStates
    from footfall.messages.topics import BODY_STATES

    joints = RNG.normal(size=(30, 24, 13)).astype(np.float32)
    message = BodyStates(np.arange(30, dtype=np.int32), joints)
    with LogWriter(tmp_path / "a.mcap") as writer:
        begin = monotonic()
        for n in range(900):
            writer.write_message(BODY_STATES, "simulator", n, n, n, message)
        elapsed = monotonic() - begin
    assert elapsed < 3.0  # 30 s of simulation
