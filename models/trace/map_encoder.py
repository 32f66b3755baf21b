"""The map encoders: the paper's learned feature grid, lookups in the signed distance field, and the ablations.

Each turns the map into something that is computed once per plan. The first two answer a query along the noisy
trajectory; the ablations `global` and `raster` (TRACE app. D.2) give one vector for the whole map.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .blocks import Mlp
from .config import TraceConfig
from .context import Context, from_frame
from .scene_map import MapView


@dataclass(frozen=True)
class MapFeatures:
    """What stays the same over the denoising steps: a vector an agent (B, F) and the field to query."""

    vector: Tensor
    grid: Tensor | None
    view: MapView | None
    known: Tensor

    def repeat(self, samples: int) -> "MapFeatures":
        """Every agent `samples` times in a row; the maps themselves are shared."""

        def many(x: Tensor) -> Tensor:
            return x.repeat_interleave(samples, 0)

        grid = None if self.grid is None else many(self.grid)
        view = None if self.view is None else self.view.repeat(samples)
        return MapFeatures(many(self.vector), grid, view, many(self.known))


class DistanceMapEncoder(nn.Module):
    """Signed distances of the scene: a lattice ahead of the agent, a stencil around every trajectory point.

    Nothing is drawn or convolved for an agent: a scene's field is computed once and every agent looks
    points up in it, in its own frame. Unknown maps read as zero everywhere, and a flag says so.
    """

    lattice: Tensor
    stencil: Tensor
    clip = 2.0  # beyond this distance [m] an obstacle is no different from none
    draws_people = False

    def __init__(self, config: TraceConfig):
        super().__init__()
        layers = self.layers = config.map_layers
        x, y = torch.meshgrid(torch.arange(-2.0, 11.0), torch.arange(-6.0, 7.0), indexing="ij")
        self.register_buffer("lattice", torch.stack([x, y], -1).reshape(-1, 2), persistent=False)
        ring = torch.arange(8) * torch.pi / 4
        near, far = (r * torch.stack([ring.cos(), ring.sin()], -1) for r in (0.5, 1.5))
        stencil = torch.cat([torch.zeros(1, 2), near[::2], far])  # (13, 2), aligned with the ego frame
        self.register_buffer("stencil", stencil, persistent=False)
        self.queries = len(stencil) * len(layers)
        self.vector_width = 128
        self.mlp = Mlp(len(self.lattice) * len(layers) + 1, (256, 128), self.vector_width)

    def _look_up(self, positions: Tensor, star: Tensor, view: MapView | None, known: Tensor) -> Tensor:
        """Clipped distances (B, T, P * C) at offsets (P, 2) from ego-frame positions (B, T, 2); zero if unknown."""
        if view is None:
            return positions.new_zeros(*positions.shape[:-1], len(star) * len(self.layers))
        values = view.around(positions, star).clamp(-self.clip, self.clip) * known[:, None, None]
        return values.unflatten(1, (positions.shape[1], -1)).flatten(2)

    def encode(self, context: Context) -> MapFeatures:
        """Everything about the map that does not depend on the noisy trajectory."""
        known, view = context.map_known, None
        if context.maps is not None:
            view = context.maps.select(self.layers).view(context.pose, context.scene)
        here = context.ego.new_zeros(len(context), 1, 2)
        lattice = self._look_up(here, self.lattice, view, known).flatten(1)
        vector = self.mlp(torch.cat([lattice, known[:, None].to(lattice.dtype)], -1))
        return MapFeatures(vector, None, view, known)

    def query(self, features: MapFeatures, positions: Tensor) -> Tensor:
        """Features along ego-frame positions (B, T, 2) as (B, T, queries)."""
        return self._look_up(positions, self.stencil, features.view, features.known)


class BasicBlock(nn.Module):
    """Residual block of ResNet-18 (He et al. 2016, fig. 5 left)."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1):
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False),
            nn.BatchNorm2d(outputs),
        )
        changes = stride != 1 or inputs != outputs
        shortcut = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))
        self.shortcut = shortcut if changes else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H / stride, W / stride)."""
        return F.relu(self.body(x) + self.shortcut(x))


class ResNet18(nn.Module):
    """The convolutional backbone of ResNet-18: features of all four stages (strides 4, 8, 16, 32)."""

    def __init__(self, channels: int):
        super().__init__()
        stem = [
            nn.Conv2d(channels, 64, 7, 2, 3, bias=False),
            nn.BatchNorm2d(64),
            nn.ReLU(),
            nn.MaxPool2d(3, 2, 1),
        ]
        self.stem = nn.Sequential(*stem)
        widths = (64, 64, 128, 256, 512)
        self.stages = nn.ModuleList(
            nn.Sequential(BasicBlock(i, o, 1 if i == o else 2), BasicBlock(o, o)) for i, o in pairwise(widths)
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, C, H, W) to four feature maps, finest first."""
        x, features = self.stem(x), []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features


