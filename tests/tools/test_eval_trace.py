import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from footfall.models.trace.config import COMPACT, CONFIGS
from footfall.models.trace.crowd_file import pack_crowds
from footfall.models.trace.evaluation import (
    Tally,
    TrialScenes,
    average,
    evaluate,
    evaluate_filter,
    reach_waypoint,
)
from footfall.models.trace.network import Trace
from footfall.models.trace.orca_scenes import CrowdSpec, simulate_crowds
from footfall.models.trace.planner import SHIPPED, Sampling, TracePlanner
from footfall.models.trace.weights import save_model
from footfall.tools import eval_trace, eval_trace_open_loop
from footfall.tools.eval_trace_open_loop import measures_ratio

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def crowds():
    spec = CrowdSpec(substeps=1)
    return pack_crowds(spec, simulate_crowds(spec, 4, range(10)), 4)


def run(*arguments):
    parser = argparse.ArgumentParser()
    eval_trace.add_parser(parser.add_subparsers())
    args = parser.parse_args(["trace", *arguments])
    return args.run(args)


def test_truth_itself_has_no_error(crowds):
    scenes = TrialScenes(crowds, COMPACT)
    tally = Tally(scenes.dt)
    for scene in scenes:
        samples = np.repeat(scene.truth[:, None, 1:], 3, axis=1)
        tally.add(scene, samples, np.zeros(len(samples), int))
    report = tally.report()
    assert len(scenes) == 1
    assert report.obstacle == report.agent == 0
    assert report.waypoint == report.ade == report.fde == 0
    assert set(report.emd.values()) == {0.0}


def test_scenes_without_anybody_do_not_count(crowds, tmp_path, capsys):
    positions = crowds.positions.copy()
    positions[2, :, 40:] = np.nan  # all leave
    left = replace(crowds, positions=positions, split=np.full(10, 2, np.uint8))
    scenes = TrialScenes(left, COMPACT)
    assert len(scenes) == len(list(scenes)) == 9
    left.save(tmp_path / "maps.npz")
    assert run("--data", str(tmp_path / "maps.npz"), "--scenes", "0") == 2
    assert "no test scene with anybody" in capsys.readouterr().err


def test_walking_into_the_wall_is_counted(crowds):
    scenes = TrialScenes(replace(crowds, split=np.full(10, 2, np.uint8)), COMPACT)
    tally = Tally(scenes.dt)
    for scene in scenes:
        inside = scene.polygons[0].mean(0)
        samples = np.broadcast_to(inside, (len(scene.truth), 1, 50, 2))
        tally.add(scene, samples, np.zeros(len(samples), int))
    report = tally.report()
    assert report.obstacle == 1 and report.ade > 1


def test_table_stands_beside_the_papers_figures(crowds, tmp_path, capsys):
    crowds.save(tmp_path / "maps.npz")
    page = tmp_path / "results.md"
    page.write_text("# Results\n\nkept\n")
    shared = [
        "--data",
        str(tmp_path / "maps.npz"),
        "--table",
        "1",
        "--methods",
        "direct",
        "--write",
        str(page),
    ]
    assert run(*shared, "--guides", "all", "--json") == 0
    table = json.loads(capsys.readouterr().out)
    rows = {row["method"]: row for row in table["rows"]}
    assert rows["paper: TRACE"]["error"] == 0.211
    ours = rows["direct"]
    assert {"guide", "config", "emd_vel", "emd_lon", "emd_lat"} <= ours.keys()
    assert 0 <= ours["error"] < 0.5 and 0 <= ours["obstacle"] < 0.1
    assert run(*shared, "--guides", "waypoint") == 0
    text = page.read_text()
    assert text.startswith("# Results\n\nkept\n") and text.count("begin trace-1") == 1
    assert "| waypoint | direct | distilled 4 |" in text and "| all | direct |" not in text


