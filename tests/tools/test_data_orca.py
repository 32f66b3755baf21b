import argparse

import numpy as np
import pytest

from footfall.models.trace.crowd_file import Crowds
from footfall.models.trace.metrics import agent_collisions, obstacle_collisions
from footfall.tools import data_orca


def run(folder, *arguments):
    parser = argparse.ArgumentParser()
    data_orca.add_parser(parser.add_subparsers())
    args = parser.parse_args(["orca", "--out", str(folder), *arguments])
    return args.run(args)


@pytest.mark.slow
def test_result_depends_on_the_seed_not_on_the_workers(tmp_path, capsys):
    for folder, workers in (("one", "1"), ("two", "2")):
        assert run(tmp_path / folder, "--subset", "interact", "--scenes", "22", "--workers", workers) == 0
    assert "22 scenes" in capsys.readouterr().out
    one, two = (Crowds.load(tmp_path / folder / "interact.npz") for folder in ("one", "two"))
    assert np.array_equal(one.positions, two.positions, equal_nan=True)
    assert not one.has_map and np.bincount(one.split).tolist() == [18, 2, 2]


@pytest.mark.slow
def test_scenes_keep_what_the_paper_promises(tmp_path):
    assert run(tmp_path, "--scenes", "10", "--workers", "1", "--seed", "3", "--area", "20") == 0
    crowds = Crowds.load(tmp_path / "maps.npz")
    assert crowds.positions.shape == (10, 10, 101, 2) and crowds.dt == 0.1 and crowds.radius == 0.4
    for scene in range(10):
        people = crowds.positions[scene][np.isfinite(crowds.positions[scene, :, 0, 0])]
        assert not agent_collisions(people, crowds.radius).any()
        assert not obstacle_collisions(people, crowds.radius, crowds.polygons_of(scene)).any()
        assert 1 <= len(crowds.polygons_of(scene)) <= 20
        speed = np.linalg.norm(np.diff(people, axis=1), axis=-1) / 0.1
        assert speed.max() < 2.01


@pytest.mark.parametrize("bad", [("--scenes", "0"), ("--workers", "0"), ("--area", "-3")])
def test_bad_numbers_are_refused(tmp_path, capsys, bad):
    assert run(tmp_path, *bad) == 2
    assert bad[0] in capsys.readouterr().err
