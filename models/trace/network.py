"""The TRACE denoiser: context encoders that run once, and a temporal U-Net that runs at every step."""

from copy import deepcopy
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .blocks import Mlp, StepEmbedding, TemporalUNet
from .config import TraceConfig
from .context import Context
from .diffusion import CosineSchedule
from .dynamics import rollout
from .map_encoder import MAP_ENCODERS, MapFeatures

_MANY = 5  # rows from which on bfloat16 pays


@dataclass(frozen=True)
class Encoding:
    """Everything that does not change over the denoising steps, for B rows.

    Attributes:
        condition: (B, context_width) features of the past motion and of the map as a whole.
        map: What the trajectory is queried against.
        crowd: (B, N, 6) [x y hx hy v present] of the neighbours now, ego frame.
        state: (B, 4) current state in the ego frame.
        rows: (B, N) which of the B rows each neighbour is, where all are denoised together; else None.
    """

    condition: Tensor
    map: MapFeatures
    crowd: Tensor
    state: Tensor
    rows: Tensor | None = None

    def repeat(self, samples: int) -> "Encoding":
        """Every row `samples` times in a row: the samples of one agent stay together."""

        def many(x: Tensor) -> Tensor:
            return x.repeat_interleave(samples, 0)

        rows = self.rows
        if rows is not None:  # sample m of everybody is one scene
            rows = many(rows) * samples + torch.arange(samples).repeat(len(rows))[:, None]
        return Encoding(
            many(self.condition), self.map.repeat(samples), many(self.crowd), many(self.state), rows
        )


class ActionModel(nn.Module):
    """What models of action trajectories share: encoders of the context, statistics and dynamics.

    Actions are normalised (zero mean, unit variance over the training data); states follow from them
    through the unicycle. The statistics are buffers and travel with the weights.
    """

    trajectory_mean: Tensor
    trajectory_std: Tensor
    history_mean: Tensor
    history_std: Tensor

    def __init__(self, config: TraceConfig):
        super().__init__()
        self.config = config
        frames = len(range(0, config.history, config.history_stride))
        width = config.history_width
        self.map_encoder = MAP_ENCODERS[config.map_encoder](config)
        joint = self.map_encoder.vector_width
        if not self.map_encoder.draws_people:
            self.ego = Mlp(8 * frames, config.history_hidden, width)
            self.neighbor = Mlp(8 * frames, config.history_hidden, width)
            joint += 2 * width
        self.joint = Mlp(joint, config.context_hidden, config.context_width)
        for name, size in (
            ("trajectory", 6),
            ("history", 8),
        ):  # trajectory: x y heading speed acceleration yaw rate
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    def encode(self, context: Context) -> Encoding:
        """Run the context encoders: once per plan."""
        map_features = self.map_encoder.encode(context)
        joint = [map_features.vector]
        if not self.map_encoder.draws_people:
            start = (self.config.history - 1) % self.config.history_stride  # so that the current frame is in
            ego = self._normalize_history(context.ego[:, start :: self.config.history_stride])
            neighbors = self._normalize_history(context.neighbors[:, :, start :: self.config.history_stride])
            joint = [self.ego(ego.flatten(1)), self._interaction(neighbors), *joint]
        condition = self.joint(torch.cat(joint, -1))
        crowd = context.neighbors[:, :, -1, [0, 1, 2, 3, 4, 7]]
        rows = context.rows if self.config.joint else None
        return Encoding(condition, map_features, crowd, context.initial_state(), rows)

    def normalized(self, actions: Tensor) -> Tensor:
        """Of actions (..., 2) in SI units."""
        return (actions - self.trajectory_mean[4:]) / self.trajectory_std[4:]

    def unroll(self, actions: Tensor, state: Tensor) -> Tensor:
        """States and actions, in SI units and the ego frame, of normalised actions.

        Args:
            actions: (B, T, 2) normalised.
            state: (B, 4) current state in the ego frame.

        Returns:
            (B, T, 6) [x y heading speed acceleration yaw rate].
        """
        actions = actions * self.trajectory_std[4:] + self.trajectory_mean[4:]
        return torch.cat([rollout(state, actions, self.config.dt), actions], -1)

    def _normalize_history(self, frames: Tensor) -> Tensor:
        return (frames - self.history_mean) / self.history_std * frames[..., 7:]

    def _interaction(self, neighbors: Tensor) -> Tensor:
        """(B, N, F, 8) to the max-pooled feature (B, width); zero without neighbours."""
        count = neighbors.shape[1]
        if count == 0:
            return neighbors.new_zeros(len(neighbors), self.config.history_width)
        present = neighbors[:, :, -1, 7] > 0
        features = self.neighbor(neighbors.flatten(2))
        features = features.masked_fill(~present[..., None], -torch.inf).max(1).values
        return torch.where(present.any(1, keepdim=True), features, torch.zeros((), dtype=features.dtype))


