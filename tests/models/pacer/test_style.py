"""The discriminator against analytic cases, and windows against the library they come from."""

import numpy as np
import pytest
import torch

from footfall.models.body import describe
from footfall.models.motion.library import MotionLibrary
from footfall.models.motion.walk_cycle import walk_cycle
from footfall.models.pacer.style import (
    DemoWindows,
    Discriminator,
    StyleHistory,
    StyleLearner,
    gradient_penalty,
)
from footfall.models.pacer.walker_config import StyleConfig
from footfall.models.world.humanoid import actuated_joints

CONFIG = StyleConfig(hidden=(16,), batch=64, steps=2, memory=200, rate=3e-3, gradient_penalty=0.1)


def test_gradient_penalty_of_a_quadratic_is_known():
    """D(x) = x A x / 2 + b x has the gradient A x + b."""
    rng = np.random.default_rng(0)
    half = rng.normal(size=(5, 5))
    matrix, shift = half + half.T, rng.normal(size=5)
    x = rng.normal(size=(7, 5))
    a, b = torch.from_numpy(matrix), torch.from_numpy(shift)
    inputs = torch.from_numpy(x).requires_grad_()
    outputs = 0.5 * torch.einsum("ni,ij,nj->n", inputs, a, inputs) + inputs @ b
    expected = np.square(x @ matrix + shift).sum(1).mean()
    penalty = gradient_penalty(outputs, inputs)
    assert penalty.item() == pytest.approx(expected)
    penalty.backward()  # and it can be learned from: its gradient is 2 A (A x + b) / n
    assert inputs.grad is not None
    np.testing.assert_allclose(inputs.grad.numpy(), 2 * (x @ matrix + shift) @ matrix / 7, rtol=1e-9)


def test_rewards_are_the_logarithms():
    torch.manual_seed(0)
    net = Discriminator(4, CONFIG)
    windows = 3.0 * torch.randn(50, 4)
    p = torch.sigmoid(net(windows)).detach().double()
    torch.testing.assert_close(
        net.rewards(windows).double(), (-(1 - p).log() / 2).clamp(max=1), atol=1e-5, rtol=1e-4
    )
    torch.testing.assert_close(
        net.paper_rewards(windows).double(), -2 * (1 - p).clamp(min=1e-4).log(), atol=1e-4, rtol=1e-4
    )


def test_history_is_whole_after_a_window_within_one_episode():
    history = StyleHistory(2, 3, 4)
    for k in range(6):
        history.push(np.full((2, 3), k, np.float32))
        if k == 2:
            history.forget(np.array([1]))
    assert history.whole.tolist() == [True, False]
    np.testing.assert_array_equal(history.windows[0].reshape(4, 3)[:, 0], [2, 3, 4, 5])
    history.push(np.zeros((2, 3), np.float32))
    assert history.whole.all()


@pytest.fixture(scope="module")
def demos():
    body = describe(np.zeros(10))
    library = MotionLibrary([walk_cycle(body, 1.0, 2.0), walk_cycle(body, 1.4, 2.0)], [body])
    return DemoWindows(library, actuated_joints("lite"), 5)


def test_demo_windows_are_consecutive_frames(demos):
    windows = demos.sample(40, np.random.default_rng(0)).reshape(40, 5, -1)
    features = demos._features[0]
    for window in windows:
        first = int(np.abs(features - window[0]).sum(1).argmin())
        np.testing.assert_array_equal(window, features[first : first + 5])
    velocity = windows[:, :, 6]
    assert 0.7 < velocity.mean() < 1.7  # forwards, in the heading frame


def test_it_learns_to_tell_shaken_motion_from_captured(demos):
    torch.manual_seed(0)
    rng = np.random.default_rng(1)
    size = demos.sample(1, rng).shape[1]
    learner = StyleLearner(Discriminator(size, CONFIG), demos)
    figures = {}
    for _ in range(60):
        fake = demos.sample(128, rng)
        figures = learner.learn(fake + 0.3 * rng.normal(size=fake.shape).astype(np.float32))
    assert figures["disc_accuracy_demo"] > 0.9 and figures["disc_accuracy_walker"] > 0.9
    good = learner.discriminator.rewards(torch.from_numpy(demos.sample(50, rng)))
    assert good.mean() > 0.3 and good.max() <= 1.0
    assert len(learner._memory) <= CONFIG.memory
