"""The benches run, and what they report is consistent."""

import json
from pathlib import Path

import pytest

from footfall.messages.topics import TOPICS
from footfall.tools import cli
from footfall.tools.bench_bus import measure
from footfall.tools.fuzz import MUTATIONS, fuzz


@pytest.mark.slow
def test_bench_bus() -> None:
    result = measure(quick=True, sizes=("64", "39k"))
    assert {"zenoh", "LCM", "dora-rs"} == set(result["peers"])
    for size in ("64", "39k"):
        ours, raw = result["rtt_us"]["footfall"][size], result["rtt_us"]["raw pyzmq"][size]
        assert ours / raw / 2 < result["rtt_ratio"][size] < ours / raw * 2  # of turns, not of medians
        assert 0 < result["throughput_ratio"][size] < 2
    assert result["latest_age_ms"]["median"] < 20


def test_no_broken_frame_gets_through_or_breaks_the_receiver() -> None:
    told: list[tuple[int, int]] = []
    result = fuzz(4000, seed=3, progress=lambda done, frames: told.append((done, frames)))
    assert told == [(4000, 4000)]
    assert result.crashes == []
    assert result.accepted + result.rejected == result.frames == 4000
    assert set(result.by_mutation) == {"splice"} | {m.__name__ for m in MUTATIONS if m}
    assert {name.split(".")[0] for name in result.fields} == set(TOPICS)
    assert result.memory_growth < 100 << 20


def test_bench_fuzz_on_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = tmp_path / "results.md"
    table.write_text("# Results\n\nabove\n")
    for _ in range(2):
        assert cli.main(["bench", "fuzz", "--frames", "200", "--json", "--write", str(table)]) == 0
    text = table.read_text()
    assert text.startswith("# Results\n\nabove\n") and text.count("| frames | 200 |") == 1
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["frames"] == 200
    assert facts["crashes"] == 0
