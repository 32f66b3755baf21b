"""HTML replays: what is in the file."""

import base64
import json
import re
import zlib

import numpy as np
import pytest

from footfall.messages.clock import Clock
from footfall.messages.log import LogReader, LogWriter
from footfall.messages.topics import AGENTS, BODY_STATES, CLOCK, PLANS
from footfall.tools.cli import main
from footfall.tools.log_html import UNIT, png, write_html


def unpack(path) -> tuple[dict, dict[str, np.ndarray]]:
    text = path.read_text(encoding="utf-8")
    facts = json.loads(re.search(r"const FACTS = (.*);\n", text)[1])  # type: ignore[index]
    blob = zlib.decompress(base64.b64decode(re.search(r'const DATA = "(.*)";', text)[1]))  # type: ignore[index]
    arrays = {}
    for name, entry in facts["arrays"].items():
        count = int(np.prod(entry["shape"]))
        arrays[name] = np.frombuffer(blob, "<" + entry["dtype"], count, entry["at"]).reshape(entry["shape"])
        assert entry["at"] % 8 == 0
    return facts, arrays


def test_the_file_holds_the_run(run_log, tmp_path):
    facts, arrays = unpack(write_html(run_log, tmp_path / "a.html"))
    reader = LogReader(run_log)
    agents = [item.message for item in reader.read(AGENTS)]
    bodies = [item.message for item in reader.read(BODY_STATES)]
    plans = [item.message for item in reader.read(PLANS)]
    assert arrays["times"] == pytest.approx(np.arange(41) / 10, abs=1e-6)
    assert arrays["first"].tolist() == list(range(0, 3 * 42, 3))
    xy = np.concatenate([a.now[:, :2] for a in agents])
    assert arrays["xy"] * UNIT == pytest.approx(xy, abs=UNIT)
    joints = np.concatenate([b.positions for b in bodies])
    assert arrays["joints"] * UNIT == pytest.approx(joints, abs=UNIT)
    chosen = np.concatenate([p.positions[[0, 1, 2], p.chosen, 1::2] for p in plans])
    assert arrays["plans"] * UNIT == pytest.approx(chosen, abs=UNIT)
    assert len(arrays["samples"]) == 2 * len(arrays["plans"])
    assert np.bincount(arrays["sampleOf"]).tolist() == [2] * len(arrays["plans"])
    assert [o["name"] for o in facts["obstacles"][0][1]] == ["crate", "tower"]
    assert facts["goals"][0][1]["4"] == [3.0, 4.0] and facts["groups"][0][1] == [[0, 1]]
    assert facts["falls"] == [[2.5, 4]]


def test_less_is_kept_when_less_is_asked_for(run_log, tmp_path):
    facts, arrays = unpack(write_html(run_log, tmp_path / "a.html", rate_hz=2.0, bodies=False))
    assert arrays["times"] == pytest.approx(np.arange(0, 4.1, 0.5), abs=1e-6)
    assert "joints" not in arrays and facts["parents"] == []


def test_nothing_of_a_log_becomes_script(run_log, tmp_path):
    odd = run_log.rename(run_log.with_name("<script>alert(1)<.mcap"))
    text = write_html(odd, tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert text.count("<script>") == 1
    assert not re.search(r"(src|href)\s*=\s*[\"']?http", text)


def test_the_picture_is_a_png(tmp_path):
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(0).integers(0, 255, (7, 5, 3), np.uint8)
    (tmp_path / "a.png").write_bytes(png(pixels))
    with image.open(tmp_path / "a.png") as read:
        assert np.array_equal(np.asarray(read), pixels)


def test_on_the_command_line(run_log, tmp_path, capsys):
    out = tmp_path / "b.html"
    assert main(["log", "html", str(run_log), "-o", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    assert main(["log", "html", str(run_log), "--rate", "0"]) == 2
    with LogWriter(tmp_path / "e.mcap") as writer:
        writer.write_message(CLOCK, "simulator", 0, 0, 0, Clock(0, 1, "lockstep"))
    assert main(["log", "html", str(tmp_path / "e.mcap")]) == 2
    assert "has no agents" in capsys.readouterr().err