class Trace(ActionModel):
    """Predicts the clean action trajectory from a noisy one (Rempe et al. 2023, sec. 3.1 and app. A.1)."""

    signal: Tensor

    def __init__(self, config: TraceConfig):
        super().__init__(config)
        self.step = StepEmbedding(config.step_width)
        inputs = 6 + self.map_encoder.queries + (6 if config.interaction else 0) + 3 * config.nearest
        inputs += 7 if config.estimate else 0
        condition = config.context_width + config.step_width
        shape = (config.widths, condition, config.kernel, config.activation, config.fold)
        self.unet = TemporalUNet(inputs, 2, *shape)
        self.reduced_unet: TemporalUNet | None = None
        signal = CosineSchedule(config.diffusion_steps).alphas_cumprod
        self.register_buffer("signal", signal, persistent=False)

    def forward(
        self,
        noisy: Tensor,
        k: Tensor,
        encoding: Encoding,
        neighbors: Tensor | None = None,
        estimate: Tensor | None = None,
    ) -> Tensor:
        """Clean actions predicted from noisy ones.

        Args:
            noisy: (B, horizon, 2) normalised actions at diffusion step k.
            k: (B,) step indices, 0 is the least noisy.
            encoding: B rows.
            neighbors: (B, N, horizon, 2) the neighbours' actions at step k. By default those of the rows the
                encoding names; without any, neighbours keep their velocity.
            estimate: (B, horizon, 2) the last estimate of the clean actions, where the configuration reads it;
                None at the first step.

        Returns:
            (B, horizon, 2) normalised clean actions.
        """
        trajectory = self.unroll(noisy, encoding.state)  # (B, T, 6) metres, in the ego frame
        known = estimate if self.config.estimate else None
        with torch.no_grad():
            ahead = trajectory if known is None else self.unroll(known, encoding.state)
            positions = ahead[..., :2].detach()
            queries = [self.map_encoder.query(encoding.map, positions)]
            queries += self._crowd_queries(positions, encoding, neighbors)
        normal = (trajectory - self.trajectory_mean) / self.trajectory_std
        if encoding.map.grid is not None:  # a learned grid is trained through its queries
            queries[0] = self.map_encoder.query(encoding.map, positions)
        if self.config.estimate:
            share = float(known is not None)
            read = (ahead - self.trajectory_mean) / self.trajectory_std * share
            queries += [read, torch.full_like(read[..., :1], share)]
        condition = torch.cat([encoding.condition, self.step(k)], -1)
        unet = self.reduced_unet if self.reduced_unet is not None and len(noisy) >= _MANY else self.unet
        kind = torch.bfloat16 if unet is self.reduced_unet else noisy.dtype
        out = unet(torch.cat([normal, *queries], -1).to(kind), condition.to(kind)).to(noisy.dtype)
        a, skip = self.signal[k][:, None, None], self.config.skip
        return (skip * a.sqrt() * noisy + (1 - a) * out) / (skip * a + 1 - a)

    def _crowd_queries(self, positions: Tensor, encoding: Encoding, neighbors: Tensor | None) -> list[Tensor]:
        """What is seen of the neighbours along trajectories (B, T, 2): (B, T, ...) each."""
        config = self.config
        if not (config.interaction or config.nearest):
            return []
        if not encoding.crowd[..., 5].any():  # nobody is near
            return [positions.new_zeros(*positions.shape[:2], 6 * config.interaction + 3 * config.nearest)]
        crowd = self._crowd_paths(positions, encoding, neighbors)
        fields = [crowd_field(positions, crowd)] if config.interaction else []
        return fields + ([nearest_neighbors(positions, crowd, config.nearest)] if config.nearest else [])

    def _crowd_paths(self, positions: Tensor, encoding: Encoding, actions: Tensor | None) -> Tensor:
        """(B, N, T, 3) where the neighbours walk, in the ego frame, and their presence."""
        now = encoding.crowd
        speed, present = now[..., 4], now[..., 5]
        if actions is not None:
            start = torch.nn.functional.pad(speed[..., None], (3, 0))
            path = self.unroll(actions, start)[..., :2]  # each in a frame of its own
        elif encoding.rows is not None:
            path = positions[encoding.rows]
        else:
            time = torch.arange(1, positions.shape[1] + 1) * self.config.dt
            path = torch.stack([speed[..., None] * time, torch.zeros_like(time).expand(*speed.shape, -1)], -1)
        cos, sin = now[..., 2, None], now[..., 3, None]
        x = now[..., 0, None] + cos * path[..., 0] - sin * path[..., 1]
        y = now[..., 1, None] + sin * path[..., 0] + cos * path[..., 1]
        return torch.stack([x, y, present[..., None].expand_as(x)], -1)

    def prepared(self, reduced: bool = True) -> "Trace":
        """A copy for inference; it must not be trained any more.

        Args:
            reduced: The U-Net computes in bfloat16, unless rows are so few that this is slower.
        """
        copy = deepcopy(self).requires_grad_(False)
        copy.unet.prepare()
        if reduced:
            copy.reduced_unet = deepcopy(self.unet).requires_grad_(False).bfloat16()
            copy.reduced_unet.prepare()
        return copy


