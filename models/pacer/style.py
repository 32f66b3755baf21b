"""A discriminator that tells a walker's motion from motion capture (AMP, Peng et al. 2021; PACER, app. B)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import softplus

from .. import ranks
from ..motion.library import MotionLibrary
from .mathops import heading, to_heading, two_axes
from .policy import Normalizer, mlp
from .walker_config import StyleConfig
from .walker_observation import KEY_BODIES, Motion

Floats = NDArray[np.float32]

_FULL_REWARD = 2.0
"""``-log(1 - p)`` from which on a motion is as good as it gets."""
_LEAST = 1e-4  # of 1 - p, in the reward as PACER states it


def feature_count(hinges: int) -> int:
    """How many numbers `style_features` has for so many hinges."""
    return 27 + 2 * hinges


def style_features(motion: Motion) -> Floats:
    """What the discriminator sees of one moment (N, 27 + 2 H), heading frame.

    Rotation of the pelvis (6), its velocity and spin, hinge angles and rates, and ankles, wrists and head
    from the pelvis; no height, no place.
    """
    pelvis, quaternion = motion.positions[:, 0], motion.quaternions[:, 0]
    way = heading(quaternion)
    axes = two_axes(quaternion)
    keys = to_heading(way, motion.positions[:, KEY_BODIES] - pelvis[:, None])
    parts = [
        to_heading(way, axes[:, :3]),
        to_heading(way, axes[:, 3:]),
        to_heading(way, motion.velocity),
        0.3 * to_heading(way, motion.spin),
        motion.joints,
        0.1 * motion.rates,
        keys.reshape(len(keys), -1),
    ]
    return np.clip(np.nan_to_num(np.concatenate(parts, axis=1)), -10.0, 10.0).astype(np.float32)


class DemoWindows:
    """Windows of motion capture, for every body of a library.

    Args:
        library: the clips.
        hinges: (H,) which hinges exist.
        window: frames.
        fastest: m/s: faster clips are left out, slower ones are what the walker is for.
    """

    def __init__(self, library: MotionLibrary, hinges: NDArray[np.intp], window: int, fastest: float = 2.3):
        features = []
        for k in range(len(library.bodies)):
            states = library.states[k].astype(float)
            motion = Motion(
                states[..., :3],
                states[..., 3:7],
                library.root_velocity[k, :, :3],
                library.root_velocity[k, :, 3:],
                library.joints[k][:, hinges],
                library.joint_velocities[k][:, hinges],
            )
            features.append(style_features(motion))
        self._features = np.array(features)
        self.window = window
        weights = library.weights() * ((library.speeds < fastest) & (library.lengths > window))
        self._chances = np.cumsum(weights / weights.sum())
        self._starts, self._room = library.starts, np.maximum(library.lengths - window, 1)

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw windows (n, window * F)."""
        clips = np.minimum(np.searchsorted(self._chances, rng.random(count)), len(self._starts) - 1)
        frames = self._starts[clips] + (rng.random(count) * self._room[clips]).astype(int)
        bodies = rng.integers(len(self._features), size=count)
        rows = frames[:, None] + np.arange(self.window)
        return self._features[bodies[:, None], rows].reshape(count, -1)


class StyleHistory:
    """The last moments of N walkers; a window is whole once it lies within one episode."""

    def __init__(self, count: int, features: int, window: int):
        self._moments = np.zeros((count, window, features), dtype=np.float32)
        self._age = np.zeros(count, dtype=np.intp)

    def push(self, features: Floats) -> None:
        """Add a moment (N, F)."""
        self._moments = np.concatenate([self._moments[:, 1:], features[:, None]], axis=1)
        self._age += 1

    def forget(self, ids: NDArray[np.intp] | NDArray[np.bool_]) -> None:
        """Begin anew for some."""
        self._age[ids] = 0

    @property
    def whole(self) -> NDArray[np.bool_]:
        """(N,) whose window is whole."""
        return self._age >= self._moments.shape[1]

    @property
    def windows(self) -> Floats:
        """(N, window * F)."""
        return self._moments.reshape(len(self._moments), -1)


