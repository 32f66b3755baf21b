"""The VAE baseline, controlled by optimising its latents at test time (Rempe et al. 2023, app. C.4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from .blocks import Mlp
from .config import TraceConfig
from .context import Context
from .diffusion import CosineSchedule
from .guidance import FutureOf
from .network import ActionModel
from .objectives import Objective
from .sampling import Sampling
from .scene_planner import ScenePlanner
from .weights import WeightsError, load_tensors

WEIGHTS = Path(__file__).parent.parent / "weights" / "trace_vae_compact.safetensors"
LATENT = 64
KL_WEIGHT = 1e-4


class TraceVae(ActionModel):
    """A conditional VAE of action trajectories behind the same context encoders as TRACE.

    The posterior sees the true future, the decoder a latent and the 256 features of the context. The map
    enters through its global feature only, so it takes a map encoder that has one.

    Raises:
        ValueError: With a map encoder that is only queried along trajectories.
    """

    def __init__(self, config: TraceConfig):
        super().__init__(config)
        if not self.map_encoder.vector_width:
            raise ValueError(f"the VAE needs a global map feature; {config.map_encoder!r} maps have none")
        width = config.context_width
        self.posterior = Mlp(6 * config.horizon + width, (512, 256), 2 * LATENT)
        self.decoder = Mlp(LATENT + width, (512, 512), 2 * config.horizon)

    def decode(self, latent: Tensor, condition: Tensor) -> Tensor:
        """Latents (B, 64) and context features (B, 256) to normalised actions (B, horizon, 2)."""
        return self.decoder(torch.cat([latent, condition], -1)).unflatten(-1, (self.config.horizon, 2))

    def infer(self, clean: Tensor, state: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance (B, 64) of the latent of normalised true actions (B, horizon, 2)."""
        trajectory = (self.unroll(clean, state) - self.trajectory_mean) / self.trajectory_std
        mean, log_variance = self.posterior(torch.cat([trajectory.flatten(1), condition], -1)).chunk(2, -1)
        return mean, log_variance.clamp(-10, 10)


class VaeStep(nn.Module):
    """Encoders, posterior and decoder in a single call, as data-parallel training wants it."""

    def __init__(self, vae: TraceVae):
        super().__init__()
        self.vae = vae

    def forward(self, clean: Tensor, noise: Tensor, context: Context) -> tuple[Tensor, Tensor, Tensor]:
        """Reconstructed actions (B, horizon, 2), mean and log variance of the latents (B, 64)."""
        encoding = self.vae.encode(context)
        mean, log_variance = self.vae.infer(clean, encoding.state, encoding.condition)
        latent = mean + noise * torch.exp(log_variance / 2)
        return self.vae.decode(latent, encoding.condition), mean, log_variance


def vae_loss(
    model: nn.Module,
    vae: TraceVae,
    schedule: CosineSchedule,
    context: Context,
    actions: Tensor,
    generator: torch.Generator,
    drop: float = 0.1,
) -> Tensor:
    """Mean squared error of states and actions, normalised as in `denoising_loss`, plus 1e-4 KL (app. C.4).

    Args:
        model: `VaeStep(vae)` or a data-parallel wrapper of it.
        vae: Holds the statistics and the dynamics.
        schedule: Unused: a VAE has no noise schedule.
        context: B samples.
        actions: (B, horizon, 2) true actions, SI units.
        generator: Draws latents and drop-outs.
        drop: Probability with which the map, and independently the neighbours, are dropped.
    """
    lost = torch.rand(2, len(actions), generator=generator) < drop
    context = context.drop(maps=lost[0], neighbors=lost[1])
    clean = vae.normalized(actions)
    noise = torch.randn(len(actions), LATENT, generator=generator)
    predicted, mean, log_variance = (x.float() for x in model(clean, noise, context))
    state = context.initial_state()
    error = (vae.unroll(predicted, state) - vae.unroll(clean, state)) / vae.trajectory_std
    return error.square().mean() + KL_WEIGHT * divergence(mean, log_variance).mean()


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """(B,) Kullback-Leibler divergence of diagonal Gaussians (B, 64) from the standard normal."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).sum(-1)


@dataclass(frozen=True)
class LatentWalk:
    """Draws latents of the VAE and walks them towards the objectives (eq 23).

    Attributes:
        vae: Trained baseline.
        samples: Futures per agent.
        iterations: Steps of Adam.
        rate: Learning rate of Adam.
        strength: alpha, weight of the objectives against the prior.
    """

    vae: TraceVae
    samples: int
    iterations: int
    rate: float = 0.02
    strength: float = 10.0

    def sample(
        self,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        generator: torch.Generator,
        start: Tensor | None = None,
    ) -> Tensor:
        """(A, M, horizon, 2) normalised actions; see `ActionSource`. A VAE cannot warm-start."""
        latent = torch.randn(len(context), self.samples, LATENT, generator=generator)
        with torch.no_grad():
            condition = self.vae.encode(context).condition[:, None].expand(-1, self.samples, -1)
        if objectives:
            latent = self._optimize(latent, condition, future_of, objectives)
        with torch.no_grad():
            return self.vae.decode(latent, condition)

    def _optimize(
        self, latent: Tensor, condition: Tensor, future_of: FutureOf, objectives: Sequence[Objective]
    ) -> Tensor:
        latent.requires_grad_()
        optimizer = torch.optim.Adam([latent], lr=self.rate)
        for _ in range(self.iterations):
            with torch.enable_grad():
                future = future_of(self.vae.decode(latent, condition))
                wanted = sum(wish.weight * wish.loss(future).sum() for wish in objectives)
                loss = self.strength * wanted + latent.square().sum() / 2  # -log p(z) up to a constant
            (latent.grad,) = torch.autograd.grad(loss, latent)
            optimizer.step()
        return latent.detach()


class VaePlanner(ScenePlanner):
    """Plans with the VAE, in as many steps of Adam as TRACE has of diffusion (200 in closed loop).

    `how` has the `rate` and the `strength` of `LatentWalk`.
    """

    def __init__(self, vae: TraceVae, samples: int = 10, iterations: int = 100, **how: float):
        sampling = Sampling(samples=samples, reduced=False)
        super().__init__(vae, sampling, LatentWalk(vae, samples, iterations, **how))


def load_vae(path: Path = WEIGHTS) -> tuple[TraceVae, dict]:
    """Read a trained VAE, ready for inference, and its facts.

    Raises:
        WeightsError: When the file is missing, broken, or holds another model.
    """
    tensors, facts = load_tensors(path)
    try:
        vae = TraceVae(TraceConfig.from_dict(facts["config"]))
        vae.load_state_dict(tensors)
    except (KeyError, RuntimeError, ValueError) as error:
        raise WeightsError(f"{path} holds no VAE: {error}") from error
    for parameter in vae.parameters():
        parameter.requires_grad_(False)
    return vae.eval(), facts