def crowd_field(positions: Tensor, crowd: Tensor, scales: tuple[float, float] = (0.5, 1.5)) -> Tensor:
    """Gaussian-weighted sums over neighbours, at each trajectory point and time: amount, and mean direction.

    Args:
        positions: (B, T, 2) [m].
        crowd: (B, N, T, 3) positions at the same times and presence.
        scales: Standard deviations of the two weightings [m].

    Returns:
        (B, T, 6): for each scale the summed weight and the weighted sum of relative positions.
    """
    relative = crowd[..., :2] - positions[:, None]
    square = relative.square().sum(-1)
    fields = []
    for scale in scales:
        weight = torch.exp(square * (-0.5 / scale**2)) * crowd[..., 2]  # (B, N, T)
        fields += [weight.sum(1)[..., None], (weight[..., None] * relative).sum(1) / scale]
    return torch.cat(fields, -1)


def nearest_neighbors(positions: Tensor, crowd: Tensor, count: int, reach: float = 2.0) -> Tensor:
    """Direction and closeness of the nearest neighbours at each trajectory point and time, nearest first.

    Args:
        positions: (B, T, 2) [m].
        crowd: (B, N, T, 3) positions at the same times and presence.
        count: How many; fewer neighbours leave zeros.
        reach: Distance from which on a neighbour is not there [m].

    Returns:
        (B, T, 3 * count): of each the direction times the closeness, which is `reach` less the distance [m],
        and the closeness itself.
    """
    relative = crowd[..., :2] - positions[:, None]
    distance = relative.square().sum(-1).sqrt().masked_fill(crowd[..., 2] <= 0, reach)
    missing = max(count - distance.shape[1], 0)
    distance = torch.nn.functional.pad(distance, (0, 0, 0, missing), value=reach)
    relative = torch.nn.functional.pad(relative, (0, 0, 0, 0, 0, missing))
    distance, index = distance.topk(count, 1, largest=False)  # (B, count, T)
    relative = relative.gather(1, index[..., None].expand(-1, -1, -1, 2))
    close = (reach - distance).clamp(min=0.0)[..., None]
    features = torch.cat([relative * close / distance.clamp(min=1e-3)[..., None], close], -1)
    return features.transpose(1, 2).flatten(2)
