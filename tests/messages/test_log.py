import logging
from pathlib import Path

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from footfall.messages.clock import Clock
from footfall.messages.graph import Graph, NodeSpec
from footfall.messages.log import LogError, LogReader, LogWriter
from footfall.messages.log_index import read_chunk
from footfall.messages.map import SemanticMap
from footfall.messages.schema import schema_hash
from footfall.messages.score import Score
from footfall.messages.topics import CLOCK, MAP, SCORE, TOPICS, Topic

TICK_NS = 100_000_000
A_MAP = SemanticMap("yard", ["walkable"], np.ones((1, 90, 50), np.uint8), 0.1, (0.0, 0.0))


class Other(msgspec.Struct, frozen=True):
    text: str
    numbers: list[int] = []


def write_clock(writer: LogWriter, ticks: range, publisher: str = "simulator") -> None:
    for tick in ticks:
        message = Clock(tick, TICK_NS, "free")
        writer.write_message(CLOCK, publisher, tick, tick * TICK_NS, 1_000_000 + tick * 1000, message)


def write_sample(path: Path, ticks: int = 20, chunk_bytes: int = 300) -> Path:
    with LogWriter(path, Graph("yard", [NodeSpec("simulator", "x")], seed=7), chunk_bytes=chunk_bytes) as w:
        w.write_message(MAP, "map_server", 0, 0, 5, A_MAP)
        write_clock(w, range(ticks))
    return path


def test_round_trip_keeps_everything(tmp_path):
    reader = LogReader(write_sample(tmp_path / "a.mcap"))
    messages = list(reader.messages())
    assert [m.source for m in messages[:3]] == ["clock@simulator", "map@map_server", "clock@simulator"]
    assert [m.sequence for m in messages if m.topic == "clock"] == list(range(20))
    assert messages[2].stamp_ns == TICK_NS and messages[2].sent_ns == 1_001_000
    assert messages[2].message == Clock(1, TICK_NS, "free")
    np.testing.assert_array_equal(messages[1].message.raster, A_MAP.raster)
    assert reader.graph and reader.graph.seed == 7 and reader.graph.nodes[0].name == "simulator"
    assert reader.run["graph"] == "yard" and reader.run["seed"] == "7"
    assert reader.message_count == 21 and reader.span_ns == (0, 19 * TICK_NS)


