"""The importer on a small hand-made benchmark, and on the real one where it is."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from footfall.models.scene import SceneError
from footfall.models.trace.crowd_file import SPLITS, CrowdFileError, Crowds
from footfall.models.trace.recordings import census, leave_one_out, pack_recordings
from footfall.tools import cli, data_eth_ucy
from footfall.tools.data_eth_ucy import RECORDINGS, read_recording_of

DATA = Path(os.environ.get("FOOTFALL_DATA") or Path(__file__).parents[3] / "shared" / "data")
SPEED = 1.2  # m/s


def walkers(rate_hz, frame_step, first=780):
    """Rows [frame, person, x, y] of two people who walk along x for 40 s, every `frame_step` frames."""
    frames = np.arange(0, 40 * rate_hz, frame_step)
    return [[first + f, person, SPEED * f / rate_hz, 3.0 * person] for f in frames for person in (1, 2)]


def write_biwi(folder, rate_hz, frame_step):
    """The original: 2.5 annotations a second, and a mask with one box at x 4-6 m, y 4-5 m."""
    folder.mkdir(parents=True)
    rows = walkers(rate_hz, frame_step)
    np.savetxt(folder / "obsmat.txt", [[f, p, x, 0, y, SPEED, 0, 0] for f, p, x, y in rows])
    np.savetxt(folder / "H.txt", [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 1]])
    mask = np.zeros((520, 100), np.uint8)
    mask[40:60, 40:50] = 255  # rows along x
    Image.fromarray(mask).save(folder / "map.png")


def write_ucy(folder):
    """An annotation without obstacles."""
    folder.mkdir(parents=True)
    lines = ["1 - splines", "2 - points", "0 0 0 90", "100 0 500 90", "0 - lines", "0 - cylinders"]
    (folder / "annotation.vsp").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    root = tmp_path_factory.mktemp("benchmark")
    for kind in ("all_data", "val"):
        (root / kind).mkdir()
    for row in RECORDINGS.values():
        rows = np.array(walkers(row.rate_hz, 10))  # the copy of ETH has every tenth frame, too
        late = rows[rows[:, 0] >= 780 + 30 * row.rate_hz]
        np.savetxt(root / "all_data" / f"{row.file}.txt", rows, fmt="%.6f", delimiter="\t")
        np.savetxt(root / "val" / f"{row.file}_val.txt", late, fmt="%.6f", delimiter="\t")
    write_biwi(root / "biwi" / "eth", 15, 6)
    write_biwi(root / "biwi" / "hotel", 25, 10)
    for name in ("zara01", "zara02"):
        write_ucy(root / "biwi" / name)
    return root


@pytest.mark.parametrize("name", RECORDINGS)
def test_people_walk_as_fast_as_they_did(benchmark, name):
    recording = read_recording_of(name, benchmark, benchmark / "biwi")
    for track in recording.tracks:
        assert np.allclose(np.diff(track[:, 1]) / np.diff(track[:, 0]), SPEED, atol=1e-4)
    original = RECORDINGS[name].original
    assert np.allclose(np.diff(recording.tracks[0][:, 0]), 0.4 if original else 10 / RECORDINGS[name].rate_hz)


def test_validation_begins_where_the_benchmark_says(benchmark):
    for name in ("eth", "zara01"):
        (begin, turn, first), (again, end, then) = read_recording_of(
            name, benchmark, benchmark / "biwi"
        ).intervals
        assert (begin, first, then) == (0.0, "train", "val")
        assert turn == again == pytest.approx(30.0, abs=0.7) and end == pytest.approx(40.0, abs=0.7)


def test_masks_become_maps(benchmark):
    recording = read_recording_of("eth", benchmark, benchmark / "biwi")
    field = pack_recordings("eth", [recording], 0.25, {})
    column, row = np.rint((np.array([5.0, 4.5]) - field.origin) / field.resolution).astype(int)
    assert field.distance[0, row, column] == pytest.approx(-0.5, abs=0.15)
    assert read_recording_of("students001", benchmark, benchmark / "biwi").obstacles is None


def run(benchmark, out, fold="hotel"):
    arguments = ["data", "eth-ucy", str(benchmark), "--biwi", str(benchmark / "biwi"), "--fold", fold]
    return cli.main([*arguments, "--out", str(out)])


def test_a_fold_is_two_files_that_training_reads(benchmark, tmp_path, capsys):
    assert run(benchmark, tmp_path) == 0
    shown = capsys.readouterr().out
    assert "hotel: test, 0.7 min, 2 people" in shown and f"{SPEED:.2f} m/s" in shown
    maps, plain = (Crowds.load(tmp_path / "hotel" / f"{kind}.npz") for kind in ("maps", "open"))
    assert maps.has_map and not plain.has_map
    for crowds in (maps, plain):
        for split, (name, start) in zip(crowds.split, crowds.source["starts"], strict=True):
            assert (SPLITS[split] == "test") == (name == "hotel")
            assert name == "hotel" or (start >= 29) == (SPLITS[split] == "val")
    assert {name for name, _ in maps.source["starts"]} == {"eth", "hotel", "zara01", "zara02"}


def test_the_same_recordings_give_the_same_files(benchmark, tmp_path):
    for out in ("a", "b"):
        assert run(benchmark, tmp_path / out, "univ") == 0
    a, b = (Crowds.load(tmp_path / out / "univ" / "open.npz") for out in ("a", "b"))
    assert a.source == b.source and np.array_equal(a.positions, b.positions, equal_nan=True)
    assert (a.split == SPLITS.index("test")).all()


def test_what_is_missing_is_named(benchmark, tmp_path, capsys):
    with pytest.raises(CrowdFileError, match=r"all_data/biwi_eth.txt: no such file"):
        read_recording_of("eth", tmp_path, benchmark / "biwi")
    with pytest.raises(SceneError, match="eth"):
        read_recording_of("eth", benchmark, tmp_path)
    (tmp_path / "all_data").mkdir()
    (tmp_path / "all_data" / "students001.txt").write_text("1 2 3\n")
    with pytest.raises(CrowdFileError, match="four finite numbers"):
        read_recording_of("students001", tmp_path, benchmark / "biwi")
    assert run(tmp_path, tmp_path / "out") == 2
    assert "no such file" in capsys.readouterr().err


@pytest.mark.skipif(not (DATA / "eth_ucy").is_dir(), reason="the ETH/UCY benchmark is not here")
@pytest.mark.parametrize(("name", "speed", "walls"), [("eth", 1.38, 0.001), ("zara01", 1.07, 0.01)])
def test_the_real_recordings(name, speed, walls):
    recording = read_recording_of(name, DATA / "eth_ucy", DATA / "biwi_maps")
    crowds = pack_recordings(name, [recording], data_eth_ucy.RADIUS, {})
    found = census(crowds, np.arange(len(crowds.split)))
    assert found.speed == pytest.approx(speed, abs=0.02)
    assert found.in_obstacles < walls and found.acceleration < 0.3
    options = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
    tracks = [track for track in recording.tracks if len(track) > 5]
    errors = [np.concatenate([leave_one_out(t, s)[2:-2] for t in tracks]).mean() for s in options]
    assert options[int(np.argmin(errors))] == recording.smoothing
