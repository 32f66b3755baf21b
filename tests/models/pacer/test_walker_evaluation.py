"""The evaluation: it judges what a bad and a helpless walker do, and the tools run from end to end."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from footfall.models.body import describe
from footfall.models.body.anthropometry import shape_for
from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.crowd_evaluation import unaware
from footfall.models.pacer.policy import ActorCritic
from footfall.models.pacer.walker_config import CONFIGS
from footfall.models.pacer.walker_env import WalkerEnv
from footfall.models.pacer.walker_evaluation import Measurement, roll_out
from footfall.models.pacer.walker_weights import load_walker, walker_config_from_dict
from footfall.models.trace.weights import WeightsError, save_tensors
from footfall.tools import cli, train_pacer

SMALL = replace(
    CONFIGS["compact"],
    company=1,
    course=None,
    worlds=8,
    people=2,
    physics=Physics(threads=1),
    hidden=(8,),
    horizon=4,
    minibatch=16,
    epochs=1,
)


@pytest.fixture(scope="module")
def gait_alone():
    """A walker that shifts nothing."""
    env = WalkerEnv(SMALL)
    model = ActorCritic(env.size, env.n_actions, (8,), 0.1)
    with torch.no_grad():
        for parameter in list(model.actor.parameters())[-2:]:
            parameter.zero_()
    return model


def test_who_falls_counts_until_then(gait_alone):
    result = roll_out(gait_alone, SMALL, 6, people=2, duration=3.0)
    figures = result.summary()
    assert result.failed.mean() == figures["fail_rate"] > 0.5  # nobody keeps their balance by the gait alone
    assert figures["falls_by_cause"]["fell"] + figures["falls_by_cause"]["strayed"] == result.failed.sum()
    assert figures["rollouts"] == 6 and figures["disc_reward"] is None
    alive = np.isfinite(result.path_error)
    assert (np.diff(alive.astype(int), axis=0) <= 0).all()  # who is out stays out
    np.testing.assert_array_equal(~alive[-1], result.failed)
    assert figures["path_error_m"] == pytest.approx(result.path_error[alive].mean())
    assert result.strikes[alive.any(1)].any() and not result.strikes[~alive].any()


def test_jerk_is_the_third_derivative_of_where_joints_are():
    env = WalkerEnv(replace(SMALL, worlds=2), 2)
    bodies = [env.world.bodies[i] for i in env.world.body_index]
    measurement = Measurement(bodies, env.world.hinges, 6, env.period, env.height_at)
    still, everyone = env.motion.positions.copy(), np.arange(2)
    no, yes = np.zeros(2, dtype=bool), np.ones(2, dtype=bool)
    for k in range(-1, 6):
        t = (k + 1) * env.period
        way = np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.5]])[:, None] * t**3
        motion = replace(env.motion, positions=still + way)
        if k < 0:
            measurement.begin(motion)
        else:
            measurement.add(k, motion, everyone, yes, np.zeros(2), no, no)
    jerk = measurement.result(no).jerk
    assert np.isnan(jerk[:2]).all()
    np.testing.assert_allclose(jerk[2:], np.tile([12.0, 3.0], (4, 1)), rtol=1e-6)


def test_a_strong_push_throws_more_people_over(gait_alone):
    standing = replace(SMALL, lost=5.0)
    calm, pushed = (
        roll_out(gait_alone, standing, 6, people=2, duration=3.4, push=force) for force in (0.0, 3000.0)
    )
    late = slice(95, None)
    assert np.isfinite(pushed.path_error[late]).sum() <= np.isfinite(calm.path_error[late]).sum()
    before = slice(0, 89)
    np.testing.assert_array_equal(pushed.path_error[before], calm.path_error[before])


def test_who_does_not_know_their_body_takes_it_for_average(gait_alone):
    told = replace(SMALL, noise=0.0)
    untold = unaware(told, "their body")
    bodies = [describe(shape_for(1.5, 50)), describe(shape_for(2.0, 110))]
    envs = [WalkerEnv(config, 2, bodies, 0) for config in (told, untold)]
    knows, guesses = (env.observe() for env in envs)
    differ = np.flatnonzero((knows != guesses).any(0))
    assert len(differ) and np.ptp(differ) < 12 and not guesses[:, differ].any()
    assert unaware(told).manners is False and unaware(told).body_aware


def test_settings_survive_json_and_strangers_are_refused(tmp_path, gait_alone):
    config = replace(CONFIGS["compact_terrain"], hidden=(8,))
    assert walker_config_from_dict(json.loads(json.dumps(asdict(config)))) == config
    facts = {"config": asdict(SMALL), "observations": gait_alone.actor[0].in_features}
    facts["actions"] = gait_alone.actor[-1].out_features
    save_tensors(tmp_path / "walker.safetensors", gait_alone.state_dict(), facts)
    model, config, _ = load_walker(tmp_path / "walker.safetensors")
    assert config == SMALL
    seen = torch.randn(3, facts["observations"])
    torch.testing.assert_close(model.act(seen), gait_alone.act(seen))
    with pytest.raises(WeightsError, match="another version"):
        walker_config_from_dict(asdict(config) | {"wings": 2})
    save_tensors(tmp_path / "other.safetensors", {"a": torch.zeros(1)}, facts)
    with pytest.raises(WeightsError, match="no walker"):
        load_walker(tmp_path / "other.safetensors")


def test_train_resume_and_evaluate_from_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(CONFIGS, "compact", SMALL)
    out = tmp_path / "run"
    command = ["train", "pacer", "--out", str(out), "--threads", "1"]
    assert cli.main([*command, "--samples", "64"]) == 0
    assert cli.main([*command, "--samples", "96"]) == 0
    assert "from sample 64" in capsys.readouterr().out
    evaluate = ["eval", "pacer", "--model", str(out / "model.safetensors"), "--threads", "1"]
    assert cli.main([*evaluate, "--rollouts", "4", "--people", "2", "--duration", "1", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    expected = {"fail_rate", "path_error_m", "disc_reward", "foot_skate_mps", "rollouts", "falls_by_cause"}
    expected |= {"jerk_mps3", "power_w_per_kg", "fail_rate_by_body"}
    assert expected <= set(figures) and figures["rollouts"] == 4 and figures["samples"] == 96
    assert (out / "curve.csv").is_file() == (out / "curve.png").is_file()
    other = ["train", "pacer", "--out", str(tmp_path / "other"), "--init", str(out / "model.safetensors")]
    assert cli.main([*other, "--threads", "1", "--samples", "32"]) == 0
    few = ["--rollouts", "2", "--people", "2", "--duration", "0.2", "--json"]
    capsys.readouterr()
    assert cli.main([*evaluate, "--table", "9", *few]) == 0
    rows = [(row["terrain"], row["unaware_of"]) for row in json.loads(capsys.readouterr().out)]
    assert rows[::2] == [("crowd", ""), ("obstacles", ""), ("random", "")]
    assert rows[1::2] == [("crowd", "others"), ("obstacles", "others"), ("random", "their body")]
    assert cli.main([*evaluate, "--unaware", "their body", *few]) == 0
    strolls = [*evaluate, "--rollouts", "2", "--duration", "1", "--paths", "strolls"]
    assert cli.main([*strolls, "--json"]) == 0
    assert cli.main([*strolls, "--terrain", "crowd"]) == 2
    assert cli.main([*evaluate, "--rollouts", "0"]) == 2
    assert cli.main([*command, "--style", "2"]) == 2
    assert issubclass(train_pacer.TrainingError, ValueError)
