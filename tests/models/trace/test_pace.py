"""A distilled network keeps the pace that is wanted, and `train pace` the teacher's."""

import argparse

import numpy as np
import pytest

from footfall.models.trace.crowd_file import pack_crowds
from footfall.models.trace.evaluation import TrialScenes
from footfall.models.trace.network import Trace
from footfall.models.trace.orca_scenes import CrowdSpec, simulate_crowds
from footfall.models.trace.pace import hastened, kept_pace, mean_speed
from footfall.models.trace.planner import DISTILLED, WEIGHTS, TracePlanner
from footfall.models.trace.weights import load_model
from footfall.tools import train_pace

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def crowds():
    spec = CrowdSpec(substeps=1)
    return pack_crowds(spec, simulate_crowds(spec, 4, range(4)), 4)


@pytest.fixture(scope="module")
def student():
    return load_model(DISTILLED)[0]


def pace(*arguments):
    parser = argparse.ArgumentParser()
    train_pace.add_parser(parser.add_subparsers())
    args = parser.parse_args(["pace", *map(str, arguments)])
    return args.run(args)


def test_a_hastened_network_predicts_higher_accelerations_alone(crowds, student):
    scene = next(iter(TrialScenes(crowds, student.config, "train")))
    kept = TracePlanner(student).plan(scene.states, scene.size, scene.maps)
    slower, faster = (
        TracePlanner(hastened(student, by)).plan(scene.states, scene.size, scene.maps) for by in (0.0, 0.05)
    )
    assert np.array_equal(slower.positions, kept.positions)
    gained = (faster.speeds - kept.speeds)[..., -1]
    assert 0.2 < gained.mean() < 0.5  # .25 m/s in five seconds; each step goes on from where the last one led


def test_the_wanted_pace_is_kept_on_average(crowds, student):
    scenes = TrialScenes(crowds, student.config, "train")
    speeds = [mean_speed(TracePlanner(student), scenes, workers) for workers in (1, 2)]
    assert speeds[0] == pytest.approx(speeds[1])
    wanted = speeds[0] + 0.02
    found, told = kept_pace(student, TracePlanner, wanted, scenes)
    assert told["before"] == pytest.approx(speeds[0])
    assert told["after"] == pytest.approx(wanted, abs=0.004)
    assert mean_speed(TracePlanner(found), scenes) == pytest.approx(told["after"])
    with pytest.raises(ValueError, match="no faster with higher accelerations"):
        kept_pace(student, lambda _: TracePlanner(student), wanted, scenes)


def test_the_teachers_pace_is_measured_and_kept(crowds, tmp_path, capsys):
    crowds.save(tmp_path / "maps.npz")
    data = [
        "--data",
        tmp_path / "maps.npz",
        "--scenes",
        1,
        "--samples",
        2,
        "--out",
        tmp_path / "a.safetensors",
    ]
    assert pace(*data) == 0
    assert "all steps walk" in capsys.readouterr().out
    found, facts = load_model(tmp_path / "a.safetensors")
    assert isinstance(found, Trace) and found.config.timesteps
    told = facts["pace"]
    assert abs(told["after"] - told["wanted"]) < max(abs(told["before"] - told["wanted"]) / 2, 0.005)
    assert pace(*data, "--weights", WEIGHTS) == 2
    assert "is not distilled" in capsys.readouterr().err
    assert pace(*data, "--teacher", DISTILLED) == 2
    assert "is distilled itself" in capsys.readouterr().err
    assert pace(*data, "--scenes", 0) == 2
    assert pace(*data, "--out", tmp_path) == 2
    assert "must be a file" in capsys.readouterr().err
    assert pace("--data", tmp_path / "none.npz", "--out", tmp_path / "b.safetensors") == 2
    assert not (tmp_path / "b.safetensors").exists()
