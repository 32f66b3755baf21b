"""The planner's bench runs, and what it reports is consistent."""

import json

import pytest
import torch

from footfall.tools import cli
from footfall.tools.bench_planner import measure, street


def test_times_are_reported_by_number_of_people(capsys):
    threads = torch.get_num_threads()
    arguments = [
        "--agents",
        "1",
        "3",
        "--samples",
        "2",
        "--steps",
        "2",
        "--threads",
        "1",
        "--scenes",
        "0",
        "--json",
    ]
    assert cli.main(["bench", "planner", *arguments]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert set(figures["plan_ms"]) == set(figures["plan_cpu_ms"]) == {"1", "3"}
    assert min(figures["plan_ms"].values()) > 0
    assert figures["sampler"] == "dpm 2" and 50 < figures["memory_mb"] < 3000
    assert "speedup" not in figures
    assert torch.get_num_threads() == threads


def test_people_of_the_bench_stand_apart():
    states, size, _, wishes = street(10)
    gap = (states[:, None, -1, :2] - states[:, -1, :2]) ** 2
    assert (gap.sum(-1) ** 0.5 + 9 * (gap.sum(-1) == 0)).min() > size.max()
    assert [wish.name for wish in wishes] == ["waypoint", "agent_avoid", "obstacle_avoid"]


def test_foreign_weights_are_refused(capsys, tmp_path):
    assert cli.main(["bench", "planner", "--weights", str(tmp_path / "none.safetensors")]) == 2
    assert "there are no weights" in capsys.readouterr().err


@pytest.mark.slow
def test_few_steps_are_as_good_as_a_hundred_and_much_faster():
    figures = measure([1], samples=4, threads=1, scenes=1)
    assert figures["speedup"] > 4
    ours, slow = figures["error"]
    assert figures["quality_ratio"] == pytest.approx(ours / slow, rel=0.05)