class Discriminator(nn.Module):
    """A logit: how much a window looks like motion capture.

    Args:
        size: of a window.
        config: settings.
    """

    def __init__(self, size: int, config: StyleConfig):
        super().__init__()
        self.config = config
        self.normalizer = Normalizer(size)
        self.network = mlp([size, *config.hidden, 1], 1.0)

    def forward(self, windows: Tensor) -> Tensor:
        """Logits (n,) of windows (n, size)."""
        return self.network(self.normalizer(windows))[:, 0]

    @torch.no_grad()
    def rewards(self, windows: Tensor) -> Tensor:
        """Style rewards (n,) between 0 and 1: ``-log(1 - p)``, p the chance of being real, up to a bound."""
        return (softplus(self(windows)) / _FULL_REWARD).clamp(max=1.0)

    @torch.no_grad()
    def paper_rewards(self, windows: Tensor) -> Tensor:
        """Rewards (n,) as PACER reports them: ``-2 log max(1 - p, 1e-4)``."""
        return -2.0 * (1.0 - torch.sigmoid(self(windows))).clamp(min=_LEAST).log()

    def loss(self, demo: Tensor, fake: Tensor) -> tuple[Tensor, dict[str, float]]:
        """Cross entropy with a gradient penalty on motion capture, and figures (AMP, eqs 6 and 8).

        Args:
            demo: (n, size) of motion capture.
            fake: (m, size) of the walker.
        """
        config = self.config
        seen = self.normalizer(demo).detach().requires_grad_(True)
        real = self.network(seen)[:, 0]
        unreal = self(fake)
        entropy = 0.5 * (softplus(-real).mean() + softplus(unreal).mean())
        penalty = gradient_penalty(real, seen)
        last = list(self.network.parameters())[-2]
        total = entropy + config.gradient_penalty * penalty + config.logit_cost * last.square().sum()
        figures = {
            "disc_loss": entropy.item(),
            "disc_penalty": penalty.item(),
            "disc_accuracy_demo": (real > 0).float().mean().item(),
            "disc_accuracy_walker": (unreal < 0).float().mean().item(),
        }
        return total, figures


def gradient_penalty(outputs: Tensor, inputs: Tensor) -> Tensor:
    """Mean over rows of the squared length of the gradient of outputs (n,) to inputs (n, size)."""
    (gradient,) = torch.autograd.grad(outputs.sum(), inputs, create_graph=True)
    return gradient.square().sum(-1).mean()


class StyleLearner:
    """Trains a discriminator on what walkers do now and did before.

    Args:
        discriminator: what learns.
        demos: motion capture.
        seed: of all random choices.
    """

    def __init__(self, discriminator: Discriminator, demos: DemoWindows, seed: int = 0):
        self.discriminator = discriminator
        self.demos = demos
        config = discriminator.config
        self.optimizer = torch.optim.AdamW(
            discriminator.network.parameters(), config.rate, weight_decay=config.weight_decay
        )
        self._rng = np.random.default_rng(seed)
        self._memory = np.zeros((0, 0), dtype=np.float32)

    def learn(self, windows: Floats) -> dict[str, float]:
        """Take a few steps against windows (n, size) of the walkers; returns figures."""
        config, rng = self.discriminator.config, self._rng
        if not len(windows):
            return {}
        normalizer = self.discriminator.normalizer
        figures: list[dict[str, float]] = []
        batch = max(config.batch // ranks.count(), 1)
        for _ in range(config.steps):
            demo = torch.from_numpy(self.demos.sample(batch, rng))
            new = windows[rng.integers(len(windows), size=batch)]
            old = self._memory if len(self._memory) else windows
            old = old[rng.integers(len(old), size=batch)]
            fake = torch.from_numpy(np.concatenate([new, old]))
            normalizer.observe(ranks.gathered(torch.cat([demo, fake])))
            loss, seen = self.discriminator.loss(demo, fake)
            self.optimizer.zero_grad()
            loss.backward()
            ranks.average(p.grad for p in self.discriminator.network.parameters() if p.grad is not None)
            self.optimizer.step()
            figures.append(seen)
        self._remember(windows)
        return {name: float(np.mean([f[name] for f in figures])) for name in figures[0]}

    def _remember(self, windows: Floats) -> None:
        """Keep a sample of the new windows, in place of random old ones once the memory is full."""
        config, rng = self.discriminator.config, self._rng
        kept = windows[rng.permutation(len(windows))[: config.batch]]
        if not len(self._memory):
            self._memory = kept.copy()
        elif len(self._memory) < config.memory:
            self._memory = np.concatenate([self._memory, kept])[: config.memory]
        else:
            self._memory[rng.choice(len(self._memory), len(kept), replace=False)] = kept
