"""A graph that plans with TRACE: two runs send the same bytes, and the planner can be replayed step by step."""

import json

import pytest

pytestmark = pytest.mark.slow


def launch(footfall, log, *more):
    setting = ("--set", "count=4", "--set", "planner=trace", "--set", "planner.samples=3")
    out = footfall("launch", "crossing", "--duration", "5", "--record", log, "--json", *setting, *more)
    return json.loads(out.splitlines()[-1])


@pytest.fixture(scope="module")
def logs(tmp_path_factory, footfall):
    folder = tmp_path_factory.mktemp("trace")
    summaries = [launch(footfall, folder / f"{name}.mcap") for name in "ab"]
    return folder, summaries


def test_the_same_seed_sends_the_same_bytes(logs, footfall):
    folder, (first, second) = logs
    hashes = [footfall("log", "hash", folder / f"{name}.mcap").split()[0] for name in "ab"]
    assert hashes[0] == hashes[1]
    assert first["agents"] == second["agents"] > 0
    assert first["topics"]["plans"]["sent"] >= 5


def test_the_planner_is_replayed_exactly(logs, footfall):
    folder, _ = logs
    facts = json.loads(footfall("regress", folder / "a.mcap", "--node", "planner", "--json"))
    assert facts["same"] and facts["topics"]["plans"]["recorded"] == facts["topics"]["plans"]["now"] >= 5


def test_weights_that_are_not_there_end_the_launch_with_code_2(tmp_path, footfall):
    setting = ("--set", "planner=trace", "--set", f"planner.weights={tmp_path}/none.safetensors")
    text = footfall("launch", "crossing", "--duration", "1", *setting, code=2)
    assert "there are no weights at" in text and "Traceback" not in text
