"""Named configurations of TRACE: `PAPER` is Rempe et al. 2023 as printed, `COMPACT` runs on two cores."""

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal


@dataclass(frozen=True)
class TraceConfig:
    """Everything that decides the shape of the network and of its inputs.

    Attributes:
        name: Printed with every result.
        dt: Time between trajectory frames [s].
        history: Frames of past motion, the current one included (30 + 1).
        horizon: Frames that are denoised.
        plan: Leading frames of the horizon that are handed out; 52 denoised frames halve twice.
        diffusion_steps: K, steps of the noise schedule.
        history_stride: Every n-th history frame enters the history encoders, the current one always.
        max_neighbors: Nearest neighbours that are kept.
        neighbor_radius: Neighbours further away than this are dropped [m].
        map_layers: Semantic layers of the map, in channel order.
        map_encoder: `grid` learns a feature grid from an ego-frame raster crop; `distance` reads the
            signed distance field of the scene around every trajectory point and on a coarse ego-frame
            lattice. The ablations: `global` makes one vector of the crop, `raster` of the crop with the past
            drawn into it.
        map_pixels: Side of the crop of 18.7 m.
        interaction: Feed the field of neighbours along the trajectory.
        nearest: How many of the nearest neighbours are also fed one by one, with direction and distance, which
            the field blurs: whether two discs touch is a matter of centimetres.
        joint: Neighbours that are denoised together follow their own noisy trajectories in that field: what
            is learned is the score of the scene, not of one person among people who walk straight on.
        estimate: The network also reads its last estimate of the clean actions (self-conditioning, Chen et al.
            2023), and looks up map and neighbours along what follows from it: where people are going shows long
            before the noise has left their trajectories. Learned on whole scenes.
        widths: Channels of the U-Net levels; the time axis halves between levels.
        kernel: Width of the temporal convolutions.
        activation: Of the U-Net, `mish` or `silu`.
        fold: Frames per step of the finest U-Net level.
        skip: The noisy input enters the prediction directly, weighted as if the U-Net alone could see clean
            actions up to this error variance only (Karras et al. 2022, table 1, with sigma_data^2 = skip).
            0 is the paper's: the U-Net predicts everything.
        timesteps: Of a distilled network (`distillation`): the only step indices at which it predicts, from noisy
            to clean. Empty: it predicts at any.
        history_width: Output features of the ego and neighbour encoders.
        history_hidden: Hidden layers of the ego and neighbour encoders.
        context_hidden: Hidden layers of the joint encoder.
        context_width: Output features of the joint encoder.
        step_width: Features of the diffusion-step embedding.
    """

    name: str = "compact"
    dt: float = 0.1
    history: int = 31
    horizon: int = 52
    plan: int = 50
    diffusion_steps: int = 100
    history_stride: int = 5
    max_neighbors: int = 10
    neighbor_radius: float = 15.0
    map_layers: tuple[str, ...] = ("obstacle",)
    map_encoder: Literal["grid", "distance", "global", "raster"] = "distance"
    map_pixels: int = 224
    interaction: bool = True
    nearest: int = 0
    joint: bool = False
    estimate: bool = False
    widths: tuple[int, ...] = (64, 128)
    kernel: int = 5
    activation: Literal["mish", "silu"] = "silu"
    fold: int = 2
    skip: float = 0.0
    timesteps: tuple[int, ...] = ()
    history_width: int = 128
    history_hidden: tuple[int, ...] = (128, 128)
    context_hidden: tuple[int, ...] = (256,)
    context_width: int = 256
    step_width: int = 32

    def distilled(self, timesteps: tuple[int, ...]) -> "TraceConfig":
        """The same network for some steps only."""
        return replace(self, name=f"{self.name}_distilled", timesteps=timesteps)

    def same_shape(self, other: "TraceConfig") -> bool:
        """Whether weights of one fit the other."""
        return replace(self, name="", timesteps=()) == replace(other, name="", timesteps=())

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "TraceConfig":
        """The inverse of `to_dict`.

        Raises:
            ValueError: On a key that is no field.
        """
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ValueError(
                f"TraceConfig has no field {unknown[0]!r}; its fields are {', '.join(sorted(known))}"
            )
        fixed: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return cls(**fixed)


COMPACT = TraceConfig(nearest=2, joint=True, estimate=True, skip=0.02)

PAPER = TraceConfig(
    name="paper",
    max_neighbors=20,
    history_stride=1,
    map_layers=("walkable", "obstacle"),
    map_encoder="grid",
    interaction=False,
    widths=(64, 128, 256),
    activation="mish",
    fold=1,
    history_hidden=(248, 248, 128, 128),
    context_hidden=(256, 256, 256, 256),
)

ABLATIONS = [
    replace(config, name=f"{config.name}_{encoder}", map_encoder=encoder, map_pixels=pixels)
    for config, pixels in ((COMPACT, 56), (PAPER, 224))
    for encoder in ("global", "raster")
]
"""Other conditioning on the map (table 5)."""

DISTILLED_STEPS = (99, 90, 70, 28)
"""Of the distilled network that ships: early ones, where people are led and settle who goes first, are short."""

CONFIGS = {config.name: config for config in (COMPACT, PAPER, *ABLATIONS)}
