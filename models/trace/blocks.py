"""Building blocks of the TRACE denoiser: history MLPs, step embedding and the temporal U-Net."""

from collections.abc import Iterator, Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_FEW_CHANNELS = 16  # a group: with fewer, normalising in float32 is faster than in bfloat16
_ROWS = 100  # that many at once stay in the cache


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


class TemporalConv(nn.Conv1d):
    """A convolution over time of pictures (B, C, 1, T) one row high: those may lie channels last, which is faster."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, inputs, 1, T) to (B, outputs, 1, T / stride)."""
        stride, padding = (1, *self.stride), (0, *cast("tuple[int, ...]", self.padding))
        return F.conv2d(input, self.weight.unsqueeze(2), self.bias, stride, padding)


class TemporalDoubling(nn.ConvTranspose1d):
    """Twice as many steps of time, of pictures (B, C, 1, T)."""

    def __init__(self, width: int):
        super().__init__(width, width, 4, stride=2, padding=1)

    def forward(self, input: Tensor, output_size: list[int] | None = None) -> Tensor:
        """(B, width, 1, T) to (B, width, 1, 2 T)."""
        return F.conv_transpose2d(input, self.weight.unsqueeze(2), self.bias, (1, 2), (0, 1))


class TemporalNorm(nn.GroupNorm):
    """GroupNorm that is fast in bfloat16, too: with few channels a group torch's is several times slower there."""

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, 1, T) to the same shape."""
        if input.dtype != torch.bfloat16 or self.num_channels >= _FEW_CHANNELS * self.num_groups:
            return super().forward(input)
        weight, bias = self.weight.float(), self.bias.float()
        parts = [
            F.group_norm(part.float(), self.num_groups, weight, bias, self.eps).bfloat16()
            for part in input.split(_ROWS)
        ]
        return parts[0] if len(parts) == 1 else torch.cat(parts)


class ConvBlock(nn.Sequential):
    """Temporal convolution, GroupNorm, activation."""

    def __init__(self, inputs: int, outputs: int, kernel: int, activation: str):
        conv = TemporalConv(inputs, outputs, kernel, padding=kernel // 2)
        super().__init__(conv, TemporalNorm(8, outputs), ACTIVATIONS[activation]())


class ResidualBlock(nn.Module):
    """One U-Net layer (TRACE fig. 7): convolve, add the projected condition, convolve, add the input."""

    def __init__(self, inputs: int, outputs: int, condition: int, kernel: int, activation: str):
        super().__init__()
        self.first = ConvBlock(inputs, outputs, kernel, activation)
        self.second = ConvBlock(outputs, outputs, kernel, activation)
        self.project = nn.Linear(condition, outputs)
        self.skip = TemporalConv(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x: Tensor, shift: Tensor) -> Tensor:
        """(B, inputs, 1, T) and the projected condition (B, outputs) to (B, outputs, 1, T)."""
        return self.second(self.first(x) + shift[..., None, None]) + self.skip(x)


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
        self.halvings = nn.ModuleList(TemporalConv(w, w, 3, stride=2, padding=1) for w in widths[:-1])
        self.middle = pair(widths[-1], widths[-1])
        levels = list(zip(widths[1:], widths[:-1], strict=True))[::-1]
        self.up = nn.ModuleList(pair(2 * i, o) for i, o in levels)
        self.doublings = nn.ModuleList(TemporalDoubling(o) for _, o in levels)
        self._projection: tuple[Tensor, Tensor] | None = None
        last = ConvBlock(widths[0], widths[0], kernel, activation)
        self.head = nn.Sequential(last, TemporalConv(widths[0], outputs, 1))

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """(B, T, inputs), (B, C) to (B, T, outputs); T must be a multiple of fold * 2^(levels - 1)."""
        frames = x.shape[1]
        x = x.reshape(len(x), frames // self.fold, -1).transpose(1, 2).unsqueeze(2)  # channels last
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
        return self.head(x).squeeze(2).transpose(1, 2).reshape(len(x), frames, -1)

    def prepare(self) -> None:
        """Lay the weights out as inference reads them fastest; they must not change any more."""
        for layer in self.modules():
            if isinstance(layer, (TemporalConv, TemporalDoubling)):  # channels last
                layer.weight.data = layer.weight.data.transpose(1, 2).contiguous().transpose(1, 2)
        self._projection = self._stacked()

    def _project(self, condition: Tensor) -> Iterator[Tensor]:
        """What every layer adds, in the order of the layers: one product instead of one a layer."""
        weight, bias = self._projection or self._stacked()
        sizes = [layer.out_features for layer in self._projections()]
        return iter(F.linear(condition, weight, bias).split(sizes, 1))

    def _stacked(self) -> tuple[Tensor, Tensor]:
        """Weights and biases of all projections of the condition."""
        layers = self._projections()
        return torch.cat([layer.weight for layer in layers]), torch.cat([layer.bias for layer in layers])

    def _projections(self) -> list[nn.Linear]:
        pairs = cast("Sequence[ResidualPair]", (*self.down, self.middle, *self.up))
        return [cast(nn.Linear, block.project) for pair in pairs for block in pair]
