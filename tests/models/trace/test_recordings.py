import numpy as np
import pytest
import shapely
from scipy.interpolate import CubicSpline, make_smoothing_spline

from footfall.models.trace.config import COMPACT
from footfall.models.trace.crowd_file import CrowdFileError
from footfall.models.trace.recordings import (
    Recording,
    census,
    cut_scenes,
    leave_one_out,
    pack_recordings,
    smooth_track,
    smoother,
    triangles,
    unbroken,
)
from footfall.models.trace.windows import CrowdWindows

L_SHAPE = np.array([[4.0, -4], [8, -4], [8, -2], [6, -2], [6, 1], [4, 1]])


def wobbly(seconds=12.0, start=0.0, step=0.4, seed=0):
    t = start + np.arange(0, seconds, step)
    rng = np.random.default_rng(seed)
    return np.column_stack([t, 1.3 * t, np.sin(0.5 * t)]) + np.pad(
        rng.normal(0, 0.05, (len(t), 2)), ((0, 0), (1, 0))
    )


@pytest.mark.parametrize("smoothing", [0.001, 0.03, 1.0])
def test_the_smoothing_spline_is_scipys(smoothing):
    track = wobbly()
    ours = smooth_track(track, smoothing)
    for axis in (1, 2):
        theirs = make_smoothing_spline(track[:, 0], track[:, axis], lam=smoothing)(ours[:, 0])
        assert np.allclose(ours[:, axis], theirs, atol=1e-9)


def test_without_smoothing_the_samples_are_kept():
    track = wobbly()
    ours = smooth_track(track)
    assert np.allclose(ours[::4, 1:][: len(track)], track[:, 1:], atol=1e-9)
    assert np.allclose(np.diff(ours[:, 0]), 0.1)


@pytest.mark.parametrize("smoothing", [0.0, 0.03, 10.0])
def test_who_walks_straight_ahead_walks_straight_ahead(smoothing):
    t = np.array([0.13, 0.4, 1.1, 1.3, 2.2])
    ours = smooth_track(np.column_stack([t, 1.2 * t, 3 - 0.4 * t]), smoothing)
    assert ours[0, 0] == pytest.approx(0.2) and ours[-1, 0] == pytest.approx(2.2)
    assert np.allclose(ours[:, 1:], np.column_stack([1.2 * ours[:, 0], 3 - 0.4 * ours[:, 0]]), atol=1e-9)


def test_smoothing_turns_with_the_track():
    track, turn = wobbly(), np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = np.column_stack([track[:, 0], track[:, 1:] @ turn.T])
    assert np.allclose(smooth_track(turned, 0.03)[:, 1:], smooth_track(track, 0.03)[:, 1:] @ turn.T)


def test_two_samples_are_joined_by_a_line():
    assert np.allclose(
        smooth_track(np.array([[0.0, 0, 0], [0.4, 2, 4]])), [[0.1 * i, 0.5 * i, i] for i in range(5)]
    )


def test_leaving_out_is_really_leaving_out():
    track, smoothing = wobbly(4.0), 0.03
    quick = leave_one_out(track, smoothing)
    for i in range(1, len(track) - 1):
        rest = np.delete(track, i, 0)
        fitted = smoother(rest[:, 0], smoothing) @ rest[:, 1:]
        missed = CubicSpline(rest[:, 0], fitted, bc_type="natural")(track[i, 0])
        assert quick[i] == pytest.approx(np.hypot(*(missed - track[i, 1:])), abs=1e-9)


def test_who_comes_back_is_somebody_else():
    track = np.concatenate([wobbly(2.0), wobbly(2.0, start=9.0), wobbly(0.1, start=30.0)])
    assert [len(part) for part in unbroken(track)] == [5, 5]


def recording(**changes):
    tracks = [wobbly(50.0, seed=1), wobbly(9.6, start=8.4, seed=2), wobbly(30.0, start=17.2, seed=3)]
    facts = {"name": "street", "tracks": tracks, "intervals": [(0.0, 48.0, "train")]}
    return Recording(**{**facts, **changes})


