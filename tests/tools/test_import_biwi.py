"""The importer on small hand-made recordings, and on the real ones where they are."""

import argparse
import os
from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image

from footfall.models.scene import RecordedPopulation, Scene, SceneError, load_scene
from footfall.tools.biwi_source import UCY_MIDDLE, UCY_SCALE, read_recording
from footfall.tools.import_biwi import add_parser, import_biwi, overlap

DATA = Path(os.environ.get("FOOTFALL_DATA") or Path(__file__).parents[3] / "shared" / "data") / "biwi_maps"

# World from (row, column, 1): 2 cm a pixel, rows along x, columns along y, a little perspective.
HOMOGRAPHY = np.array([[0.02, 0.0, -1.0], [0.0, 0.02, -2.0], [2e-4, 0.0, 1.0]])


def to_world(row: float, column: float) -> np.ndarray:
    x, y, w = HOMOGRAPHY @ (row, column, 1.0)
    return np.array([x / w, y / w])


def write_biwi(folder: Path, frame_step: int = 6) -> Path:
    """Two people side by side for 4 s and one later, a box and a speck in the mask."""
    folder.mkdir(parents=True)
    np.savetxt(folder / "H.txt", HOMOGRAPHY)
    mask = np.zeros((200, 300), dtype=np.uint8)
    mask[120:160, 200:280] = 255  # rows, columns
    mask[10, 10] = 255
    Image.fromarray(mask).save(folder / "map.png")
    rows = []
    for number, (x, y, vx, vy), start, count in (
        (4, (-0.5, 0.0, 1.2, 0.1), 0, 11),
        (9, (-0.5, 0.6, 1.2, 0.1), 0, 11),
        (5, (1.0, 1.5, -0.5, 0.5), 5, 6),
    ):
        for k in range(count):
            t = 0.4 * k
            rows.append([780 + frame_step * (start + k), number, x + vx * t, 0, y + vy * t, vx, 0, vy])
    np.savetxt(folder / "obsmat.txt", sorted(rows))
    (folder / "groups.txt").write_text(" 4 9\n\n5 77\n")
    return folder


def write_ucy(folder: Path, static: bool = False) -> Path:
    """One spline that turns a corner, one straight, a lamp for ever, a loiterer for a while, and walls."""
    folder.mkdir(parents=True)
    lines = ["2 - the number of splines"]
    for spline in ([(-300, 0, 100), (0, 0, 200), (0, -200, 300)], [(-300, 80, 150), (200, 80, 350)]):
        lines.append(f"{len(spline)} - Num of control points")
        lines += [f"{x}.000 {y}.000 {frame} 90.0 - (2D point, m_id)" for x, y, frame in spline]
    lines += ["4 - number of line obstacles", "-370 120 -200 120 1 - left", "-196 121 -196 180 0 - left"]
    lines += ["-200 181 -365 181 1 - left", "100 100 200 100 1 - left"]
    lines += [
        "2 - number of cylinder obstacles",
        "250 150 (center)",
        "10 2 0 (radius, type, id)",
        "0 0 (start)",
    ]
    lines += ["50 50 (center)", "10 2 1 (radius, type, id)", "100 200 (start and end time)"]
    (folder / "annotation.vsp").write_text("\n".join(lines) + "\n")
    (folder / "groups.txt").write_text("1\n2   1\n")
    if static:  # the front of a house between the columns 100 and 300, its foot in row 200
        np.savetxt(folder / "static.txt", [(100, 150), (100, 200), (300, 200), (300, 150), (100, 150)])
    return folder


def tracks_of(scene: Scene) -> dict[int, np.ndarray]:
    assert isinstance(scene.population, RecordedPopulation)
    return {track.id: track.samples for track in scene.population.tracks}