def test_slow_rows_take_all_steps_but_not_in_haste(crowds, tmp_path, capsys, monkeypatch):
    crowds.save(tmp_path / "maps.npz")
    monkeypatch.setattr(eval_trace_open_loop, "SLOW", Sampling(solver="ddpm", samples=2))
    monkeypatch.setattr(eval_trace_open_loop, "QUICK", Sampling(solver="ddim", steps=20, samples=2))
    data = ["--data", str(tmp_path / "maps.npz"), "--guides", "waypoint"]
    slow = ["--methods", "filter", "direct_slow", "direct"]
    fast = ("direct", "distilled 4")
    for flags, expected in (
        ([], [("filter", "ddpm 100"), ("direct_slow", "ddpm 100"), fast]),
        (["--quick"], [("filter", "ddim 20"), fast]),
    ):
        assert run(*data, *slow, "--json", *flags) == 0
        rows = json.loads(capsys.readouterr().out)["rows"]
        ours = [row for row in rows if not row["method"].startswith("paper")]
        assert [(row["method"], row["sampler"]) for row in ours] == expected
        ratios = [row.get("ratio") for row in ours]
        assert ratios[:-1] == [None] * (len(ours) - 1)
        assert ratios[-1] == (None if flags else measures_ratio(ours[-1], ours[-2]))


def test_quality_is_the_mean_ratio_of_all_measures():
    slow: dict[str, Any] = {"guide": "all", "error": 0.019, "obstacle": 0.0, "agent": 0.0}
    slow |= {"emd_vel": 0.019, "emd_lon": 0.009, "emd_lat": 0.009}
    fast = slow | {"error": 0.004, "emd_vel": 0.079}  # with a thousandth added a quarter, and four times
    assert measures_ratio(slow, slow) == 1.0 == pytest.approx(measures_ratio(fast, slow))
    for guide, error in (
        ("none", None),
        ("obstacle", 0.0),
    ):  # five measures: the error is none, or one of them
        slow |= {"guide": guide, "error": error}
        assert measures_ratio(slow | {"emd_lon": 0.319}, slow) == pytest.approx(2.0)  # one is 32 times


def test_ablations_stand_beside_ours(crowds, tmp_path, capsys, monkeypatch):
    crowds.save(tmp_path / "maps.npz")
    monkeypatch.setattr(eval_trace_open_loop, "FAITHFUL", Sampling(steps=2, samples=2))
    monkeypatch.setattr(eval_trace_open_loop, "FAST", replace(SHIPPED, samples=2))
    facts = {"step": 3, "drop": 0.05, "data": [{"name": "orca-maps", "scenes": 8}, {"name": "start"}]}
    others = [tmp_path / "never_dropped.safetensors", tmp_path / "global.safetensors"]
    save_model(others[0], Trace(COMPACT), facts)
    save_model(others[1], Trace(CONFIGS["compact_global"]), facts)
    data = ["--data", str(tmp_path / "maps.npz"), "--json", "--others", *map(str, others)]
    assert run("--table", "6", *data) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    paper, (ours, other) = rows[:4], rows[4:]  # the global map belongs to table 5
    assert {row["method"] for row in paper} == {"paper: TRACE"}
    assert ours["drop"] == 0.1 and ours["data"].startswith("maps, ")
    assert (other["data"], other["drop"], other["steps"]) == ("maps", 0.05, 3)
    assert ours["ade"] < other["ade"]  # which was never trained
    assert run("--table", "5", *data) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    by_method = {row["method"]: row for row in rows if row.get("steps") in (3, None)}
    ours = next(row for row in rows if row["method"] == "compact")
    assert {"VAE", "paper: TRACE-Global"} <= {row["method"] for row in rows}
    assert ours["steps"] > 1000
    assert ours["ade"] < min(by_method[name]["ade"] for name in ("compact", "compact_global"))


