import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from footfall.models.trace.dynamics import LIMITS, fit_actions, headings_along, rollout, wrap_angle

DT = 0.1


def test_constant_turn_walks_a_circle():
    steps, speed, rate = 200, 1.4, 0.5
    state = torch.tensor([0.0, 0.0, 0.0, speed], dtype=torch.float64)
    actions = torch.tensor([0.0, rate], dtype=torch.float64).expand(steps, 2)
    states = rollout(state, actions, DT)
    # Chords of length v dt that turn by w dt lie on a circle of this radius.
    radius = speed * DT / (2 * torch.sin(torch.tensor(rate * DT / 2, dtype=torch.float64)))
    centre = _centre(states[:, :2])
    assert torch.allclose((states[:, :2] - centre).norm(dim=1), radius.expand(steps), atol=1e-9)
    assert torch.allclose(states[:, 2], rate * DT * torch.arange(1, steps + 1, dtype=torch.float64))


def _centre(points):
    """Centre of the circle through three points."""
    a, b, c = points[0], points[40], points[80]
    m = torch.stack([b - a, c - a]) * 2
    return torch.linalg.solve(m, torch.stack([b @ b - a @ a, c @ c - a @ a]))


def test_constant_acceleration_is_the_sum_of_odd_numbers():
    state = torch.tensor([1.0, 2.0, torch.pi / 2, 0.0])
    states = rollout(state, torch.tensor([2.0, 0.0]).expand(10, 2), DT)
    k = torch.arange(1, 11)
    assert torch.allclose(states[:, 3], 2.0 * k * DT)
    assert torch.allclose(states[:, 1], 2 + 2.0 * DT**2 * k * (k + 1) / 2)
    assert torch.allclose(states[:, 0], torch.ones(10), atol=1e-6)


def test_actions_are_bounded():
    states = rollout(torch.zeros(4), torch.tensor([[100.0, 100.0], [-100.0, -100.0]]), DT)
    assert torch.allclose(states[:, 3], torch.tensor([0.8, -0.2]), atol=1e-6)
    assert torch.allclose(states[:, 2], torch.tensor([LIMITS.yaw_rate * DT, 0.0]), atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_inverse_dynamics_inverts_the_rollout(seed):
    generator = torch.Generator().manual_seed(seed)
    state = torch.tensor([0.3, -0.2, 2.0, 1.3], dtype=torch.float64).expand(4, 4)
    actions = torch.randn(4, 52, 2, generator=generator, dtype=torch.float64) * torch.tensor([0.4, 0.6])
    states = rollout(state, actions, DT)
    walked = states[..., 3].min() > 0.15
    again = fit_actions(state, states[..., :2], DT)
    if walked:
        assert torch.allclose(again, actions, atol=1e-6)
    assert torch.allclose(rollout(state, again, DT)[..., :2], states[..., :2], atol=0.25)


def test_fit_catches_up_after_a_turn_it_could_not_follow():
    corner = torch.cat([torch.stack([torch.linspace(0.1, 2, 20), torch.zeros(20)], 1)], 0)
    after = torch.stack([torch.full((20,), 2.0), -torch.linspace(0.1, 2, 20)], 1)
    path = torch.cat([corner, after])
    state = torch.tensor([0.0, 0.0, 0.0, 1.0])
    error = (rollout(state, fit_actions(state, path, DT), DT)[:, :2] - path).norm(dim=1)
    assert error.max() > 0.02  # the corner is sharper than the unicycle turns
    assert error[-5:].max() < 1e-3


def test_headings_follow_the_path_and_hold_at_rest():
    path = torch.tensor([[0.0, 0.0], [0.0, 0.2], [0.0, 0.4], [0.0, 0.4], [-0.2, 0.4], [-0.2, 0.2]])
    quarter = torch.pi / 2
    expected = torch.tensor([1.0, 1.0, 1.0, 1.0, 2.0, 3.0]) * quarter
    assert torch.allclose(headings_along(path, DT), expected, atol=1e-6)
    assert headings_along(path, DT, initial=torch.tensor(0.5))[0] == 0.5


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_wrapping_keeps_the_direction(turns):
    angle = torch.linspace(-3, 3, 7, dtype=torch.float64)
    assert torch.allclose(wrap_angle(angle + 2 * torch.pi * turns), angle)


def test_the_written_gradient_is_the_gradient():
    generator = torch.Generator().manual_seed(3)
    state = torch.randn(2, 1, 4, generator=generator, dtype=torch.float64, requires_grad=True)
    actions = torch.randn(2, 3, 6, 2, generator=generator, dtype=torch.float64)
    actions[0, 0, 2], actions[1, 2, 4] = (
        torch.tensor([20.0, -9.0]),
        torch.tensor([-20.0, 9.0]),
    )  # beyond limits
    actions.requires_grad_()
    assert torch.autograd.gradcheck(lambda s, a: rollout(s, a, DT), (state, actions))