@pytest.mark.parametrize("frame_step", [6, 10])
def test_an_annotation_step_is_400_ms_whatever_the_frame_rate(tmp_path: Path, frame_step: int) -> None:
    write_biwi(tmp_path / "eth", frame_step)
    tracks = tracks_of(import_biwi(tmp_path, "eth", tmp_path / "out" / "eth"))
    assert sorted(tracks) == [4, 5, 9]
    np.testing.assert_allclose(tracks[4][:, 0], np.arange(41) / 10)
    np.testing.assert_allclose(tracks[5][:, 0], 2.0 + np.arange(21) / 10)
    for number, start, velocity in ((4, (-0.5, 0.0), (1.2, 0.1)), (5, (1.0, 1.5), (-0.5, 0.5))):
        t = tracks[number][:, :1] - tracks[number][0, 0]
        np.testing.assert_allclose(tracks[number][:, 1:], np.array(start) + t * np.array(velocity), atol=1e-6)


def test_obstacles_come_from_the_mask_by_row_and_column(tmp_path: Path) -> None:
    folder = write_biwi(tmp_path / "eth")
    scene = import_biwi(folder, "eth", tmp_path / "out")
    (obstacle,) = scene.obstacles  # the speck is noise
    corners = [to_world(row, column) for row in (119.5, 159.5) for column in (199.5, 279.5)]
    expected = shapely.MultiPoint(corners).convex_hull
    got = shapely.Polygon(obstacle.polygon)
    assert got.symmetric_difference(expected).area < 0.02 * expected.area
    assert len(obstacle.polygon) == 4
    inside = scene.layers["obstacle"].sum() * 0.01
    assert inside == pytest.approx(expected.area, rel=0.15)
    assert (scene.layers["walkable"] != scene.layers["obstacle"]).all()


def test_the_map_reaches_past_everybody_and_groups_are_kept(tmp_path: Path) -> None:
    scene = import_biwi(write_biwi(tmp_path / "eth"), "eth", tmp_path / "out" / "eth")
    points = np.concatenate(list(tracks_of(scene).values()))[:, 1:]
    low_x, low_y, high_x, high_y = scene.bounds
    assert (points.min(axis=0) - (low_x, low_y) >= 1.9).all()
    assert ((high_x, high_y) - points.max(axis=0) >= 1.9).all()
    assert isinstance(scene.population, RecordedPopulation)
    assert scene.population.groups == ((4, 9),)  # 77 has no track
    entries = scene.sample_population(0)
    assert [(entry.time, entry.group) for entry in entries] == [(0.0, 0), (0.0, 0), (2.0, None)]
    np.testing.assert_allclose(entries[0].velocity, (1.2, 0.1), atol=1e-6)


def test_importing_twice_gives_the_same_files_and_they_load(tmp_path: Path) -> None:
    write_biwi(tmp_path / "data" / "ETH" / "seq_hotel", 10)  # as in collections that keep the authors' names
    made = import_biwi(tmp_path / "data", "hotel", tmp_path / "a" / "hotel")
    import_biwi(tmp_path / "data", "hotel", tmp_path / "b" / "hotel")
    for path in (tmp_path / "a" / "hotel").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / "hotel" / path.name).read_bytes()
    back = load_scene(tmp_path / "a" / "hotel")
    for number, samples in tracks_of(made).items():
        np.testing.assert_allclose(tracks_of(back)[number], samples, atol=0.00051)
    assert len((tmp_path / "a" / "hotel" / "scene.yaml").read_text().splitlines()) < 30