def test_filtering_chooses_what_guided_sampling_would_count(crowds):
    scenes = TrialScenes(replace(crowds, split=np.full(10, 2, np.uint8)), COMPACT, limit=2)
    planner = TracePlanner(Trace(COMPACT).eval(), Sampling(steps=2, samples=4, reduced=False))
    (report,) = evaluate_filter(planner, scenes, {"waypoint": reach_waypoint}).values()
    nearest = []
    for seed, scene in enumerate(scenes):
        plan = planner.plan(scene.states, scene.size, scene.maps, seed=seed)
        miss = np.linalg.norm(plan.positions - scene.goal[:, None, None], axis=-1).min(-1)  # (A, S)
        nearest.extend(miss.min(1))
    assert report.waypoint == pytest.approx(np.mean(nearest), abs=0.02)  # the loss is a soft minimum


@pytest.mark.parametrize(("workers", "runs"), [(1, 1), (2, 1), (2, 2)])
def test_every_run_counts_and_the_figures_are_averaged(crowds, workers, runs):
    scenes = TrialScenes(replace(crowds, split=np.full(10, 2, np.uint8)), COMPACT, limit=2)
    planner = TracePlanner(Trace(COMPACT).eval(), Sampling(steps=2, samples=2, reduced=False))
    seen: list[tuple[int, int]] = []
    report = evaluate(
        planner, scenes, choice="every", workers=workers, runs=runs, progress=lambda *told: seen.append(told)
    )
    assert seen == [(done, 2 * runs) for done in range(1, 2 * runs + 1)]
    missed = []
    for first in (0, 100_000)[:runs]:
        for seed, scene in enumerate(scenes, first):
            plan = planner.plan(scene.states, scene.size, scene.maps, seed=seed)
            missed += [
                np.linalg.norm(plan.positions[:, s] - scene.goal[:, None], axis=-1).min(-1) for s in (0, 1)
            ]
    assert report.waypoint == pytest.approx(np.concatenate(missed).mean())
    one = replace(report, obstacle=0.0, emd={"speed": 1.0})
    two = replace(report, obstacle=1.0, emd={"speed": 3.0})
    assert average([one, two]).obstacle == 0.5 and average([one, two]).emd == {"speed": 2.0}


def test_pictures_are_drawn(crowds, tmp_path, capsys):
    crowds.save(tmp_path / "maps.npz")
    assert run("--data", str(tmp_path / "maps.npz"), "--pictures", str(tmp_path / "images")) == 0
    paths = capsys.readouterr().out.split()
    assert [Path(p).stem for p in paths] == ["trace_guides", "trace_samples", "trace_weights"]
    assert all((tmp_path / "images" / Path(p).name).stat().st_size > 10_000 for p in paths)


def test_samplers_are_compared_in_a_table_and_a_curve(crowds, tmp_path, capsys, monkeypatch):
    crowds.save(tmp_path / "maps.npz")
    monkeypatch.setattr(eval_trace_open_loop, "SAMPLERS", [("ddim", 6), ("distilled", 4), ("dpm", 4)])
    data = ["--data", str(tmp_path / "maps.npz"), "--pictures", str(tmp_path)]
    assert run("--table", "samplers", *data) == 0
    text = capsys.readouterr().out
    assert text.count("| dpm 4 |") == text.count("| ddim 6 |") == text.count("| distilled 4 |") == 2
    assert text.split()[-1].endswith("trace_samplers.png")
    assert (tmp_path / "trace_samplers.png").stat().st_size > 10_000


def test_missing_files_are_explained(tmp_path, capsys):
    assert run("--data", str(tmp_path / "none.npz")) == 2
    assert "footfall data orca" in capsys.readouterr().err
    assert run("--weights", str(tmp_path / "none.safetensors")) == 2
    assert "no weights at" in capsys.readouterr().err
    assert run("--runs", "0") == 2
    assert "--runs must be at least 1" in capsys.readouterr().err