def test_the_file_is_plain_mcap_with_plain_msgpack(tmp_path):
    """The reference MCAP reader and the reference msgpack library are the judges."""
    with write_sample(tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary and summary.statistics
        assert summary.statistics.message_count == 21
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 3
        assert {s.name: s.encoding for s in summary.schemas.values()} == {
            "SemanticMap": "jsonschema",
            "Clock": "jsonschema",
        }
        rows = list(reader.iter_messages())
        assert len(rows) == 21
        for _, channel, message in rows:
            body = msgpack.unpackb(message.data)
            if channel.topic == "clock":
                assert body["step"] == message.sequence and message.log_time == message.sequence * TICK_NS
                assert channel.metadata["schema"] == schema_hash(Clock).hex()
            else:
                assert body["raster"] == ["|u1", [1, 90, 50], bytes([1]) * 4500]
        assert [a.name for a in reader.iter_attachments()] == ["graph.json"]
        # and by its own indexes
        late = list(reader.iter_messages(topics=["clock"], starting_at=15 * TICK_NS))
        assert [m.sequence for _, _, m in late] == [15, 16, 17, 18, 19]


def test_a_second_life_keeps_its_sequence_numbers(tmp_path):
    second = 1 << 32
    with LogWriter(tmp_path / "a.mcap") as writer:
        for sequence in (0, 1, second, second + 1):
            writer.write_message(CLOCK, "simulator", sequence, sequence % 7, 0, Clock(0, 1, "free"))
    reader = LogReader(tmp_path / "a.mcap")
    assert [m.sequence for m in reader.messages(order="file")] == [0, 1, second, second + 1]
    assert [c.life for c in reader.channels] == [0, 1]


def test_orders(tmp_path):
    """Overlapping chunks, stamps and sendings in different orders: compared with plain sorting."""
    rng = np.random.default_rng(3)
    rows = []
    with LogWriter(tmp_path / "a.mcap", chunk_bytes=500) as writer:
        for i in range(200):
            publisher = "ab"[int(rng.integers(2))]
            row = (int(rng.integers(0, 12) + i // 20), publisher, i, i * 10 + int(rng.integers(0, 40)))
            rows.append(row)
            writer.write_message(CLOCK, publisher, i, row[0], row[3], Clock(i, 1, "free"))
    reader = LogReader(tmp_path / "a.mcap")
    assert len(reader.index.chunks) > 10

    def sequences(**options):
        return [m.sequence for m in reader.messages(**options)]

    assert sequences(order="file") == list(range(200))
    assert sequences() == [row[2] for row in sorted(rows)]
    sent = [m.sent_ns for m in reader.messages(order="sent")]
    assert sent == sorted(row[3] for row in rows)
    assert sequences(start_ns=5, end_ns=9) == [row[2] for row in sorted(rows) if 5 <= row[0] < 9]
    assert sequences(publisher="b", order="file") == [row[2] for row in rows if row[1] == "b"]


def test_selection_by_topic(tmp_path):
    reader = LogReader(write_sample(tmp_path / "a.mcap"))
    assert {m.topic for m in reader.messages(exclude=["clock"])} == {"map"}
    assert {m.topic for m in reader.messages(["clock"])} == {"clock"}
    with pytest.raises(LogError, match=r"has no topic 'clok'; did you mean 'clock'\?"):
        list(reader.messages(["clok"]))


def test_last_before_finds_latched_values(tmp_path):
    def score(n: int) -> Score:
        return Score(n, n, 0, 0, 0.0, 0.0, 0.0, 0)

    with LogWriter(tmp_path / "a.mcap", chunk_bytes=400) as writer:
        writer.write_message(MAP, "map_server", 0, 0, 0, A_MAP)
        for tick in range(50):
            write_clock(writer, range(tick, tick + 1))
            if tick % 10 == 0:
                writer.write_message(SCORE, "referee", tick // 10, tick * TICK_NS, 10 * tick, score(tick))
    reader = LogReader(tmp_path / "a.mcap")
    found = {m.source: m for m in reader.last_before(35 * TICK_NS)}
    assert set(found) == {"map@map_server", "score@referee", "clock@simulator"}
    assert found["score@referee"].message.entered == 30
    assert found["clock@simulator"].sequence == 34
    assert [m.source for m in reader.last_before(35 * TICK_NS, ["map"])] == ["map@map_server"]
    assert reader.last_before(0) == []


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04 a zip, perhaps", "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "ends before its first record is complete"),
    ],
)
def test_files_that_are_no_logs(tmp_path, content, reason):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason) as error:
        LogReader(path)
    assert str(path) in str(error.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(LogError, match="no such log"):
        LogReader(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="cannot be read: Is a directory"):
        LogReader(tmp_path)


def test_foreign_mcap(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "rosbag")
        writer.finish()
    with pytest.raises(LogError, match="profile 'ros2' written by 'rosbag'"):
        LogReader(tmp_path / "a.mcap")


def test_existing_log_is_not_overwritten_unasked(tmp_path):
    path = write_sample(tmp_path / "a.mcap")
    size = path.stat().st_size
    with pytest.raises(LogError, match="exists already"):
        LogWriter(path)
    assert path.stat().st_size == size
    LogWriter(path, overwrite=True).close()
    assert LogReader(path).message_count == 0


def test_unwritable_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match="cannot be written"):
        LogWriter(tmp_path / "file" / "a.mcap")


