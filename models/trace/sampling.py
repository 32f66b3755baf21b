"""How futures are drawn from noise: solver, steps, samples."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from .config import DISTILLED_STEPS, TraceConfig
from .diffusion import DDIM, DDPM, CosineSchedule, DPMSolver2M, Solver, spaced_timesteps


@dataclass(frozen=True)
class Sampling:
    """How futures are drawn; few steps want `SHIPPED`, or `FEW` where a network is not distilled.

    Attributes:
        solver: `dpm` (second order), `ddim` (first order), `sde` (first order with fresh noise at every step)
            or `ddpm` (the paper's: all steps, fresh noise).
        steps: Denoising steps; `ddpm` always takes all.
        power: Of the strides: 1 makes them even; above 1 they are shorter where it is noisy and people are
            yet to be led, which serves few steps.
        timesteps: The step indices themselves, from noisy to clean, instead of `steps` and `power`.
        samples: Futures per agent.
        context_weight: w of classifier-free sampling (eq 4); 0 needs a single network call.
        temperature: Standard deviation of the noise that sampling begins with; a little above 1 makes up for
            the variety that few steps lose. 1 for many.
        reduced: Network in bfloat16.
        keep: Noise level from which a previous plan, or one that does not do yet, is denoised again, as a share of
            all steps.
    """

    solver: Literal["dpm", "ddim", "sde", "ddpm"] = "dpm"
    steps: int = 8
    power: float = 1.0
    timesteps: tuple[int, ...] = ()
    samples: int = 10
    context_weight: float = 0.0
    temperature: float = 1.0
    reduced: bool = True
    keep: float = 0.6

    def __post_init__(self):
        counts = {"steps": self.steps, "samples": self.samples}
        for name, count in counts.items():
            if not isinstance(count, int) or count < 1:
                raise ValueError(f"{name} of sampling must be a whole number from 1 on, not {count!r}")
        measures = {"power": self.power, "temperature": self.temperature}
        for name, measure in measures.items():
            if not 0 < measure < math.inf:
                raise ValueError(f"{name} of sampling must be above 0, not {measure!r}")
        if not math.isfinite(self.context_weight):
            raise ValueError(f"context_weight of sampling must be finite, not {self.context_weight!r}")
        if not 0 <= self.keep <= 1:
            raise ValueError(f"keep of sampling must be from 0 to 1, not {self.keep!r}")
        falling = all(a > b for a, b in pairwise(self.timesteps))
        if self.timesteps and not (falling and self.timesteps[-1] >= 0):
            raise ValueError(f"timesteps of sampling must fall to 0 or above, not be {self.timesteps!r}")

    def name(self, config: TraceConfig) -> str:
        """For tables: solver, number of steps, and w where there is one."""
        solver = "distilled" if config.timesteps else self.solver
        steps = config.diffusion_steps if self.solver == "ddpm" else len(self.timesteps) or self.steps
        return f"{solver} {steps}" + (f", w {self.context_weight:g}" if self.context_weight else "")

    def suits(self, timesteps: tuple[int, ...]) -> bool:
        """Whether a network distilled for these steps can be sampled so."""
        return self.timesteps == timesteps and self.solver == "ddim" and not self.context_weight

    def make_solver(self, schedule: CosineSchedule) -> Solver:
        """A fresh solver.

        Raises:
            ValueError: On an unknown solver or more steps than the schedule has.
        """
        timesteps = self.timesteps or spaced_timesteps(len(schedule), self.steps, self.power)
        match self.solver:
            case "dpm":
                return DPMSolver2M(schedule, timesteps)
            case "ddim":
                return DDIM(schedule, timesteps)
            case "sde":
                return DDIM(schedule, timesteps, eta=1.0)
            case "ddpm":
                return DDPM(schedule)
        raise ValueError(f"there is no solver {self.solver!r}; there are dpm, ddim, sde and ddpm")


SHIPPED = Sampling(solver="ddim", timesteps=DISTILLED_STEPS, temperature=1.01, keep=0.71)
"""What a planner uses unless told otherwise: the four steps of the distilled network."""

FEW = Sampling(steps=4, power=1.35, temperature=1.05)
"""What four steps of a network want that is not distilled."""
