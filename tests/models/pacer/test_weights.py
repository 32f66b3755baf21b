"""Tracker files: what is written is read back, and what does not fit is refused."""

import json
from dataclasses import asdict

import pytest
import torch

from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.config import CONFIGS, TrackerConfig
from footfall.models.pacer.policy import ActorCritic
from footfall.models.pacer.weights import config_from_dict, load_tracker
from footfall.models.trace.weights import WeightsError, save_tensors

SETTINGS = TrackerConfig(hidden=(8, 4), lookahead=(1, 2, 5), noise=0.1, physics=Physics(threads=1))


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_settings_survive_json(name):
    assert config_from_dict(json.loads(json.dumps(asdict(CONFIGS[name])))) == CONFIGS[name]


def test_a_tracker_survives_its_file(tmp_path):
    torch.manual_seed(0)
    model = ActorCritic(10, 3, SETTINGS.hidden, SETTINGS.noise)
    model.normalizer.observe(torch.randn(50, 10))
    path = tmp_path / "model.safetensors"
    facts = {"config": asdict(SETTINGS), "observations": 10, "actions": 3, "samples": 5}
    save_tensors(path, model.state_dict(), facts)
    again, settings, read = load_tracker(path)
    assert settings == SETTINGS
    assert read["samples"] == 5
    seen = torch.randn(4, 10)
    torch.testing.assert_close(again.act(seen), model.act(seen))


def test_what_does_not_fit_is_refused(tmp_path):
    path = tmp_path / "model.safetensors"
    with pytest.raises(WeightsError, match="no weights at"):
        load_tracker(path)
    model = ActorCritic(10, 3, (8, 4), 0.1)
    save_tensors(path, model.state_dict(), {"config": asdict(SETTINGS), "observations": 11, "actions": 3})
    with pytest.raises(WeightsError, match="holds no tracker"):
        load_tracker(path)
    save_tensors(
        path, model.state_dict(), {"config": asdict(SETTINGS) | {"colour": "red"}, "observations": 10}
    )
    with pytest.raises(WeightsError, match="another version"):
        load_tracker(path)
