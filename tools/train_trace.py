"""`footfall train trace`: train the trajectory diffusion model, on one process or several.

    footfall train trace --config compact --data data/orca/maps.npz data/orca/interact.npz
    torchrun --nproc-per-node 2 -m footfall.tools.train_trace trace --config compact ...

Run it again with the same `--out` to go on where it stopped. The learning rate warms up, stays, and falls
linearly to zero over the last part of `--steps`: raising `--steps` before that part begins prolongs a run
without a seam.
"""

import argparse
import csv
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from ..models import ranks
from ..models.trace.config import CONFIGS, TraceConfig
from ..models.trace.context import Context
from ..models.trace.crowd_file import Crowds
from ..models.trace.diffusion import CosineSchedule
from ..models.trace.distillation import DistilledStep, distillation_loss
from ..models.trace.network import Trace
from ..models.trace.training import (
    DenoisingStep,
    MovingAverage,
    denoising_loss,
    fit_statistics,
    vary_observation,
)
from ..models.trace.vae import TraceVae, VaeStep, vae_loss
from ..models.trace.weights import WeightsError, load_tensors, save_model, save_tensors
from ..models.trace.windows import CrowdWindows
from .train_curve import draw_curve
from .train_process import training_process

MODELS = {
    "trace": (Trace, DenoisingStep, denoising_loss),
    "vae": (TraceVae, VaeStep, vae_loss),
    "distilled": (Trace, DistilledStep, distillation_loss),
}
"""By name: the network, what data-parallel training wraps, and the loss."""


