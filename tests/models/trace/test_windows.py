from dataclasses import replace

import numpy as np
import pytest
import torch

from footfall.models.trace.config import COMPACT
from footfall.models.trace.context import from_frame
from footfall.models.trace.crowd_file import CrowdFileError, Crowds, pack_crowds
from footfall.models.trace.dynamics import rollout
from footfall.models.trace.orca_scenes import (
    CrowdSpec,
    draw_polygons,
    map_axis,
    simulate_crowds,
    smallest_gap,
)
from footfall.models.trace.windows import CrowdWindows, fit_crowds

SPEC = CrowdSpec(subset="maps", substeps=2)


@pytest.fixture(scope="module")
def crowds():
    return pack_crowds(SPEC, simulate_crowds(SPEC, 0, range(10)), 0)


def test_scenes_are_free_of_collisions(crowds):
    walked = simulate_crowds(SPEC, 0, range(10))
    gaps = [smallest_gap(c, SPEC.radius) for c in walked]
    assert min(gaps) >= SPEC.skin - 1e-3
    assert all(len(c.positions) <= 10 and 1 <= len(c.polygons) <= 20 for c in walked)


def test_a_scene_depends_on_seed_and_number_only(crowds):
    (alone,) = simulate_crowds(SPEC, 0, range(7, 8))
    people = len(alone.positions)
    assert np.allclose(crowds.positions[7, :people], alone.positions, atol=1e-4)
    (other,) = simulate_crowds(SPEC, 1, range(7, 8))
    assert other.positions.shape != alone.positions.shape or not np.allclose(other.positions, alone.positions)


def test_obstacles_scale_with_the_area():
    size = [
        np.mean([np.ptp(p) for s in range(20) for p in draw_polygons(spec, np.random.default_rng(s))])
        for spec in (SPEC, replace(SPEC, area=30.0))
    ]
    assert size[1] == pytest.approx(2 * size[0])


def test_interacting_crowds_have_no_map():
    spec = CrowdSpec(subset="interact", substeps=1, seconds=1.0)
    crowds = pack_crowds(spec, simulate_crowds(spec, 0, range(3)), 0)
    assert not crowds.has_map and crowds.polygons_of(0) == []
    assert crowds.positions.shape == (3, 20, 11, 2)


def test_distance_field_stands_where_the_obstacles_are(crowds):
    scene = int(np.argmax([len(crowds.polygons_of(s)) for s in range(10)]))
    axis = map_axis(SPEC)
    centre = crowds.polygons_of(scene)[0].mean(0)
    row, column = (int(np.abs(axis - v).argmin()) for v in (centre[1], centre[0]))
    assert crowds.distance[scene, row, column] < 0


def test_split_of_the_base_stays_when_scenes_are_added(crowds):
    assert np.bincount(crowds.split).tolist() == [8, 1, 1]
    larger = pack_crowds(SPEC, simulate_crowds(SPEC, 0, range(12)), 0, base=10)
    assert larger.split.tolist() == [*crowds.split.tolist(), 0, 0]
    assert np.array_equal(larger.positions[9], crowds.positions[9], equal_nan=True)


def test_file_returns_what_was_saved(crowds, tmp_path):
    crowds.save(tmp_path / "new" / "maps.npz")
    again = Crowds.load(tmp_path / "new" / "maps.npz")
    assert again.name == "orca-maps" and again.source == crowds.source and again.origin == crowds.origin
    assert np.array_equal(again.positions, crowds.positions, equal_nan=True)
    assert np.array_equal(again.distance, crowds.distance)


