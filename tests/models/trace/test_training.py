from dataclasses import replace

import pytest
import torch

from footfall.models.trace.config import COMPACT
from footfall.models.trace.context import scene_context
from footfall.models.trace.diffusion import CosineSchedule
from footfall.models.trace.network import Trace
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.training import (
    DenoisingStep,
    MovingAverage,
    denoising_loss,
    intrusion,
    overlap,
    vary_observation,
)


def walkers(agents=200):
    states = torch.zeros(agents, 31, 4)
    states[..., 0] = 0.12 * torch.arange(-30, 1)
    states[..., 1] = 0.5 * torch.arange(agents)[:, None]
    states[..., 3] = 1.2
    return scene_context(states, torch.full((agents, 2), 0.8))


def test_people_are_sometimes_seen_late_but_always_now():
    context = walkers()
    varied = vary_observation(context, torch.Generator().manual_seed(0))
    seen = varied.ego[..., 7]
    assert (seen[:, -1] == 1).all()
    assert (seen.diff(dim=1) >= 0).all()  # who came into sight stays in sight
    late = (seen[:, 0] == 0).float().mean()
    assert 0.2 < late < 0.4
    assert torch.equal(varied.ego[..., :5], context.ego[..., :5] * seen[..., None])
    assert varied.neighbors[context.neighbors[..., 7] == 0].abs().sum() == 0


def test_bodies_vary_around_those_of_the_data():
    varied = vary_observation(walkers(), torch.Generator().manual_seed(0))
    size = varied.ego[:, -1, 5:7]
    assert 0.4 <= size.min() < 0.5 and 0.9 < size.max() <= 1.0
    again = vary_observation(walkers(), torch.Generator().manual_seed(0))
    assert torch.equal(varied.ego, again.ego)


def test_balance_weighs_a_step_by_its_signal_to_noise_ratio():
    model, context = Trace(COMPACT).eval(), walkers(64)
    actions = torch.randn(64, 52, 2) / 10
    step = DenoisingStep(model)

    def loss(schedule, balance):
        generator = torch.Generator().manual_seed(0)
        with torch.no_grad():
            return denoising_loss(step, model, schedule, context, actions, generator, 0.1, balance).item()

    for a, weight in ((0.5, 1.0), (0.8, 2.0), (1e-4, 0.3), (0.9999, 10.0)):
        schedule = CosineSchedule(100)
        schedule.alphas_cumprod = torch.full((100,), a)  # one noise level only
        assert loss(schedule, 1.0) == pytest.approx(weight * loss(schedule, 0.0), rel=1e-4)


def test_two_owe_each_other_the_distance_they_truly_keep():
    states = torch.zeros(3, 31, 4)
    states[:, :, 1] = torch.tensor([0.0, 2.0, 9.0])[:, None]  # everybody looks along x
    context = scene_context(states, torch.full((3, 2), 0.8), radius=5.0)
    truth = torch.zeros(3, 52, 2)
    truth[0, 26:, 1] = 1.3  # 0.7 m from the second: nearer than allowed, but so it was
    guess = truth.clone()
    guess[1, :, 1] = -0.9  # leads the second person towards the first
    depth = overlap(guess, truth, context, apart=0.85)
    half_of_the_time = 0.5 * (0.7 - 0.2)
    assert depth[:2].tolist() == pytest.approx([half_of_the_time] * 2, abs=1e-4)
    assert depth[2] == 0.0


def test_walking_into_a_wall_counts_by_its_depth_where_the_map_is_known():
    axis = torch.arange(-5.0, 5.0, 0.1)
    wall = (axis > 2.0).expand(100, 100)  # fills the half plane beyond x = 2
    maps = SceneMaps.from_raster({"obstacle": wall.numpy()}, 0.1, (-5.0, -5.0))
    states = torch.zeros(2, 31, 4)
    states[..., 2] = torch.pi / 2  # both look along y, and have walked to the left of the wall
    context = scene_context(states, torch.full((2, 2), 0.8), maps)
    guess = torch.zeros(2, 52, 2)
    guess[:, 26:, 1] = -1.8  # to the right of them, 0.2 m before the wall, half of the time
    depth = intrusion(guess, context, apart=0.4)
    assert depth.tolist() == pytest.approx([0.5 * (0.4 - 0.2)] * 2, abs=0.03)
    unknown = context.drop(torch.tensor([True, False]), torch.tensor([False, False]))
    assert intrusion(guess, unknown, apart=0.4)[0] == 0.0 < intrusion(guess, unknown, apart=0.4)[1]
    assert intrusion(guess, scene_context(states, torch.full((2, 2), 0.8)), 0.4).tolist() == [0.0, 0.0]


def test_absolute_errors_of_actions_count_where_people_have_settled():
    model, context = Trace(COMPACT).eval(), walkers(64)
    actions = torch.randn(64, 52, 2) / 10
    off = torch.tensor([0.3, -0.1])  # of the normalised actions

    def loss(a, calm):
        def wrong(noisy, k, context, neighbors, twice):
            return (actions - model.trajectory_mean[4:]) / model.trajectory_std[4:] + off

        schedule, generator = CosineSchedule(100), torch.Generator().manual_seed(0)
        schedule.alphas_cumprod = torch.full((100,), a)
        return denoising_loss(wrong, model, schedule, context, actions, generator, calm=calm)  # pyright: ignore

    for a in (0.1, 0.9, 1.0):
        assert loss(a, 2.0) - loss(a, 0.0) == pytest.approx(2.0 * a**8 * 0.2, abs=1e-5)


def test_people_of_one_moment_are_equally_noisy_and_learn_with_and_without_an_estimate():
    model = Trace(COMPACT).eval()
    context = replace(walkers(60), moment=torch.arange(60) // 20)
    levels, with_estimate = [], []

    def record(noisy, k, context, neighbors, twice):
        levels.append(k)
        with_estimate.append(twice)
        return noisy

    for seed in range(30):
        generator = torch.Generator().manual_seed(seed)
        schedule = CosineSchedule(100)
        denoising_loss(record, model, schedule, context, torch.randn(60, 52, 2), generator)  # pyright: ignore
    assert all((k.reshape(3, 20) == k.reshape(3, 20)[:, :1]).all() for k in levels)
    assert len(torch.stack(levels).unique()) > 30
    assert 5 < sum(with_estimate) < 25


def test_an_estimate_is_the_first_prediction_and_learns_nothing_itself():
    torch.manual_seed(0)
    model, context = Trace(COMPACT).eval(), walkers(4)
    noisy, k = torch.randn(4, 52, 2), torch.full((4,), 60)
    with torch.no_grad():
        encoding = model.encode(context)
        by_hand = model(noisy, k, encoding, estimate=model(noisy, k, encoding))
    assert torch.allclose(DenoisingStep(model)(noisy, k, context, twice=True), by_hand, atol=1e-6)


def test_moving_average_follows_slowly():
    layer = torch.nn.Linear(1, 1, bias=False)
    average = MovingAverage(layer, decay=0.9)
    with torch.no_grad():
        layer.weight.fill_(average.parameters["weight"].item() + 1.0)
    start = average.parameters["weight"].item()
    for _ in range(3):
        average.update(layer, step=10**6)
    assert abs(average.parameters["weight"].item() - (start + 1 - 0.9**3)) < 1e-6
