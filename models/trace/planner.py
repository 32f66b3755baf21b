"""TRACE as a planner: denoise everybody jointly under guidance, choose a sample, and polish it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from .choice import unmet
from .config import DISTILLED_STEPS, TraceConfig
from .context import Context
from .denoising import Denoiser
from .guidance import FutureOf, Guidance
from .network import Trace
from .objectives import Objective
from .sampling import FEW, SHIPPED, Sampling
from .scene_planner import ScenePlanner
from .settling import Candidates
from .weights import WeightsError, load_model

_FOLDER = Path(__file__).parent.parent / "weights"
WEIGHTS = _FOLDER / "trace_compact.safetensors"
"""For any number of steps."""
DISTILLED = _FOLDER / "trace_compact_distilled.safetensors"
"""For the steps of `SHIPPED` only."""

THOROUGH = Guidance(limit=0.5, polish=8, tries=3, temperature=0.97, haste=0.008)
"""How objectives bend the samples unless told otherwise."""

_LOST = 8
"""So many who try again and still are where they are not to be are in each other's way: more tries do not help."""


def weights_for(sampling: Sampling) -> Path:
    """The weights shipped with the package that suit."""
    return DISTILLED if sampling.suits(DISTILLED_STEPS) else WEIGHTS


def default_sampling(config: TraceConfig) -> Sampling:
    """The steps for which a network is distilled, or the few which one wants that is not."""
    return replace(SHIPPED, timesteps=config.timesteps) if config.timesteps else FEW


class TracePlanner(ScenePlanner):
    """TRACE as a planner.

    Args:
        trace: Trained denoiser.
        sampling: How futures are drawn; by default in the steps of a distilled network, or `FEW`.
        guidance: How objectives bend them; `THOROUGH` by default.

    Raises:
        WeightsError: When the network is distilled for other steps than those of `sampling`.
    """

    def __init__(self, trace: Trace, sampling: Sampling | None = None, guidance: Guidance | None = None):
        sampling, steps = sampling or default_sampling(trace.config), trace.config.timesteps
        if steps and not sampling.suits(steps):
            raise WeightsError(
                f"this network is distilled for the steps {', '.join(map(str, steps))} of ddim without "
                "context_weight; other sampling needs weights that are not distilled"
            )
        self.guidance = guidance or THOROUGH
        self.denoiser = Denoiser(trace, sampling, self.guidance)
        super().__init__(trace, sampling, self.denoiser)

    @classmethod
    def load(
        cls, path: Path | None = None, sampling: Sampling | None = None, guidance: Guidance | None = None
    ) -> "TracePlanner":
        """A planner with trained weights.

        Args:
            path: File; by default what `weights_for` ships.
            sampling: How futures are drawn; `SHIPPED` by default.
            guidance: How objectives bend them.

        Raises:
            WeightsError: When the file is missing or broken, or distilled for other steps than those of `sampling`.
        """
        return cls(load_model(path or weights_for(sampling or SHIPPED))[0], sampling, guidance)

    def settle(
        self,
        found: Candidates,
        context: Context,
        future_of: FutureOf,
        objectives: Sequence[Objective],
        seed: int,
    ) -> Candidates:
        """Choose and polish; who is not led where they are asked to go tries again."""
        if not self.guidance.polishes:
            return found

        def polish() -> None:
            found.polish(future_of, objectives, self.guidance, bound)

        def bound(actions: Tensor) -> Tensor:
            return self.denoiser.within_speeds(actions, context.speed)

        found.regroup(objectives)
        polish()
        for attempt in range(self.guidance.tries):
            rows = unmet(found.chosen, found.losses, objectives).nonzero()[:, 0]
            if not len(rows) or (attempt and len(rows) > _LOST):
                break
            actions, chosen = found.actions.clone(), found.chosen.clone()
            generator = torch.Generator().manual_seed((seed + (attempt + 1) * 2**32) % 2**63)
            start = self.denoiser.starts(found.own[rows], context.speed[rows])
            actions[rows] = self.denoiser.resample(
                rows, start, found.own, context, future_of, objectives, generator
            )
            actions[rows, 0], chosen[rows] = found.own[rows, 0], 0  # what they have is one of the samples
            found = Candidates.judged(actions, future_of, objectives, chosen)
            found.regroup(objectives)
            polish()
        if found.regroup(objectives):
            polish()
            found.regroup(objectives)
        found.reconsider(objectives)
        return found
