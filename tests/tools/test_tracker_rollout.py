"""What a tracker did, written down: beside the clip, with its own rewards."""

import numpy as np
import pytest
import torch

from footfall.models.body import describe, shape_for
from footfall.models.motion.library import MotionLibrary
from footfall.models.motion.walk_cycle import walk_cycle
from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.config import TrackerConfig
from footfall.models.pacer.policy import ActorCritic
from footfall.models.pacer.tracker_env import TrackerEnv
from footfall.tools.rollout_log import read_rollout, write_rollout
from footfall.tools.tracker_rollout import roll_out


def test_a_tracker_s_rollout_holds_what_it_did_and_was_rewarded_for(tmp_path):
    torch.set_num_threads(1)
    body = describe(shape_for(1.75, 75.0))
    library = MotionLibrary([walk_cycle(body, speed, duration=1.0) for speed in (1.0, 1.4)], [body])
    config = TrackerConfig(worlds=1, physics=Physics(threads=1), hidden=(16,), horizon=4, minibatch=16)
    env = TrackerEnv(config, library, 1)
    torch.manual_seed(0)
    model = ActorCritic(env.observation.size, env.n_actions, config.hidden, config.noise)
    (take,) = read_rollout(write_rollout(tmp_path / "rollout.mcap", roll_out(model, config, library, [1])))
    assert take.name == library.clips[1].name and 5 < len(take) <= library.lengths[1]
    start = library.starts[1]
    assert take.reference is not None and take.contacts is not None
    assert np.array_equal(take.reference, library.states[0, start : start + len(take)])
    assert take.states[0, :, :3] == pytest.approx(
        take.reference[0, :, :3], abs=1e-4
    )  # placed on the first frame
    assert take.terms["places"][0] == pytest.approx(1.0, abs=1e-3)
    gap = (take.states[..., :3] - take.states[:, :1, :3]) - (
        take.reference[..., :3] - take.reference[:, :1, :3]
    )
    _, sharpness = config.rewards.places
    assert take.terms["places"] == pytest.approx(
        np.exp(-sharpness * np.square(gap).sum(-1).mean(-1)), abs=2e-3
    )  # DeepMimic's term, from what is in the log
    weights = {name: getattr(config.rewards, name)[0] for name in take.terms if name != "reward"}
    total = sum(weight * take.terms[name] for name, weight in weights.items())
    assert take.terms["reward"] == pytest.approx(total, abs=1e-4)
    assert take.reference_contacts is not None
    assert np.array_equal(take.reference_contacts, library.contacts[start : start + len(take)])
