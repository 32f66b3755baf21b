"""`footfall train distil`: teach a trajectory diffusion model to take in four steps what it takes in many.

Files and resuming are those of `footfall train trace`. A step needs paths of the teacher, which take longer than
learning from them: every batch of paths is learned from several times, among the latest ones.
"""

import argparse
import sys
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import torch

from ..models.trace.config import DISTILLED_STEPS, TraceConfig
from ..models.trace.distillation import DistilledStep, Paths, distillation_loss, teacher_paths
from ..models.trace.network import Trace
from ..models.trace.planner import WEIGHTS
from ..models.trace.training import vary_observation
from ..models.trace.weights import load_model
from ..models.trace.windows import CrowdWindows
from . import train_trace

KEPT = 64
"""Batches of paths that are learned from by turns."""


def add_parser(subparsers) -> None:
    """Add `train distil` to the command line."""
    parser = subparsers.add_parser("distil", help="a trajectory diffusion model that needs few steps")
    parser.add_argument("--teacher", type=Path, default=WEIGHTS, help="weights (default: those shipped)")
    parser.add_argument("--init", type=Path, help="weights the student begins with (default: the teacher's)")
    parser.add_argument(
        "--timesteps",
        type=int,
        nargs="+",
        default=list(DISTILLED_STEPS),
        help="of the student (default %(default)s)",
    )
    parser.add_argument(
        "--context-weight", type=float, default=0.5, help="w of the teacher, which the student takes in"
    )
    parser.add_argument("--reuse", type=int, default=8, help="steps that learn from a batch of paths")
    parser.add_argument("--drop", type=float, default=0.05, help="probability of dropping map or neighbours")
    train_trace.add_arguments(parser)
    parser.set_defaults(run=run, model="distilled", balance=0.0, touch=8.0, calm=3.0)
    parser.set_defaults(batch=56, steps=5500, rate=5e-4, decay=0.5, half=True)


def load_teacher(path: Path) -> Trace:
    """A network that can be followed through all of its steps.

    Raises:
        ValueError: When there is none in the file, or one that is distilled.
    """
    teacher, _ = load_model(path)
    if teacher.config.timesteps:
        raise ValueError(f"{path} is distilled itself; a teacher predicts at every step")
    return teacher


class Distillation(train_trace.TrainingRun):
    """A training run that learns from the paths of a teacher, which it begins as."""

    def __init__(self, args: argparse.Namespace, rank: int, world: int):
        teacher = load_teacher(args.teacher)
        falling = [teacher.config.diffusion_steps, *args.timesteps, 0]
        if len(args.timesteps) < 2 or any(k <= after for k, after in pairwise(falling)):
            raise ValueError(
                f"--timesteps must be two or more step indices that fall, from {falling[0] - 1} to 1"
            )
        if args.reuse < 1:
            raise ValueError("--reuse must be at least 1")
        self._teacher, self.teacher = teacher.config, teacher.prepared()
        args.init, args.config = args.init or args.teacher, teacher.config.name
        super().__init__(args, rank, world)
        self.paths = lru_cache(KEPT)(self._paths)
        self._known: list[tuple[CrowdWindows, Paths]] | None = None

    def configuration(self) -> TraceConfig:
        """The teacher's, for some of its steps."""
        return self._teacher.distilled(tuple(self.args.timesteps))

    def batch_loss(self) -> torch.Tensor:
        """Loss on one of the latest batches of paths."""
        latest = self.progress.step // self.args.reuse
        first = max(latest - KEPT + 1, 0)
        generator = self.generator(self.progress.step)
        number = first + int(torch.randint(latest - first + 1, (1,), generator=generator))
        return self._loss(*self.paths(number))

    @torch.no_grad()
    def validate(self, windows: int = 256) -> list[float]:
        """Loss of the averaged weights on fixed paths, of about so many people of each validation set."""
        with self.averaged():
            step = DistilledStep(self.trace)
            return [float(self._loss(paths, data.radius, step)) for data, paths in self._validation(windows)]

    def facts(self) -> dict:
        """What the weights say about their making."""
        args = self.args
        return super().facts() | {"context_weight": args.context_weight, "reuse": args.reuse}

    def _loss(self, paths: Paths, radius: float, model: torch.nn.Module | None = None) -> torch.Tensor:
        args = self.args
        with self.autocast():
            return distillation_loss(
                model or self.model,
                self.trace,
                self.schedule,
                paths,
                args.timesteps,
                args.balance,
                args.touch,
                args.calm,
                radius,
            )

    def _paths(self, number: int) -> tuple[Paths, float]:
        """Batch of paths number so and so, and the radius of its people; it depends on seed, number and rank only."""
        generator = self.generator(10**8 + number)
        data = self.train[int(torch.randint(len(self.train), (1,), generator=generator))]
        return self._follow(data, self.args.batch, generator), data.radius

    def _follow(self, data: CrowdWindows, count: int, generator: torch.Generator) -> Paths:
        """Paths of about so many people, who are seen as people are in use; the teacher sees the same."""
        context, _ = self.draw(data, count, generator)
        context = vary_observation(context, generator)
        lost = torch.rand(2, len(context), generator=generator) < self.args.drop
        context = context.drop(maps=lost[0], neighbors=lost[1])
        args = self.args
        return teacher_paths(
            self.teacher, self.schedule, context, generator, args.timesteps, args.context_weight
        )

    def _validation(self, windows: int) -> list[tuple[CrowdWindows, Paths]]:
        if self._known is None:
            draws = [torch.Generator().manual_seed(1) for _ in self.val]
            self._known = [(d, self._follow(d, windows, g)) for d, g in zip(self.val, draws, strict=True)]
        return self._known


def run(args: argparse.Namespace) -> int:
    """Train until `--steps` or Ctrl-C; both leave a checkpoint."""
    return train_trace.run(args, Distillation)


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall train")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