def test_every_window_occurs_in_exactly_one_scene():
    crowds = pack_recordings("street", [recording()], 0.25, {})
    windows = CrowdWindows(crowds, "train", COMPACT)
    starts = np.array([start for _, start in crowds.source["starts"]])
    moments = starts[windows.index[:, 0]] * 10 + windows.index[:, 2].numpy()
    wanted = []
    for track in recording().tracks:
        frames = np.rint(smooth_track(track)[:, 0] * 10).astype(int)
        wanted += [now for now in range(30, 480 - 52) if now in frames and now + 52 in frames]
    assert sorted(np.rint(moments).astype(int)) == sorted(wanted)


def test_splits_do_not_share_a_moment():
    both = recording(intervals=[(0.0, 25.0, "train"), (25.0, 48.0, "val")])
    for start, split, positions in cut_scenes(both):
        last = np.flatnonzero(np.isfinite(positions[..., 0]).any(0)).max()
        assert start + 0.1 * last < (25.0 if split == "train" else 48.0)
        assert start >= (0.0 if split == "train" else 25.0)


def test_scenes_hold_what_the_camera_saw():
    start, _, positions = list(cut_scenes(recording()))[1]
    assert start == pytest.approx(11.9) and positions.shape == (3, 201, 2)
    whole = smooth_track(recording().tracks[0])
    assert np.allclose(positions[0], whole[119:320, 1:], atol=1e-5)
    assert np.isnan(positions[2, :53]).all() and np.isfinite(positions[2, 53:]).all()  # comes at 17.2 s


def test_outlines_become_triangles_of_the_same_area():
    parts = triangles([L_SHAPE])
    union = shapely.union_all([shapely.Polygon(part) for part in parts])
    assert len(parts) == 4 and union.symmetric_difference(shapely.Polygon(L_SHAPE)).area < 1e-6


def test_maps_are_distances_to_the_outlines():
    crowds = pack_recordings("street", [recording(obstacles=[L_SHAPE])], 0.25, {})
    field = crowds.distance[0].astype(float)
    rows, columns = field.shape
    x, y = (o + crowds.resolution * np.arange(n) for o, n in zip(crowds.origin, (columns, rows), strict=True))
    for i, j in [(0, 0), (rows - 1, columns // 2), (int((0 - y[0]) / 0.2), int((5.1 - x[0]) / 0.2))]:
        point, shape = shapely.Point(x[j], y[i]), shapely.Polygon(L_SHAPE)
        true = -shape.exterior.distance(point) if shape.contains(point) else shape.distance(point)
        assert field[i, j] == pytest.approx(min(true, 20.0), abs=0.01)  # clipped
    assert field.min() < -0.5 and len(crowds.polygons_of(0)) == 4


def test_the_census_counts():
    t = np.arange(0, 20.05, 0.4)
    walker, shadow = (np.column_stack([t, 1.5 * t, np.full_like(t, y)]) for y in (0.0, 0.4))
    wall = np.array([[15.0, -1], [30, -1], [30, -0.1], [15, -0.1]])  # 0.1 m beside the walker from x = 15 on
    whole = Recording("pair", [walker, shadow], [(0.0, 20.0, "test")], [wall])
    found = census(pack_recordings("pair", [whole], 0.25, {}), np.array([0]))
    assert found.scenes == 1 and found.people == 2
    assert found.speed == pytest.approx(1.5, abs=1e-3) and found.acceleration < 0.01
    assert found.in_people == 1.0
    assert found.in_obstacles == pytest.approx(0.25, abs=0.02)  # one of two, the second half of the time


def test_maps_are_known_for_all_or_none():
    with pytest.raises(CrowdFileError, match="cannot share a file"):
        pack_recordings("two", [recording(), recording(obstacles=[L_SHAPE])], 0.25, {})
    with pytest.raises(CrowdFileError, match="nobody is seen twice"):
        pack_recordings("none", [recording(tracks=[wobbly(0.1)])], 0.25, {})