def test_ucy_splines_become_tracks_in_seconds_and_metres(tmp_path: Path) -> None:
    scene = import_biwi(write_ucy(tmp_path / "zara01"), "zara01", tmp_path / "out")
    tracks = tracks_of(scene)
    corner = tracks[1]
    np.testing.assert_allclose(corner[[0, -1], 0], (0.0, 8.0))  # frames 100 to 300 at 25 Hz
    assert corner[0, 1:] == pytest.approx(UCY_MIDDLE + UCY_SCALE * (-300, 0))
    assert corner[40, 1:] == pytest.approx(UCY_MIDDLE)
    assert corner[-1, 1:] == pytest.approx(UCY_MIDDLE + UCY_SCALE * (0, -200))
    low, high = UCY_MIDDLE + UCY_SCALE * (-300, -200), UCY_MIDDLE
    assert (corner[:, 1:] >= low - 1e-6).all() and (corner[:, 1:] <= high + 1e-6).all()  # no overshoot
    straight = tracks[2]
    assert (straight[0, 0], straight[-1, 0]) == (2.0, 10.0)
    assert np.diff(straight[:, 1]) == pytest.approx(500 * UCY_SCALE[0] / 80)
    assert isinstance(scene.population, RecordedPopulation) and scene.population.groups == ((2, 1),)


def test_ucy_obstacles(tmp_path: Path) -> None:
    solids = read_recording(write_ucy(tmp_path / "zara01")).obstacles
    planter, wall, lamp = sorted(solids, key=lambda solid: -solid.area)[0], None, None
    for solid in solids:
        center = np.array(solid.centroid.coords[0])
        if np.allclose(center, UCY_MIDDLE + UCY_SCALE * (250, 150), atol=0.01):
            lamp = solid
        if np.allclose(center, UCY_MIDDLE + UCY_SCALE * (150, 100), atol=0.01):
            wall = solid
    assert len(solids) == 3  # the loiterer is none
    # The three lines are cut by the picture's left edge: a filled planter.
    assert planter.contains(shapely.Point(UCY_MIDDLE + UCY_SCALE * (-280, 150)))
    assert planter.area == pytest.approx(165 * 60 * UCY_SCALE.prod(), rel=0.05)
    assert wall is not None and wall.area == pytest.approx(0.05 * 100 * UCY_SCALE[0], rel=0.05)
    assert lamp is not None and lamp.area == pytest.approx(np.pi * (10 * UCY_SCALE.mean()) ** 2, rel=0.12)


def test_a_house_goes_on_behind_its_front(tmp_path: Path) -> None:
    scene = import_biwi(write_ucy(tmp_path / "zara01", static=True), "zara01", tmp_path / "out")
    (house,) = [obstacle for obstacle in scene.obstacles if obstacle.name.startswith("house")]
    low, high = UCY_MIDDLE + UCY_SCALE * (-260, 88), UCY_MIDDLE + UCY_SCALE * (-60, 0)
    assert house.polygon.min(axis=0) == pytest.approx(low, abs=0.02)
    assert house.polygon.max(axis=0) == pytest.approx((high[0], scene.bounds[3]), abs=0.02)


def test_a_house_is_set_back_behind_the_people_before_its_windows(tmp_path: Path) -> None:
    folder = write_ucy(tmp_path / "zara01", static=True)
    text = (folder / "annotation.vsp").read_text().replace("2 - the", "3 - the", 1).splitlines()
    spline = [f"{x}.0 105.0 {frame} 90.0 - point" for x, frame in ((-200, 100), (-180, 2600))]
    (folder / "annotation.vsp").write_text("\n".join([text[0], "2 - Num", *spline, *text[1:]]))
    depth = UCY_SCALE[1] * (105 - 88)  # how deep in the front the window shopper's head appears
    scene = import_biwi(folder, "zara01", tmp_path / "out")
    (house,) = [obstacle for obstacle in scene.obstacles if obstacle.name.startswith("house")]
    foot = UCY_MIDDLE[1] + UCY_SCALE[1] * 88
    assert depth < house.polygon[:, 1].min() - foot < depth + 0.1
    assert overlap(scene, depth=0.0) == 0.0


def parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    return parser.parse_args(["biwi", *words])


def test_the_verb_writes_to_scenes_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_biwi(tmp_path / "data" / "hotel", 10)
    monkeypatch.chdir(tmp_path)
    args = parse("data", "--scene", "hotel")
    assert args.run(args) == 0
    assert "3 pedestrians in 4 s" in capsys.readouterr().out
    assert load_scene("hotel").name == "hotel"