def test_bad_files_are_explained(crowds, tmp_path):
    with pytest.raises(CrowdFileError, match="footfall data orca"):
        Crowds.load(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    for changed, text in (
        ({"dt": 0.0}, "dt must be a number above 0, not 0.0"),
        ({"radius": float("nan")}, "radius must be a number above 0"),
        ({"resolution": "fine"}, "resolution must be a number"),
        ({"origin": (0.0,)}, "origin must be two"),
        ({"positions": crowds.positions[..., :1]}, "positions and polygons must end in x and y"),
        ({"distance": crowds.distance[1:]}, "distance has shape"),
    ):
        replace(crowds, **changed).save(tmp_path / "wrong.npz")
        with pytest.raises(CrowdFileError, match=f"wrong.npz is not a crowd file: {text}"):
            Crowds.load(tmp_path / "wrong.npz")
    whole = (tmp_path / "wrong.npz").read_bytes()
    for part in (b"", whole[: len(whole) // 2]):
        (tmp_path / "part.npz").write_bytes(part)
        with pytest.raises(CrowdFileError, match="not a crowd file"):
            Crowds.load(tmp_path / "part.npz")
    with pytest.raises(CrowdFileError, match="not a crowd file"):
        Crowds.load(tmp_path / "other.npz")


def test_windows_roll_out_to_what_was_observed(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT)
    rows = torch.arange(0, len(windows), 7)
    context, actions = windows.batch(rows)
    states = rollout(context.initial_state(), actions, 0.1)
    walked = from_frame(states[..., :2], context.pose)
    scene, agent, now = windows.index[rows].unbind(1)
    truth = windows.observed[scene[:, None], agent[:, None], now[:, None] + torch.arange(1, 53)]
    error = (walked - truth).norm(dim=-1)
    assert error.median() < 1e-3 and error.quantile(0.95) < 0.05
    assert torch.allclose(context.pose[:, :2], windows.states[scene, agent, now, :2])


def test_mirror_images_mirror_everything(crowds):
    once, twice = CrowdWindows(crowds, "train", COMPACT), CrowdWindows(crowds, "train", COMPACT, mirror=True)
    count = len(once)
    assert len(twice) == 2 * count
    (a, actions), (b, mirrored) = (twice.batch(torch.tensor([0, 50, 90]) + o) for o in (0, count))
    assert torch.allclose(actions * torch.tensor([1.0, -1.0]), mirrored)
    flip = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    assert torch.allclose(a.ego * flip, b.ego, atol=1e-4)
    assert torch.allclose(a.neighbors * flip, b.neighbors, atol=1e-4)
    points = torch.rand(3, 40, 2) * 4 - 1
    assert a.maps is not None and b.maps is not None
    here = a.maps.sample(from_frame(points, a.pose), a.scene)
    there = b.maps.sample(from_frame(points * torch.tensor([1.0, -1.0]), b.pose), b.scene)
    assert torch.allclose(here, there, atol=1e-3)


def test_neighbors_of_a_window_are_the_others_of_its_scene(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT)
    context, _ = windows.batch(torch.tensor([0]))
    scene, agent, now = windows.index[0].tolist()
    others = windows.present[scene, :, now].sum().item() - 1
    assert (context.neighbors[0, :, -1, 7] > 0).sum().item() == others
    nearest = from_frame(context.neighbors[:, :1, -1, :2], context.pose)[0, 0]
    gaps = (windows.states[scene, :, now, :2] - nearest).norm(dim=1)
    assert gaps.min() < 1e-4 and gaps.argmin() != agent


def test_nobody_is_their_own_neighbor(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT)
    context, _ = windows.batch(torch.arange(0, len(windows), 5))
    now = context.neighbors[:, :, -1]
    seen = now[..., 7] > 0
    assert seen.any() and (~seen).any()  # scenes are not all full
    assert now[..., :2].norm(dim=-1)[seen].min() > 2 * crowds.radius


def test_true_futures_of_neighbors_lead_where_they_walked(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT)
    rows = torch.arange(0, len(windows), 31)
    context, _ = windows.batch(rows)
    assert context.neighbor_actions is not None
    now = context.neighbors[:, 0, -1]  # the nearest of each
    start = torch.stack([now[:, 0], now[:, 1], torch.atan2(now[:, 3], now[:, 2]), now[:, 4]], 1)
    here = rollout(start, context.neighbor_actions[:, 0], 0.1)[:, -1:, :2]
    walked = from_frame(here, context.pose)[:, 0]
    scene, _, frame = windows.index[rows].unbind(1)
    later = windows.states[scene, :, frame + 52, :2]  # everybody's position at the end
    seen = now[:, 7] > 0
    assert seen.any()
    assert (later - walked[:, None]).norm(dim=-1).min(1).values[seen].max() < 0.01


def test_people_may_come_late_and_leave_early():
    positions = np.full((1, 2, 40, 2), np.nan, np.float32)
    time = np.arange(40)
    positions[0, 0] = np.stack([0.12 * time, np.zeros(40)], 1)
    positions[0, 1, 10:30] = np.stack([np.zeros(20), 0.1 * time[10:30]], 1)
    fitted = fit_crowds(positions, 0.1)
    late = fitted.states[0, 1]
    assert torch.allclose(late[10:30, :2], torch.from_numpy(positions[0, 1, 10:30]), atol=1e-4)
    assert torch.allclose(late[10:30, 3], torch.ones(20), atol=1e-3)
    assert late[:10].abs().sum() == 0 and late[30:].abs().sum() == 0
    positions[0, 0, 20] = np.nan
    with pytest.raises(CrowdFileError, match="vanishes and comes back"):
        fit_crowds(positions, 0.1)


def test_too_short_scenes_are_refused():
    spec = CrowdSpec(subset="interact", substeps=1, seconds=5.0)
    crowds = pack_crowds(spec, simulate_crowds(spec, 0, range(1)), 0)
    with pytest.raises(CrowdFileError, match="no window of 83 frames"):
        CrowdWindows(crowds, "train", COMPACT)


def test_people_of_a_moment_are_each_others_neighbors(crowds):
    windows = CrowdWindows(crowds, "train", COMPACT)
    context, actions = windows.batch_scenes(torch.tensor([0, 17, 17, 60]))
    assert context.rows is not None and context.moment is not None
    assert context.moment.unique().tolist() == [0, 1, 2, 3] and len(context) == len(actions)
    seen = context.neighbors[:, :, -1, 7] > 0
    ego, other = seen.nonzero().unbind(1)
    rows = context.rows[seen]
    assert torch.equal(context.moment[ego], context.moment[rows]) and (ego != rows).all()
    there = from_frame(context.neighbors[ego, None, other, -1, :2], context.pose[ego])[:, 0]
    assert torch.allclose(there, context.pose[rows, :2], atol=1e-4)
    scene, frame = windows.moments[17].tolist()
    alone, truth = windows.gather(*(torch.tensor([x]) for x in (scene, int(windows.index[0, 1]), frame)))
    same = (context.moment == 1) & torch.isclose(context.pose, alone.pose).all(1)
    assert same.sum() == 1 and torch.equal(actions[same], truth)