def test_negative_time_is_refused(tmp_path):
    with LogWriter(tmp_path / "a.mcap") as writer, pytest.raises(LogError, match="-1 ns < 0"):
        writer.write_message(CLOCK, "simulator", 0, -1, 0, Clock(0, 1, "free"))


def test_unknown_topic_and_other_schema_are_read_as_plain_data(tmp_path, caplog):
    odd = Topic("odd", Other)
    clock = Topic("clock", Other)
    with LogWriter(tmp_path / "a.mcap") as writer:
        for n in range(3):
            writer.write_message(odd, "x", n, n, n, Other("hello", [n]))
            writer.write_message(clock, "x", n, n, n, Other("tick"))
            writer.write_message(MAP, "x", n, n, n, A_MAP)
    with caplog.at_level(logging.WARNING):
        reader = LogReader(tmp_path / "a.mcap", {"clock": CLOCK})
        messages = [m.message for m in reader.messages(order="file")]
    assert messages[0] == {"text": "hello", "numbers": [0]}
    assert messages[1] == {"text": "tick", "numbers": []}
    assert messages[2]["raster"].shape == (1, 90, 50)
    (warning,) = [record.message for record in caplog.records]  # once, not for each message
    assert "topic odd is not known here" in warning
    hashes = [schema_hash(Other).hex(), schema_hash(Clock).hex()]
    assert f"clock@x was recorded as Other {hashes[0]}, this release knows Clock {hashes[1]}" in warning
    with pytest.raises(LogError, match=f"clock@x was recorded as Other {hashes[0]}, .* Clock {hashes[1]}"):
        reader.read(CLOCK)
    assert LogReader(tmp_path / "a.mcap", {"odd": odd}).read(odd).__next__().message == Other("hello", [0])


def test_a_damaged_chunk_is_named(tmp_path):
    path = write_sample(tmp_path / "a.mcap")
    place = LogReader(path).index.chunks[2]
    data = bytearray(path.read_bytes())
    data[place.offset + place.length - 5] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(LogError, match=f"the chunk at byte {place.offset} is damaged"):
        list(LogReader(path).messages())


SAMPLE: list[bytes] = []


def sample_bytes(tmp_path_factory) -> bytes:
    if not SAMPLE:
        path = write_sample(tmp_path_factory.mktemp("log") / "a.mcap", ticks=40, chunk_bytes=200)
        SAMPLE.append(path.read_bytes())
    return SAMPLE[0]


def test_truncated_anywhere_gives_all_complete_chunks(tmp_path_factory, tmp_path, caplog):
    """The reader gives exactly the messages of the chunks that are whole."""
    data = sample_bytes(tmp_path_factory)
    path = tmp_path / "cut.mcap"
    path.write_bytes(data)
    whole = LogReader(path)
    ends = [(c.offset + c.length) for c in whole.index.chunks]
    everything = [(m.source, m.sequence, m.record) for m in whole.messages(order="file")]
    with path.open("rb") as file:
        sizes = [len(read_chunk(whole.index, file, place)) for place in whole.index.chunks]
    near_ends = {end + n for end in [0, 60, *ends, len(data)] for n in range(-12, 13)}
    for cut in sorted(near_ends & set(range(len(data))) | set(range(0, len(data), 29))):
        path.write_bytes(data[:cut])
        try:
            reader = LogReader(path)
        except LogError:
            assert cut < 60
            continue
        assert not reader.index.complete
        count = sum(size for size, end in zip(sizes, ends, strict=True) if end <= cut)
        assert [(m.source, m.sequence, m.record) for m in reader.messages(order="file")] == everything[:count]
        assert reader.message_count == count
        caplog.clear()


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_flipped_bytes_never_crash(tmp_path_factory, data):
    """Whatever stands in the file: messages, or a LogError."""
    content = bytearray(sample_bytes(tmp_path_factory))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "flipped.mcap"
    path.write_bytes(content)
    try:
        reader = LogReader(path, TOPICS)
        count = sum(1 for _ in reader.messages())
        assert count <= 41
    except LogError:
        pass
