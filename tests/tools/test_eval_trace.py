import argparse
import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from footfall.models.trace.config import COMPACT
from footfall.models.trace.crowd_file import pack_crowds
from footfall.models.trace.evaluation import Tally, TrialScenes
from footfall.models.trace.orca_scenes import CrowdSpec, simulate_crowds
from footfall.tools import eval_trace


@pytest.fixture(scope="module")
def crowds():
    spec = CrowdSpec(substeps=1)
    return pack_crowds(spec, simulate_crowds(spec, 4, range(10)), 4)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


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
    rows = {row[1]: dict(zip(table["head"], row, strict=True)) for row in table["rows"]}
    assert rows["paper: TRACE"]["guide error"] == 0.211
    assert 0 <= rows["direct"]["guide error"] < 0.5 and 0 <= rows["direct"]["obstacle"] < 0.1
    assert run(*shared, "--guides", "waypoint") == 0
    text = page.read_text()
    assert text.startswith("# Results\n\nkept\n") and text.count("begin trace-1") == 1
    assert "| waypoint | direct |" in text and "| all | direct |" not in text


def test_missing_files_are_explained(tmp_path, capsys):
    assert run("--data", str(tmp_path / "none.npz")) == 2
    assert "footfall data orca" in capsys.readouterr().err
    assert run("--weights", str(tmp_path / "none.safetensors")) == 2
    assert "no weights at" in capsys.readouterr().err
