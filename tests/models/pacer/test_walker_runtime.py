"""The walker in a crowd does what it does in training, and its values follow the plans."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from footfall.models.body import describe, sample_shapes
from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.policy import ActorCritic
from footfall.models.pacer.walker import Walker, WalkerError
from footfall.models.pacer.walker_config import CONFIGS
from footfall.models.pacer.walker_env import WalkerEnv

SMALL = replace(
    CONFIGS["compact"],
    company=1,
    course=None,
    worlds=4,
    people=4,
    physics=Physics(threads=1),
    push_interval=0.0,
    hidden=(16,),
    manners=False,
)


@pytest.fixture
def env():
    return WalkerEnv(SMALL, seed=2)


@pytest.fixture
def model(env):
    torch.manual_seed(0)
    model = ActorCritic(env.size, env.n_actions, (16,), 0.1)
    with torch.no_grad():
        list(model.actor.parameters())[-2].normal_(0.0, 0.02)
    return model


def states_of(env):
    linear, spin = env.world.velocities()
    return np.concatenate([env.world.positions, env.world.quaternions, linear, spin], -1)


def aligned(walker, env):
    """Let the walker's references be where those of the environment were a step ago."""
    walker._reference.keep(np.arange(len(env)))
    walker._reference._gait.state[:] = env.reference._gait.state
    for name in ("root", "joints", "velocity", "rates", "_leg_angles", "_leg_rates"):
        getattr(walker._reference, name)[:] = getattr(env.reference, name)
    for name in ("position", "velocity", "heading", "turn_rate"):
        getattr(walker._reference.follower, name)[:] = getattr(env.reference.follower, name)


def test_it_asks_for_the_same_targets_as_in_training(env, model):
    env.reset()
    walker = Walker(model, SMALL)
    bodies = [env.world.bodies[i] for i in env.world.body_index]
    walker.enter(range(4), bodies, states_of(env))
    for _ in range(3):
        aligned(walker, env)
        env.lead()
        seen = env.observe()
        actions = env.unmirrored(model.act(torch.from_numpy(seen)).numpy())
        expected = env.targets(actions)
        targets = walker.step(states_of(env), env.paths, env.times)
        np.testing.assert_allclose(targets[:, env.world.hinges], expected, atol=1e-4)
        assert np.count_nonzero(targets) <= expected.size
        env.advance(actions)


def test_people_come_and_go(model):
    bodies = [describe(shape) for shape in sample_shapes(3, 0)]
    env = WalkerEnv(SMALL, bodies=bodies, worlds=3, seed=0)
    states = states_of(env)
    walker = Walker(model, SMALL)
    walker.enter([5, 9], bodies[:2], states[:2])
    walker.enter([2], bodies[2:], states[2:])
    walker.leave([5])
    assert walker.ids == [9, 2]
    alone = Walker(model, SMALL)
    alone.enter([2], bodies[2:], states[2:])
    env.paths.vertices = env.paths.vertices[1:]
    both = walker.step(states[1:], env.paths, np.zeros(2))
    env.paths.vertices = env.paths.vertices[1:]
    one = alone.step(states[2:], env.paths, np.zeros(1))
    np.testing.assert_allclose(both[1:], one, atol=5e-3)  # idle swaying differs with the row
    with pytest.raises(WalkerError, match="already"):
        walker.enter([9], bodies[:1], states[:1])
    with pytest.raises(WalkerError, match="not here"):
        walker.leave([5])
    with pytest.raises(WalkerError, match="states"):
        walker.step(states, env.paths, np.zeros(1))


def test_values_of_the_path_being_walked_are_the_critics(env, model):
    walker = Walker(model, SMALL)
    bodies = [env.world.bodies[i] for i in env.world.body_index]
    walker.enter(range(4), bodies, states_of(env))
    aligned(walker, env)
    env.lead()
    seen = torch.from_numpy(env.observe())
    expected = model.critic(model.normalizer(seen))[:, 0]
    walker.step(states_of(env), env.paths, env.times)
    plans = torch.from_numpy(env.paths.waypoints(env.times)).float()[:, None].requires_grad_()
    values = walker.values(plans)
    torch.testing.assert_close(values[:, 0], expected, atol=1e-4, rtol=1e-4)
    values.sum().backward()
    assert plans.grad is not None and plans.grad.abs().sum() > 0
    with pytest.raises(WalkerError, match="shape"):
        walker.values(plans[:, :, :5])