class UpBlock(nn.Module):
    """Bilinear x2, join the skip, two 3x3 convolutions."""

    def __init__(self, inputs: int, skip: int, outputs: int):
        super().__init__()
        layers: list[nn.Module] = []
        for width in (inputs + skip, outputs):
            layers += [nn.Conv2d(width, outputs, 3, 1, 1), nn.BatchNorm2d(outputs), nn.ReLU()]
        self.body = nn.Sequential(*layers)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Features of one stage and the next finer ones to the resolution of the finer."""
        x = F.interpolate(x, size=skip.shape[-2:], mode="bilinear", align_corners=False)
        return self.body(torch.cat([x, skip], 1))


class CropMapEncoder(nn.Module):
    """What draws the map around each agent: an ego-frame crop of 18.7 m (TRACE app. A.1.2)."""

    crop: Tensor
    side, behind = 56 / 3, 14 / 3  # 4.67 m behind, 14 m ahead, left and right: 224 px of 12 a metre
    draws_people = False

    def __init__(self, config: TraceConfig):
        super().__init__()
        self.layers, self.pixels = config.map_layers, config.map_pixels
        along = (torch.arange(self.pixels) + 0.5) * self.side / self.pixels
        x, y = torch.meshgrid(along - self.behind, along - self.side / 2, indexing="ij")
        self.register_buffer("crop", torch.stack([x, y], -1).reshape(-1, 2), persistent=False)

    def raster(self, context: Context) -> Tensor:
        """Binary crops (B, C, P, P), rows along x (behind first), columns along y; 0.5 where unknown."""
        count = len(context)
        if context.maps is None:
            return torch.full((count, len(self.layers), self.pixels, self.pixels), 0.5)
        points = from_frame(self.crop.expand(count, -1, -1), context.pose)
        inside = (context.maps.select(self.layers).sample(points, context.scene) < 0).float()
        inside = torch.where(context.map_known[:, None, None], inside, torch.tensor(0.5))
        return inside.transpose(1, 2).unflatten(2, (self.pixels, self.pixels))


class GridMapEncoder(CropMapEncoder):
    """The paper's encoder: a 224 px crop to a 56 x 56 x 32 feature grid (TRACE app. A.1.2)."""

    def __init__(self, config: TraceConfig):
        super().__init__(config)
        self.backbone = ResNet18(len(self.layers))
        self.deepest = nn.Conv2d(512, 512, 3, 1, 1)
        self.up = nn.ModuleList([UpBlock(512, 256, 256), UpBlock(256, 128, 128), UpBlock(128, 64, 64)])
        self.residual = nn.Sequential(
            nn.Conv2d(64, 64, 1), nn.ReLU(), nn.Conv2d(64, 64, 3, 1, 1), nn.Conv2d(64, 64, 1)
        )
        self.head = nn.Conv2d(64, 32, 1)
        cells = self.pixels // 4
        self.norm = nn.LayerNorm([32, cells, cells])
        self.queries, self.vector_width = 32, 0

    def encode(self, context: Context) -> MapFeatures:
        """The feature grid of every agent."""
        s1, s2, s3, s4 = self.backbone(self.raster(context))
        x = self.deepest(s4)
        for up, skip in zip(self.up, (s3, s2, s1), strict=True):
            x = up(x, skip)
        grid = self.norm(self.head(F.relu(x + self.residual(x))))
        vector = context.ego.new_zeros(len(context), 0)
        return MapFeatures(vector, grid, None, context.map_known)

    def query(self, features: MapFeatures, positions: Tensor) -> Tensor:
        """Bilinear features at ego-frame positions (B, T, 2), clamped to the border, as (B, T, 32)."""
        assert features.grid is not None
        row = 2 * (positions[..., 0] + self.behind) / self.side - 1
        column = 2 * positions[..., 1] / self.side
        where = torch.stack([column, row], -1)[:, None]
        values = F.grid_sample(features.grid, where, padding_mode="border", align_corners=False)
        return values[:, :, 0].transpose(1, 2)