def add_parser(subparsers) -> None:
    """Add `train trace` to the command line."""
    parser = subparsers.add_parser("trace", help="the trajectory diffusion model")
    parser.add_argument("--config", choices=sorted(CONFIGS), default="compact")
    parser.add_argument(
        "--model", choices=("trace", "vae"), default="trace", help="the diffusion model, or the VAE baseline"
    )
    add_arguments(parser)
    parser.add_argument(
        "--init", type=Path, help="weights to begin with instead of random ones; they bring their statistics"
    )
    parser.add_argument(
        "--drop", type=float, default=0.1, help="probability of dropping the map or the neighbours"
    )
    parser.add_argument("--half", action="store_true", help="write the weights in float16")
    parser.set_defaults(run=run)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what trainings of trajectory models share."""
    folder = Path("data/orca")
    parser.add_argument(
        "--data", type=Path, nargs="+", default=[folder / "maps.npz", folder / "interact.npz"]
    )
    parser.add_argument("--out", type=Path, default=None, help="folder (default runs/MODEL_CONFIG)")
    parser.add_argument("--steps", type=int, default=40000, help="optimiser steps (default %(default)s)")
    parser.add_argument(
        "--batch", type=int, default=400, help="windows per step and process (default %(default)s)"
    )
    parser.add_argument("--rate", type=float, default=2e-4, help="learning rate (default %(default)s)")
    parser.add_argument(
        "--decay", type=float, default=0.25, help="last part of the steps, with a falling rate"
    )
    parser.add_argument(
        "--balance", type=float, default=0.0, help="1: all noise levels count alike; 0: the paper's loss"
    )
    parser.add_argument(
        "--touch", type=float, default=0.0, help="weight of people who overlap in predictions; the paper: 0"
    )
    parser.add_argument(
        "--calm", type=float, default=0.0, help="weight of actions that tremble in predictions; the paper: 0"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=None, help="of each process (default: torch decides)")
    parser.add_argument("--full-precision", action="store_true", help="no bfloat16")
    parser.add_argument("--check-every", type=int, default=500, help="steps between validations")
    parser.add_argument("--save-minutes", type=float, default=3.0)


@dataclass
class Progress:
    """What a run has behind it."""

    step: int = 0
    minutes: float = 0.0
    samples: int = 0


class TrainingRun:
    """One training run: model, optimiser, moving average, and their files.

    Args:
        args: The command line.
        rank: Number of this process.
        world: Number of processes.
    """

    def __init__(self, args: argparse.Namespace, rank: int, world: int):
        self.args, self.rank, self.world = args, rank, world
        self.folder: Path = args.out or Path("runs") / f"{args.model}_{args.config}"
        config = self.configuration()
        torch.manual_seed(args.seed)
        network, self.single_step, self.loss = MODELS[args.model]
        self.trace = network(config)
        sets = [Crowds.load(path) for path in args.data]
        self.sources = [{"name": s.name, "scenes": int((s.split == 0).sum()), **s.source} for s in sets]
        self.train = [CrowdWindows(s, "train", config, mirror=True) for s in sets]
        self.val = [CrowdWindows(s, "val", config, stride=4) for s in sets]
        fit_statistics(self.trace, self.train, torch.Generator().manual_seed(args.seed))
        self.progress, self.before = Progress(), Progress()
        state = self.folder / "state.safetensors"
        if args.init and not state.is_file():
            self.begin_with(args.init)
        self.schedule = CosineSchedule(config.diffusion_steps)
        self.optimizer = torch.optim.AdamW(
            self.trace.parameters(), lr=args.rate, weight_decay=1e-4, fused=True
        )
        self.average = MovingAverage(self.trace)
        self.losses: list[float] = []
        if state.is_file():
            self.resume()
        step = self.single_step(self.trace)
        self.model: nn.Module = nn.parallel.DistributedDataParallel(step) if world > 1 else step

    def configuration(self) -> TraceConfig:
        """Of the network that learns."""
        return CONFIGS[self.args.config]

    def begin_with(self, path: Path) -> None:
        """Take over weights and statistics, and what they have behind them.

        Raises:
            WeightsError: When the file is missing, or of another configuration.
        """
        tensors, facts = load_tensors(path)
        if not self.trace.config.same_shape(TraceConfig.from_dict(facts["config"])):
            raise WeightsError(f"{path} has another configuration than --config {self.args.config}")
        try:
            self.trace.load_state_dict(tensors)
        except RuntimeError as error:
            raise WeightsError(f"{path} holds another model than --model {self.args.model}") from error
        self.before = Progress(*(facts.get(name, 0) for name in ("step", "minutes", "samples")))
        self.sources.append({"name": "start", "step": self.before.step, "data": facts.get("data")})

    def rate(self) -> float:
        """Learning rate of the next step."""
        left = (self.args.steps - self.progress.step) / max(self.args.decay * self.args.steps, 1)
        return self.args.rate * min((self.progress.step + 1) / 500, left, 1.0)

    def autocast(self):
        """bfloat16 for matrix products, unless told otherwise."""
        return nullcontext() if self.args.full_precision else torch.autocast("cpu", torch.bfloat16)

    def generator(self, number: int) -> torch.Generator:
        """Of the draws that depend on the seed, this process and a number only."""
        return torch.Generator().manual_seed(self.args.seed * 10**9 + number * self.world + self.rank)

    def batch_loss(self) -> torch.Tensor:
        """Loss on a batch of one of the sets; draws depend on seed, step and rank only."""
        args, generator = self.args, self.generator(self.progress.step)
        data = self.train[int(torch.randint(len(self.train), (1,), generator=generator))]
        with self.autocast():
            context, actions = self.draw(data, args.batch, generator)
            context = vary_observation(context, generator)
            options = {}
            if args.model == "trace":
                options = {name: getattr(args, name) for name in ("balance", "touch", "calm")}
                options["radius"] = data.radius
            return self.loss(
                self.model, self.trace, self.schedule, context, actions, generator, drop=args.drop, **options
            )

    def step(self) -> float:
        """One optimiser step."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.rate()
        loss = self.batch_loss()
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.trace.parameters(), 1.0)
        self.optimizer.step()
        self.average.update(self.trace, self.progress.step)
        self.progress.step += 1
        self.progress.samples += self.args.batch * self.world
        return float(loss.detach())

    def draw(
        self, data: CrowdWindows, count: int, generator: torch.Generator
    ) -> tuple[Context, torch.Tensor]:
        """About so many random windows; of whole scenes, where these are learned."""
        if not self.trace.config.estimate or self.args.model == "vae":
            return data.batch(torch.randint(len(data), (count,), generator=generator))
        moments = max(round(count * len(data.moments) / len(data)), 1)
        return data.batch_scenes(torch.randint(len(data.moments), (moments,), generator=generator))

    @torch.no_grad()
    def validate(self, windows: int = 512) -> list[float]:
        """Loss of the averaged weights on fixed windows, noise and steps of each validation set."""
        losses = []
        with self.averaged():
            for data in self.val:
                generator = torch.Generator().manual_seed(1)
                context, actions = self.draw(data, windows, generator)
                step = self.single_step(self.trace)
                losses.append(
                    float(self.loss(step, self.trace, self.schedule, context, actions, generator, drop=0.0))
                )
        return losses

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """The model holds the averaged weights inside."""
        own = {name: p.detach().clone() for name, p in self.trace.named_parameters()}
        self.trace.load_state_dict(self.average.parameters, strict=False)
        self.trace.eval()
        yield
        self.trace.load_state_dict(own, strict=False)
        self.trace.train()

    def facts(self) -> dict:
        """What the weights say about their making, that of those they began with included."""
        args, now, before = self.args, self.progress, self.before
        return {
            "step": before.step + now.step,
            "minutes": round(before.minutes + now.minutes, 2),
            "samples": before.samples + now.samples,
            **{name: getattr(args, name) for name in ("seed", "rate", "drop", "balance", "touch", "calm")},
            "batch": args.batch * self.world,
            "data": self.sources,
        }

    def save(self) -> None:
        """Write `model.safetensors` (averaged weights) and `state.safetensors` (all that resuming needs)."""
        if self.rank:
            return
        tensors = {f"model.{k}": v for k, v in self.trace.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in self.average.parameters.items()}
        for name, parameter in self.trace.named_parameters():
            for kind, value in self.optimizer.state[parameter].items():
                tensors[f"adam.{kind}.{name}"] = value
        progress = {"progress": vars(self.progress), "before": vars(self.before)}
        save_tensors(self.folder / "state.safetensors", tensors, {**progress, **self.facts()})
        with self.averaged():
            save_model(self.folder / "model.safetensors", self.trace, self.facts(), self.args.half)

    def resume(self) -> None:
        """Go on from `state.safetensors`."""
        tensors, facts = load_tensors(self.folder / "state.safetensors")
        parts: dict[str, dict] = {"model": {}, "average": {}, "adam": {}}
        for key, value in tensors.items():
            part, name = key.split(".", 1)
            parts[part][name] = value
        self.trace.load_state_dict(parts["model"])
        self.average.parameters = {name: parts["average"][name] for name in self.average.parameters}
        for name, parameter in self.trace.named_parameters():
            kinds = ("step", "exp_avg", "exp_avg_sq")
            self.optimizer.state[parameter] = {kind: parts["adam"][f"{kind}.{name}"] for kind in kinds}
        self.progress, self.before = Progress(**facts["progress"]), Progress(**facts.get("before", {}))
        self.sources += [source for source in facts["data"] if source["name"] == "start"]

    def log(self, losses: list[float]) -> None:
        """Append to `curve.csv`, redraw `curve.png`, and print a line with the time that is left."""
        mean = sum(self.losses) / len(self.losses)
        self.losses.clear()
        names = [data.name for data in self.val]
        path = self.folder / "curve.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        new = not path.is_file()
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["step", "minutes", "rate", "train", *names])
            figures = [f"{v:.5f}" for v in (mean, *losses)]
            writer.writerow(
                [self.progress.step, f"{self.progress.minutes:.2f}", f"{self.rate():.2e}", *figures]
            )
        draw_curve(path)
        left = self.progress.minutes / self.progress.step * (self.args.steps - self.progress.step)
        shown = "  ".join(f"{n} {v:.4f}" for n, v in zip(names, losses, strict=True))
        print(
            f"step {self.progress.step}/{self.args.steps}  train {mean:.4f}  {shown}  {left:.0f} min left",
            flush=True,
        )


