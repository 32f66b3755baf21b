import pytest
import torch

from footfall.models.trace.choice import harm
from footfall.models.trace.dynamics import rollout
from footfall.models.trace.guidance import Guidance, GuidanceError, guide_direct
from footfall.models.trace.objectives import Future, Objective
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.settling import polished

NOW = torch.tensor([[0.0, 0.0, 0.0, 1.2]])


def future_of(actions):
    agents = len(actions)
    now = NOW.expand(agents, 4).clone()
    now[:, 1] = 3.0 * torch.arange(agents)
    return Future(rollout(now[:, None], actions * 0.3, 0.1), now, torch.full((agents,), 0.4))


def test_polyak_step_meets_a_linear_wish_at_once():
    target = torch.randn(3, 4, 5, 2)
    normal = torch.randn(5, 2)
    actions = torch.randn(3, 4, 5, 2, requires_grad=True)
    loss = torch.relu(((actions - target) * normal).sum((2, 3)))
    (gradient,) = torch.autograd.grad(loss.sum(), actions)
    step = Guidance(limit=100.0).step(loss.detach(), gradient, torch.tensor(1.0))
    after = ((actions - step - target) * normal).sum((2, 3))
    assert torch.allclose(after[loss > 0], torch.zeros(1), atol=1e-4)
    assert step[loss == 0].abs().sum() == 0


def test_variance_scale_is_eq_6():
    gradient = torch.randn(2, 3, 5, 2)
    guidance = Guidance(mode="clean", scale="variance", strength=7.0, limit=100.0)
    step = guidance.step(torch.ones(2, 3), gradient, torch.tensor(0.02))
    assert torch.allclose(step, 7 * 0.02 * gradient)
    unit = Guidance(mode="clean", scale="unit", strength=7.0, limit=100.0)
    assert torch.allclose(unit.step(torch.ones(2, 3), gradient, torch.tensor(0.02)), 7 * gradient)


def test_steps_are_limited_sample_by_sample():
    gradient = torch.ones(1, 2, 5, 2)
    gradient[0, 1] *= 0.001
    step = Guidance(scale="unit", strength=100.0, limit=0.5).step(
        torch.ones(1, 2), gradient, torch.tensor(1.0)
    )
    assert step[0, 0].square().mean().sqrt().item() == pytest.approx(0.5)
    assert step[0, 1].square().mean().sqrt().item() == pytest.approx(0.1)


def test_direct_guidance_reaches_the_waypoint_with_little_change():
    goal = torch.tensor([[4.0, 1.5]])
    wish = [Objective("waypoint", {"goal": goal, "temperature": 0.05})]
    clean = guide_direct(
        torch.zeros(1, 5, 50, 2), future_of, wish, Guidance(inner_steps=20), torch.tensor(0.0)
    )
    nearest = (future_of(clean).positions - goal[:, None, None]).norm(dim=-1).min(-1).values
    assert nearest.max() < 0.1
    assert clean.square().mean().sqrt() < 1.0


def test_careful_steps_do_not_leap_where_a_loss_cannot_become_zero():
    goal = torch.tensor([[3.0, 0.0]])  # on the way already, and yet the soft minimum is 0.6 m
    wish = [Objective("waypoint", {"goal": goal, "temperature": 1.0})]
    actions = 0.2 * torch.randn(1, 8, 50, 2, generator=torch.Generator().manual_seed(0))
    before = wish[0].loss(future_of(actions))
    bold, careful = (
        guide_direct(actions, future_of, wish, Guidance(inner_steps=6), torch.tensor(0.0), careful=c)
        for c in (False, True)
    )
    assert (wish[0].loss(future_of(careful)) <= before).all()
    assert (wish[0].loss(future_of(careful)) < before).any()
    assert (wish[0].loss(future_of(bold)) > before + 0.1).any()


@pytest.mark.parametrize("ahead", [3.03, 3.05, 3.057, 3.066, 3.09, 3.12])
def test_polish_brings_a_state_to_the_goal_even_from_halfway_between_two(ahead):
    goal = torch.tensor([[ahead, 0.02]])  # states are 0.12 m apart
    near = {"goal": goal, "temperature": 0.05, "widening": 0.3}
    best = polished(
        torch.zeros(1, 1, 50, 2), future_of, [Objective("waypoint", near)], Guidance(polish=8), lambda a: a
    )
    assert (future_of(best).positions - goal[:, None, None]).norm(dim=-1).min() < 0.011


def test_direct_guidance_parts_people():
    def side_by_side(actions):
        now = torch.tensor([[0.0, 0.0, 0.0, 1.2], [0.0, 0.5, 0.0, 1.2]])
        return Future(rollout(now[:, None], actions * 0.3, 0.1), now, torch.full((2,), 0.4))

    wish = [Objective("agent_avoid")]
    before = wish[0].loss(side_by_side(torch.zeros(2, 3, 50, 2)))
    clean = guide_direct(torch.zeros(2, 3, 50, 2), side_by_side, wish, Guidance(), torch.tensor(0.0))
    assert wish[0].loss(side_by_side(clean)).max() < 0.35 * before.min()


@pytest.mark.parametrize("side", [-0.3, -0.2, 0.2, 0.3])
def test_a_way_through_a_pillar_leads_around_it(side):
    pillar = torch.zeros(100, 100, dtype=torch.bool)
    pillar[48:53, 53:57] = True
    maps = SceneMaps.from_raster({"obstacle": pillar.numpy()}, 0.1, (-2.7, side - 5.0))

    def through(actions):
        return Future(rollout(NOW[:, None], actions, 0.1), NOW, torch.full((1,), 0.3), maps=maps)

    wish, straight = Objective("obstacle_avoid"), torch.zeros(1, 1, 50, 2)
    assert harm([wish], through(straight)).item() > 1.0
    bent = guide_direct(straight, through, [wish], Guidance(inner_steps=6), torch.tensor(0.0), careful=True)
    future = through(bent)
    assert harm([wish], future).item() < 0.01
    assert (future.positions[0, 0, -1, 1] * side < 0) and future.positions[0, 0, -1, 0] > 4.0
    assert future.states[..., 3].max() < 1.6  # at first 1.2 m/s: nobody races through


@pytest.mark.parametrize(
    "bad",
    [
        {"strength": -1.0},
        {"strength": float("nan")},
        {"limit": float("inf")},
        {"polish": 1.5},
        {"inner_steps": 0},
        {"mode": "dirty"},
        {"limit": 0.0},
        {"temperature": 0.0},
        {"haste": -0.1},
        {"haste": float("inf")},
    ],
)
def test_bad_settings_are_refused(bad):
    with pytest.raises(GuidanceError):
        Guidance(**bad)