class GlobalMapEncoder(CropMapEncoder):
    """An ablation: the crop through ResNet-18 to one vector, and no query (TRACE-Global, app. D.2)."""

    queries, vector_width = 0, 128

    def __init__(self, config: TraceConfig):
        super().__init__(config)
        self.backbone = ResNet18(self.channels(config))
        self.head = nn.Linear(512, self.vector_width)

    def channels(self, config: TraceConfig) -> int:
        """Of the picture that the backbone sees."""
        return len(config.map_layers)

    def draw(self, context: Context) -> Tensor:
        """(B, channels, P, P) of every agent."""
        return self.raster(context)

    def encode(self, context: Context) -> MapFeatures:
        """The vector of every agent."""
        vector = self.head(self.backbone(self.draw(context))[-1].mean((2, 3)))
        return MapFeatures(vector, None, None, context.map_known)

    def query(self, features: MapFeatures, positions: Tensor) -> Tensor:
        """Nothing: (B, T, 0)."""
        return positions.new_zeros(*positions.shape[:2], 0)


class RasterMapEncoder(GlobalMapEncoder):
    """An ablation: the past of everybody is drawn into the crop as well, a channel a frame (TRACE-Raster).

    A channel is 1 in the agent's disc and -1 in those of its neighbours; no states are encoded beside it.
    """

    draws_people = True

    def __init__(self, config: TraceConfig):
        self.frames = slice((config.history - 1) % config.history_stride, None, config.history_stride)
        super().__init__(config)

    def channels(self, config: TraceConfig) -> int:
        """The map's layers, and the frames of the past."""
        return len(config.map_layers) + len(range(config.history)[self.frames])

    def draw(self, context: Context) -> Tensor:
        """(B, layers + frames, P, P) of every agent."""
        people = torch.cat([context.neighbors, context.ego[:, None]], 1)[:, :, self.frames]
        drawn = people.new_zeros(len(context), people.shape[2], len(self.crop))
        for row in range(people.shape[1]):  # the agent comes last and lies on top
            frames = people[:, row]  # (B, F, 8)
            square = (self.crop - frames[:, :, None, :2]).square().sum(-1)
            radius = frames[..., 5:7].amax(-1, keepdim=True) / 2
            inside = (square < radius.square()) & (frames[..., 7:] > 0)
            drawn = drawn.masked_fill(inside, 1.0 if row == people.shape[1] - 1 else -1.0)
        size = (self.pixels, self.pixels)
        return torch.cat([self.raster(context), drawn.unflatten(2, size)], 1)


MAP_ENCODERS = {
    "distance": DistanceMapEncoder,
    "grid": GridMapEncoder,
    "global": GlobalMapEncoder,
    "raster": RasterMapEncoder,
}
