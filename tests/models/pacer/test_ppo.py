"""PPO's parts against sums written out, numpy's statistics, and a problem with a known answer."""

import numpy as np
import pytest
import torch

from footfall.models.pacer.policy import ActorCritic, Normalizer, log_prob
from footfall.models.pacer.ppo import PPO, Rollout, advantages


def by_hand(rewards, values, failed, cut, cut_values, discount, decay):
    """Advantages as sums of temporal differences, one world and step at a time."""
    steps, worlds = rewards.shape
    out = np.zeros((steps, worlds))
    for n in range(worlds):
        for t in range(steps):
            weight = 1.0
            for k in range(t, steps):
                following = 0.0 if failed[k, n] else cut_values[k, n] if cut[k, n] else values[k + 1, n]
                out[t, n] += weight * (rewards[k, n] + discount * following - values[k, n])
                weight *= discount * decay
                if failed[k, n] or cut[k, n]:
                    break
    return out


def test_advantages_are_the_discounted_sums():
    rng = np.random.default_rng(0)
    steps, worlds = 12, 7
    rewards, cut_values = rng.random((2, steps, worlds))
    values = rng.random((steps + 1, worlds))
    failed = rng.random((steps, worlds)) < 0.15
    cut = ~failed & (rng.random((steps, worlds)) < 0.15)
    r, v, f, c, e = (torch.tensor(a) for a in (rewards, values, failed, cut, cut_values))
    ours = advantages(r, v, f, c, e, 0.9, 0.8).numpy()
    np.testing.assert_allclose(ours, by_hand(rewards, values, failed, cut, cut_values, 0.9, 0.8), atol=1e-12)


def test_without_decay_advantages_plus_values_are_returns():
    rewards = torch.ones(50, 1, dtype=torch.float64)
    values = torch.rand(51, 1, dtype=torch.float64)
    failed = torch.zeros(50, 1, dtype=torch.bool)
    failed[-1] = True
    gains = advantages(rewards, values, failed, torch.zeros_like(failed), torch.zeros_like(rewards), 0.9, 1.0)
    expected = (1 - 0.9 ** np.arange(50, 0, -1)) / 0.1
    np.testing.assert_allclose((gains + values[:-1])[:, 0], expected, atol=1e-12)


def test_normalizer_has_the_statistics_of_all_it_saw():
    rng = np.random.default_rng(1)
    batches = [rng.normal(3, 2, (n, 4)).astype(np.float32) for n in (10, 1, 500, 37)]
    normalizer = Normalizer(4)
    for batch in batches:
        normalizer.observe(torch.from_numpy(batch))
    everything = np.concatenate(batches)
    np.testing.assert_allclose(normalizer.mean, everything.mean(0), rtol=1e-3)
    np.testing.assert_allclose(normalizer.variance, everything.var(0), rtol=5e-3)
    normal = normalizer(torch.from_numpy(everything)).numpy()
    np.testing.assert_allclose(normal.std(0), 1.0, rtol=5e-3)


def test_log_prob_is_the_gaussians():
    torch.manual_seed(0)
    mean, actions = torch.randn(2, 5, 3)
    log_std = torch.tensor([-1.0, 0.2, 0.5])
    reference = torch.distributions.Normal(mean, log_std.exp()).log_prob(actions).sum(-1)
    gap = log_prob(actions, mean, log_std) - reference
    torch.testing.assert_close(gap, gap[:1].expand(5))


def test_values_are_bounded():
    model = ActorCritic(4, 2, (8,), 0.1)
    with torch.no_grad():
        list(model.critic.parameters())[-1].fill_(100.0)
    assert model.values(torch.randn(20, 4)).max() <= 1.0


def learner(model, target_kl=0.02):
    bounds = (1e-4, 1e-2)
    return PPO(model, rate=3e-3, rate_bounds=bounds, target_kl=target_kl, clip=0.2, epochs=4, minibatch=256)


@pytest.mark.parametrize("bfloat16", [False, True])
def test_it_learns_the_action_that_is_rewarded(bfloat16):
    """One step, reward 1 - |a - W o|^2: the policy must become W."""
    torch.manual_seed(0)
    target = torch.tensor([[0.5, -0.3], [0.2, 0.4]])
    model = ActorCritic(2, 2, (32,), 0.2)
    ppo = learner(model)
    ppo.bfloat16 = bfloat16
    errors = []
    for _ in range(60):
        seen = torch.randn(512, 2)
        with torch.no_grad():
            means = model.actor(seen)
            actions = means + 0.2 * torch.randn_like(means)
            wanted = seen @ target.T
            reward = (1 - (actions - wanted).square().sum(-1)).clamp(0.0)
            gains = reward - model.values(seen)
        ppo.update(Rollout(seen, actions, means, gains, reward))
        errors.append((means - wanted).square().sum(-1).mean().item())
    assert errors[-1] < 0.1 * errors[0]


@pytest.mark.parametrize(("target", "falls"), [(1e-9, True), (1e3, False)])
def test_the_learning_rate_is_held_by_the_divergence(target, falls):
    torch.manual_seed(0)
    model = ActorCritic(3, 2, (16,), 0.2)
    ppo = learner(model, target_kl=target)
    seen = torch.randn(512, 3)
    with torch.no_grad():
        means = model.actor(seen)
    actions = means + 0.2 * torch.randn_like(means)
    before = ppo.rate
    figures = ppo.update(Rollout(seen, actions, means, torch.randn(512), torch.rand(512)))
    assert figures["kl"] > 0
    assert (ppo.rate < before) == falls
    assert ppo.actor_optimizer.param_groups[0]["lr"] == ppo.rate


def test_every_minibatch_in_bfloat16_sees_the_weights_of_the_last_step():
    """Weights kept by autocast for a whole update would leave the divergence at zero."""
    torch.manual_seed(0)
    model = ActorCritic(3, 2, (16,), 0.2)
    ppo = learner(model)
    ppo.bfloat16 = True
    ppo.minibatch = 128
    seen = torch.randn(512, 3)
    with torch.no_grad():
        means = model.actor(seen)
    actions = means + 0.2 * torch.randn_like(means)
    figures = ppo.update(Rollout(seen, actions, means, torch.randn(512), torch.rand(512)))
    with torch.no_grad():
        moved = 0.5 * ((model.actor(seen) - means) / 0.2).square().sum(-1).mean().item()
    assert moved > 1e-4
    assert figures["kl"] == pytest.approx(moved, rel=0.9)
