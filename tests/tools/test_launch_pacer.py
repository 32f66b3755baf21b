"""A graph whose people obey physics: they stay on their feet, two runs send the same bytes, and it regresses."""

import json

import pytest

pytestmark = pytest.mark.slow


def launch(footfall, log):
    out = footfall("launch", "physics", "--duration", "5", "--record", log, "--json", "--set", "count=4")
    return json.loads(out.splitlines()[-1])


@pytest.fixture(scope="module")
def logs(tmp_path_factory, footfall):
    folder = tmp_path_factory.mktemp("pacer")
    return folder, [launch(footfall, folder / f"{name}.mcap") for name in "ab"]


def test_people_walk_and_the_same_seed_sends_the_same_bytes(logs, footfall):
    folder, (first, second) = logs
    hashes = [footfall("log", "hash", folder / f"{name}.mcap").split()[0] for name in "ab"]
    assert hashes[0] == hashes[1]
    assert first["agents"] == second["agents"] > 0
    assert first["falls"] == 0
    assert first["topics"]["body_actions"]["sent"] >= 150


def test_the_controller_is_replayed_exactly(logs, footfall):
    folder, _ = logs
    facts = json.loads(footfall("regress", folder / "a.mcap", "--node", "controller", "--json"))
    assert facts["same"] and facts["topics"]["body_actions"]["now"] >= 150


def test_a_kinematic_simulator_says_what_is_wrong(footfall):
    setting = ("--set", "count=2", "--set", "controller=pacer")
    said = footfall("launch", "crossing", "--duration", "5", *setting, code=2)
    assert "needs a controller that says where bodies are" in said and "mode: physics" in said