def check(args: argparse.Namespace) -> None:
    """Numbers that no training can have are refused before anything is read.

    Raises:
        ValueError: Names the option.
    """
    if min(args.steps, args.batch, args.check_every) < 1:
        raise ValueError("--steps, --batch and --check-every must be at least 1")
    if not (0 < args.rate < math.inf and args.save_minutes > 0):
        raise ValueError("--rate and --save-minutes must be above 0, and --rate finite")
    for name in ("decay", "balance", "touch", "calm", "drop"):
        if not 0 <= getattr(args, name, 0.0) < math.inf:
            raise ValueError(f"--{name} must be finite and not below 0")


class TrainingError(RuntimeError):
    """Training cannot go on."""


def run(args: argparse.Namespace, kind: type[TrainingRun] = TrainingRun) -> int:
    """Train until `--steps` or Ctrl-C; both leave a checkpoint."""
    with training_process(args.threads) as stop:
        try:
            check(args)
            training = kind(args, ranks.number(), ranks.count())
        except ValueError as error:
            print(error, file=sys.stderr)
            return 2
        train(training, stop)
    return 0


def train(training: TrainingRun, stop: list[int]) -> None:
    """The loop: step, sometimes validate, sometimes save."""
    args, progress = training.args, training.progress
    begun = saved = time.monotonic()
    before = progress.minutes
    training.trace.train()
    while progress.step < args.steps and not ranks.agreed(bool(stop)):
        training.losses.append(training.step())
        if not math.isfinite(training.losses[-1]):
            raise TrainingError(
                f"the loss of step {progress.step} is {training.losses[-1]}; what was saved before stays as it is"
            )
        progress.minutes = before + (time.monotonic() - begun) / 60
        if progress.step % args.check_every == 0 or progress.step == args.steps:
            losses = training.validate()
            if not training.rank:
                training.log(losses)
        if time.monotonic() - saved > 60 * args.save_minutes:
            training.save()
            saved = time.monotonic()
    training.save()
    if not training.rank:
        print(
            f"stopped at step {progress.step}; weights in {training.folder / 'model.safetensors'}", flush=True
        )


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall train")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