@pytest.mark.parametrize(
    ("scene", "spoil", "message"),
    [
        ("hotle", None, "no recording 'hotle'; did you mean 'hotel'?"),
        ("zara01", None, "neither it nor zara01, UCY/zara01 in it has an obsmat.txt"),
        ("hotel", "map.png", "no such file; the obstacles of a BIWI scene are in it"),
        ("hotel", "H.txt", "H.txt: no such file"),
    ],
)
def test_a_wrong_source_is_one_sentence(tmp_path: Path, scene: str, spoil: str | None, message: str) -> None:
    folder = write_biwi(tmp_path / "hotel")
    if spoil:
        (folder / spoil).unlink()
    args = parse(str(tmp_path), "--scene", scene, "--out", str(tmp_path / "out"))
    with pytest.raises(SceneError) as caught:
        args.run(args)
    error = str(caught.value)
    assert message in error
    assert "\n" not in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("obsmat.txt", "1 2 3\n", "8 finite numbers a row are needed, not 3"),
        ("obsmat.txt", "1 1 0 0 0 0 0 x\n", "obsmat.txt: "),
        ("obsmat.txt", "1 1 0 0 0 0 0 0\n1 1 1 0 0 0 0 0\n", "twice in a frame"),
        ("annotation.vsp", "2 - splines\n1 - points\n0 0 0 0\n", "not an annotation of splines"),
        ("annotation.vsp", "1 - splines\n2 - points\n0 0 5 0\n1 1 5 0\n", "frames do not grow"),
    ],
)
def test_a_broken_source_is_refused(tmp_path: Path, file: str, text: str, message: str) -> None:
    folder = write_biwi(tmp_path / "eth")
    (folder / file).write_text(text)
    with pytest.raises(SceneError, match=message):
        import_biwi(folder, "eth", tmp_path / "out")


@pytest.mark.skipif(not DATA.is_dir(), reason="no recordings: set FOOTFALL_DATA to the folder with biwi_maps")
@pytest.mark.parametrize(
    ("name", "people", "seconds", "speed"),
    [
        ("eth", 360, 773, 1.38),  # the mean speed tells the true time base from the one played too fast
        ("hotel", 390, 722, 1.04),
        ("zara01", 148, 361, 1.07),
        ("zara02", 204, 420, 0.79),
        ("students03", 434, 216, 0.71),
    ],
)
def test_the_real_recordings(tmp_path: Path, name: str, people: int, seconds: int, speed: float) -> None:
    scene = import_biwi(DATA, name, tmp_path / name)
    tracks = list(tracks_of(scene).values())
    assert len(tracks) == people
    assert max(track[-1, 0] for track in tracks) == pytest.approx(seconds, abs=1.0)
    steps = np.concatenate([np.diff(track, axis=0) for track in tracks])
    mean = np.hypot(steps[:, 1], steps[:, 2]).sum() / steps[:, 0].sum()
    assert mean == pytest.approx(speed, abs=0.06)
    assert overlap(scene) < 0.01
    assert 0 < len(scene.obstacles) < 20
    assert sum(len(obstacle.polygon) for obstacle in scene.obstacles) < 60
    # Groups walk together: half of the pairs that were seen at once stayed within 1.2 m.
    assert isinstance(scene.population, RecordedPopulation)
    gaps = []
    for first, second, *_ in scene.population.groups:
        a, b = tracks_of(scene)[first], tracks_of(scene)[second]
        _, i, j = np.intersect1d(np.round(a[:, 0], 1), np.round(b[:, 0], 1), return_indices=True)
        gaps += [np.median(np.hypot(*(a[i, 1:] - b[j, 1:]).T))] if len(i) else []
    assert np.median(gaps) < 1.2
    assert len(scene.sample_population(0)) == people
