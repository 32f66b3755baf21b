"""Tables 2 and 8 on a little recorded street, with an untrained network."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from footfall.models.trace.config import COMPACT
from footfall.models.trace.network import Trace
from footfall.models.trace.recordings import Recording, pack_recordings
from footfall.models.trace.vae import TraceVae
from footfall.models.trace.weights import WeightsError, load_model, save_model
from footfall.tools import cli
from footfall.tools import eval_trace_closed_loop as closed_loop


def source_of(name):
    """A training set as weights tell of it; those of ETH/UCY say what they leave out."""
    left_out = {"fold": name.split("-")[2]} if name.startswith("eth-ucy-") else {}
    return {"name": name, "scenes": 1, **left_out}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("closed_loop")
    t = np.arange(0, 20.4, 0.4)
    wall = np.array([[0.0, 3], [30, 3], [30, 4], [0, 4]])
    for fold, people in (("hotel", (0.0, 1.0)), ("eth", (-1.0,))):
        tracks = [np.column_stack([t, 1.2 * t, np.full_like(t, y)]) for y in people]
        whole = Recording("street", tracks, [(0.0, 20.0, "test")], [wall])
        pack_recordings("street", [whole], 0.25, {}).save(root / fold / "maps.npz")
    torch.manual_seed(0)
    seen = {"trace": "street", "vae": "street", "mixed_eth": "eth-ucy-eth-maps"}
    for name, place in seen.items():
        network = TraceVae(COMPACT) if name == "vae" else Trace(COMPACT)
        network.trajectory_std[4:] = 0.1
        facts = {"step": 0, "data": [source_of(place), {"name": "start"}]}
        save_model(root / f"{name}.safetensors", network, facts)
    return root


@pytest.fixture(autouse=True)
def hurry(monkeypatch):
    sampling, guidance = closed_loop.METHODS["direct"]
    monkeypatch.setitem(closed_loop.METHODS, "direct", (replace(sampling, steps=2, samples=2), guidance))
    monkeypatch.setattr(closed_loop, "VAE_ITERATIONS", 2)


def table(root, number, *more):
    arguments = ["eval", "trace", "--table", number, "--weights", str(root / "trace.safetensors"), "--json"]
    folds = ["--recorded", str(root), "--folds", "hotel", "--vae", str(root / "vae.safetensors")]
    return cli.main([*arguments, *folds, *more])


def test_table_2_has_the_papers_the_recorded_and_our_rows(root, capsys):
    assert (
        table(
            root,
            "2",
            "--methods",
            "direct",
            "direct_slow",
            "vae",
            "--others",
            str(root / "trace.safetensors"),
        )
        == 0
    )
    rows = json.loads(capsys.readouterr().out)["rows"]
    for guide in ("waypoint", "perturbed", "groups"):
        methods = [row["method"] for row in rows if row["guide"] == guide]
        assert methods[:4] == ["paper: VAE", "paper: TRACE, w 0", "paper: TRACE, w -0.5", "recorded"]
        assert methods[4:] == ["direct", "direct", "vae", "direct, trained on street"]
    assert {row["method"] for row in rows if row["guide"] == "urgent"} == {"recorded", *methods[4:]}
    recorded = {row["guide"]: row for row in rows if row["method"] == "recorded"}
    assert recorded["waypoint"]["error"] == 0.0 and recorded["waypoint"]["lon"] < 0.01
    assert recorded["groups"]["error"] == pytest.approx(0.5, abs=0.01)  # they walk 1 m apart
    ours = [row for row in rows if row["method"] == "direct"]
    assert [row["w"] for row in ours[:2]] == [0.0, -0.5]
    assert all(row["error"] < 3 and row["seconds"] > 0 for row in ours if row["guide"] == "waypoint")
    assert all(row["error"] == row["error_hotel"] for row in ours)


def test_folds_are_pooled_by_people(root, capsys, monkeypatch):
    monkeypatch.setattr(closed_loop, "GUIDES", ("waypoint", "groups"))
    assert table(root, "2", "--folds", "eth", "hotel", "--methods", "direct") == 0
    rows = [row for row in json.loads(capsys.readouterr().out)["rows"] if "paper" not in row["method"]]
    for row in rows[:3]:
        for key in ("error", "obstacle", "lon"):  # one person there, two here
            assert row[key] == pytest.approx((row[f"{key}_eth"] + 2 * row[f"{key}_hotel"]) / 3)
        assert row["agent"] == (row["agent_eth"] + row["agent_hotel"]) / 2
    for row in rows[3:]:  # nobody in eth walks with somebody
        assert row["guide"] == "groups" and row["error"] == row["error_hotel"] and "error_eth" not in row
    assert len(rows) == 6


@pytest.mark.parametrize(
    ("seen", "fold", "fits"),
    [
        ("orca-maps", "eth", True),
        ("eth-ucy-eth-maps", "eth", True),
        ("eth-ucy-eth-open", "hotel", False),
        ("eth-ucy-biwi-maps", "hotel", True),
        ("eth-ucy-zara-maps", "zara1", True),
        ("eth-ucy-zara2-maps", "zara1", False),
        ("eth-ucy-zara1-maps", "zara", False),
        ("eth-ucy-zara-maps-faster", "eth", False),
    ],
)
def test_a_network_is_not_tested_where_it_was_trained(seen, fold, fits, tmp_path):
    before = {"data": [source_of(seen)]}
    for facts in (before, {"data": [source_of("orca-maps"), {"name": "start", "step": 1, **before}]}):
        if fits:
            closed_loop.check_left_out(tmp_path, facts, fold)
        else:
            with pytest.raises(WeightsError, match=f"trained on {seen}, which holds people of {fold}"):
                closed_loop.check_left_out(tmp_path, facts, fold)


def test_a_network_that_has_seen_the_place_is_refused(root, capsys):
    assert table(root, "2", "--weights", str(root / "mixed_eth.safetensors")) == 2
    assert "holds people of hotel" in capsys.readouterr().err
    assert table(root, "2", "--others", str(root / "mixed_eth.safetensors")) == 2
    assert "holds people of hotel" in capsys.readouterr().err


def test_every_fold_with_a_map_has_weights_that_have_seen_nobody_there(capsys):
    for fold in ("eth", "hotel", "biwi", "zara", "zara1", "zara2"):
        path = closed_loop.shipped(fold)
        closed_loop.check_left_out(path, load_model(path)[1], fold)
    arguments = ["eval", "trace", "--table", "2", "--folds", "univ"]
    assert cli.main(arguments) == 2
    assert "that have seen nobody of univ: --weights" in capsys.readouterr().err


def test_table_8_sweeps_the_context_and_is_written(root, tmp_path, capsys):
    assert table(root, "8", "--write", str(tmp_path / "results.md")) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["w"] for row in rows if row["method"] == "direct"] == [0.0, -0.3, -0.5, -0.7, -1.0]
    written = (tmp_path / "results.md").read_text()
    assert "<!-- begin trace-8 -->" in written and "| -0.500 | paper: TRACE | 0.802 |" in written


def test_a_fold_that_is_not_there_is_named(root, capsys):
    assert table(root, "2", "--folds", "zara1") == 2
    assert "zara1/maps.npz" in capsys.readouterr().err


def test_table_2_has_a_picture(root, tmp_path, capsys):
    assert table(root, "2", "--pictures", str(tmp_path)) == 0
    path = tmp_path / "trace_rollouts.png"
    assert capsys.readouterr().out.split() == [str(path)] and path.stat().st_size > 10_000
