from dataclasses import replace

import pytest
import torch

from footfall.models.trace.config import COMPACT, PAPER
from footfall.models.trace.context import scene_context
from footfall.models.trace.diffusion import CosineSchedule
from footfall.models.trace.objectives import Objective
from footfall.models.trace.vae import (
    KL_WEIGHT,
    LATENT,
    TraceVae,
    VaePlanner,
    VaeStep,
    divergence,
    load_vae,
    vae_loss,
)
from footfall.models.trace.weights import WeightsError, load_model, save_model

SMALL = replace(COMPACT, context_width=32, history_width=16, history_hidden=(16,), context_hidden=(32,))


def walkers(agents=3):
    states = torch.zeros(agents, 31, 4)
    states[..., 0] = 0.12 * torch.arange(-30, 1)
    states[..., 1] = 2.0 * torch.arange(agents)[:, None]
    states[..., 3] = 1.2
    return states, torch.full((agents, 2), 0.6)


@pytest.fixture
def vae():
    torch.manual_seed(0)
    vae = TraceVae(SMALL)
    vae.trajectory_std[4:] = 0.5
    return vae.eval()


def test_the_divergence_is_torchs():
    mean, log_variance = torch.randn(5, LATENT), torch.randn(5, LATENT)
    posterior = torch.distributions.Normal(mean, (log_variance / 2).exp())
    prior = torch.distributions.Normal(torch.zeros(LATENT), torch.ones(LATENT))
    assert torch.allclose(
        divergence(mean, log_variance), torch.distributions.kl_divergence(posterior, prior).sum(-1), rtol=1e-4
    )


def test_the_loss_is_reconstruction_and_divergence(vae):
    states, size = walkers()
    context = scene_context(states, size)
    actions = 0.3 * torch.randn(3, SMALL.horizon, 2)
    loss = vae_loss(
        VaeStep(vae), vae, CosineSchedule(), context, actions, torch.Generator().manual_seed(4), drop=0.0
    )
    generator = torch.Generator().manual_seed(4)
    torch.rand(2, 3, generator=generator)
    noise = torch.randn(3, LATENT, generator=generator)
    clean = actions / 0.5
    encoding = vae.encode(context)
    mean, log_variance = vae.infer(clean, encoding.state, encoding.condition)
    decoded = vae.decode(mean + noise * (log_variance / 2).exp(), encoding.condition)
    error = (vae.unroll(decoded, encoding.state) - vae.unroll(clean, encoding.state)) / vae.trajectory_std
    wanted = (error**2).mean() + KL_WEIGHT * divergence(mean, log_variance).mean()
    assert loss.item() == pytest.approx(wanted.item(), rel=1e-5)


def test_it_learns_to_reconstruct(vae):
    states, size = walkers(8)
    context, generator = scene_context(states, size), torch.Generator().manual_seed(0)
    actions = torch.linspace(-0.4, 0.4, 8)[:, None, None].expand(8, SMALL.horizon, 2)
    optimizer = torch.optim.Adam(vae.train().parameters(), 1e-3)
    losses = []
    for _ in range(60):
        loss = vae_loss(VaeStep(vae), vae, CosineSchedule(), context, actions, generator)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.2 * losses[0]


def test_latents_walk_towards_the_objectives(vae):
    states, size = walkers()
    goal = states[:, -1, :2] + torch.tensor([3.0, 1.5])
    wish = [Objective("waypoint", {"goal": goal, "temperature": 0.2})]

    def nearest(iterations, strength=1e3):
        planner = VaePlanner(vae, samples=4, iterations=iterations, rate=0.05, strength=strength)
        return planner.plan(states, size, objectives=wish).losses["waypoint"].mean()

    assert nearest(60) < 0.7 * nearest(0)
    assert nearest(60, strength=0.0) > nearest(60)  # without them the prior alone pulls


def test_the_prior_pulls_latents_to_the_mean(vae):
    states, size = walkers()
    wish = [Objective("waypoint", {"goal": torch.full((3, 2), torch.nan)})]
    spread = [
        VaePlanner(vae, samples=6, iterations=n, rate=0.05)
        .plan(states, size, objectives=wish)
        .positions.std(1)
        .mean()
        for n in (0, 60)
    ]
    assert spread[1] < 0.3 * spread[0]


def test_same_seed_same_plan(vae):
    states, size = walkers()
    first, again, other = (VaePlanner(vae, samples=3).plan(states, size, seed=s).positions for s in (5, 5, 6))
    assert first.shape == (3, 3, 50, 2) and (first == again).all() and not (first == other).all()


def test_weights_travel(vae, tmp_path):
    save_model(tmp_path / "vae.safetensors", vae, {"step": 7})
    loaded, facts = load_vae(tmp_path / "vae.safetensors")
    assert facts["step"] == 7 and loaded.config == SMALL
    assert all(torch.equal(v, loaded.state_dict()[k]) for k, v in vae.state_dict().items())
    with pytest.raises(WeightsError):
        load_model(tmp_path / "vae.safetensors")
    with pytest.raises(ValueError, match="global map feature"):
        TraceVae(PAPER)


def test_the_shipped_baseline_walks_to_waypoints():
    states, size = walkers()
    goal = states[:, -1, :2] + torch.tensor([4.0, 0.5])
    wish = [Objective("waypoint", {"goal": goal, "temperature": 0.2})]
    planner = VaePlanner(load_vae()[0], samples=5, iterations=60)
    plan = planner.plan(states, size, objectives=wish)
    path = torch.from_numpy(plan.positions[range(3), plan.chosen]).float()
    assert (path - goal[:, None]).norm(dim=-1).min(1).values.max() < 0.3
    assert (path[:, 1:] - path[:, :-1]).norm(dim=-1).max() < 0.3  # nobody runs
