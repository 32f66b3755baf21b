"""Building blocks of the TRACE denoiser: history MLPs, step embedding and the temporal U-Net."""

from collections.abc import Iterator, Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class Mlp(nn.Sequential):
    """Linear layers with LayerNorm and ReLU after each hidden one (TRACE app. A.1.2)."""

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int):
        layers: list[nn.Module] = []
        for width in hidden:
            layers += [nn.Linear(inputs, width), nn.LayerNorm(width), nn.ReLU()]
            inputs = width
        super().__init__(*layers, nn.Linear(inputs, outputs))


class StepEmbedding(nn.Module):
    """Sinusoidal position of the diffusion step, then a small MLP."""

    frequencies: Tensor

    def __init__(self, width: int):
        super().__init__()
        half = width // 2
        frequencies = torch.exp(-torch.log(torch.tensor(10000.0)) * torch.arange(half) / (half - 1))
        self.register_buffer("frequencies", frequencies, persistent=False)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.Mish(), nn.Linear(4 * width, width))

    def forward(self, k: Tensor) -> Tensor:
        """(B,) step indices to (B, width)."""
        phase = k[:, None].float() * self.frequencies
        return self.mlp(torch.cat([phase.sin(), phase.cos()], -1))


ACTIVATIONS: dict[str, type[nn.Module]] = {"mish": nn.Mish, "silu": nn.SiLU}


class ConvBlock(nn.Sequential):
    """Temporal convolution, GroupNorm, activation."""

    def __init__(self, inputs: int, outputs: int, kernel: int, activation: str):
        conv = nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2)
        super().__init__(conv, nn.GroupNorm(8, outputs), ACTIVATIONS[activation]())


class ResidualBlock(nn.Module):
    """One U-Net layer (TRACE fig. 7): convolve, add the projected condition, convolve, add the input."""

    def __init__(self, inputs: int, outputs: int, condition: int, kernel: int, activation: str):
        super().__init__()
        self.first = ConvBlock(inputs, outputs, kernel, activation)
        self.second = ConvBlock(outputs, outputs, kernel, activation)
        self.project = nn.Linear(condition, outputs)
        self.skip = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x: Tensor, shift: Tensor) -> Tensor:
        """(B, inputs, T) and the projected condition (B, outputs) to (B, outputs, T)."""
        hidden = self.first(x)
        # Written out over time first: bfloat16 adds a broadcast several times slower than a whole tensor.
        return self.second(hidden + shift[..., None].expand_as(hidden).contiguous()) + self.skip(x)


class ResidualPair(nn.ModuleList):
    """The two layers of one U-Net level."""

    def __init__(self, inputs: int, outputs: int, condition: int, kernel: int, activation: str):
        super().__init__(
            [ResidualBlock(i, outputs, condition, kernel, activation) for i in (inputs, outputs)]
        )

    def forward(self, x: Tensor, shifts: Iterator[Tensor]) -> Tensor:
        """See `ResidualBlock.forward`; takes the next two of the projected conditions."""
        for block in self:
            x = block(x, next(shifts))
        return x


class TemporalUNet(nn.Module):
    """1-D U-Net over time (Janner et al. 2022): the time axis halves between levels, skips join the way up.

    Args:
        inputs: Channels of the input trajectory.
        outputs: Channels of the output trajectory.
        widths: Channels of each level, finest first.
        condition: Features of the condition vector that every layer receives.
        kernel: Width of the convolutions.
        activation: `mish` as in the paper, or `silu`, which CPUs compute several times faster.
        fold: This many frames form one step of the finest level: 2 halves the cost of that level.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        widths: Sequence[int],
        condition: int,
        kernel: int = 5,
        activation: str = "mish",
        fold: int = 1,
    ):
        super().__init__()
        self.fold = fold
        inputs, outputs = inputs * fold, outputs * fold

        def pair(i: int, o: int) -> ResidualPair:
            return ResidualPair(i, o, condition, kernel, activation)

        self.activation = ACTIVATIONS[activation]()
        self.down = nn.ModuleList(pair(i, o) for i, o in zip((inputs, *widths[:-1]), widths, strict=True))
        self.halvings = nn.ModuleList(nn.Conv1d(w, w, 3, stride=2, padding=1) for w in widths[:-1])
        self.middle = pair(widths[-1], widths[-1])
        levels = list(zip(widths[1:], widths[:-1], strict=True))[::-1]
        self.up = nn.ModuleList(pair(2 * i, o) for i, o in levels)
        self.doublings = nn.ModuleList(nn.ConvTranspose1d(o, o, 4, stride=2, padding=1) for _, o in levels)
        last = ConvBlock(widths[0], widths[0], kernel, activation)
        self.head = nn.Sequential(last, nn.Conv1d(widths[0], outputs, 1))

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """(B, T, inputs), (B, C) to (B, T, outputs); T must be a multiple of fold * 2^(levels - 1)."""
        frames = x.shape[1]
        x = x.reshape(len(x), frames // self.fold, -1).transpose(1, 2)
        shifts = self._project(self.activation(condition))
        skips: list[Tensor] = []
        for level, blocks in enumerate(self.down):
            x = blocks(x, shifts)
            skips.append(x)
            if level < len(self.halvings):
                x = self.halvings[level](x)
        x = self.middle(x, shifts)
        for blocks, doubling in zip(self.up, self.doublings, strict=True):
            x = doubling(blocks(torch.cat([x, skips.pop()], 1), shifts))
        return self.head(x).transpose(1, 2).reshape(len(x), frames, -1)

    def _project(self, condition: Tensor) -> Iterator[Tensor]:
        """What every layer adds, in the order of the layers: one product instead of one a layer."""
        pairs = cast("Sequence[ResidualPair]", (*self.down, self.middle, *self.up))
        layers = [cast(nn.Linear, block.project) for pair in pairs for block in pair]
        weight, bias = (torch.cat([getattr(layer, name) for layer in layers]) for name in ("weight", "bias"))
        return iter(F.linear(condition, weight, bias).split([layer.out_features for layer in layers], 1))
