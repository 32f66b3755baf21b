"""How policies are trained: the loop, the files of a run and its log; tracker and walker add the rest.

A run's folder holds `curve.csv`, `curve.png`, `model.safetensors` (policy and critic) and `state.safetensors` (all
that resuming needs). Under `torchrun` each process simulates its share of the worlds:

    torchrun --nproc-per-node 2 -m footfall.tools.cli train pacer --threads 1
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..models import ranks
from ..models.pacer.policy_training import PolicyTraining
from ..models.trace.weights import load_tensors, save_tensors
from .curve_file import append_row
from .pacer_pictures import draw_curves
from .train_process import training_process


class TrainingError(ValueError):
    """Settings that cannot be, or a checkpoint that does not fit them."""


def add_policy_arguments(parser: argparse.ArgumentParser, samples: float) -> None:
    """Options of every policy's training."""
    parser.add_argument(
        "--samples", type=float, default=samples, help="control steps in all (default %(default)g)"
    )
    parser.add_argument("--threads", type=int, default=2, help="of physics and networks, in each process")
    parser.add_argument("--worlds", type=int, help="simulated at once, by all processes")
    parser.add_argument("--horizon", type=int, help="control steps of each world per update")
    parser.add_argument("--minibatch", type=int, help="samples per descent step, of all processes")
    parser.add_argument("--noise", type=float, help="standard deviation of actions")
    parser.add_argument("--rate-floor", type=float, help="least learning rate of the actor")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save-minutes", type=float, default=3.0)


def train(args: argparse.Namespace, make: Callable[[], "PolicyRun"]) -> int:
    """Train until `--samples`, Ctrl-C or SIGTERM; all leave a checkpoint."""
    if args.samples < 1 or args.threads < 1:
        raise TrainingError("--samples and --threads must be at least 1")
    with training_process(args.threads) as stop:
        make().go(stop)
    return 0


def configured(config: Any, args: argparse.Namespace, *names: str) -> Any:
    """A policy's configuration with what the command line gives: of every policy's options, and those names."""
    names = ("worlds", "horizon", "minibatch", "noise", *names)
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.rate_floor is not None:
        given["rate_bounds"] = (args.rate_floor, config.rate_bounds[1])
    return replace(config, seed=args.seed, physics=replace(config.physics, threads=args.threads), **given)


class PolicyRun:
    """A run in its folder.

    Args:
        args: The command line.
        folder: Where its files are.
        training: What is trained; goes on where the folder's checkpoint stopped.
        config: Its settings, a dataclass.
    """

    def __init__(self, args: argparse.Namespace, folder: Path, training: PolicyTraining, config: Any):
        self.args, self.folder, self.training, self.config = args, folder, training, config
        self.minutes = 0.0
        if (folder / "state.safetensors").is_file():
            tensors, facts = load_tensors(folder / "state.safetensors")
            try:
                training.load_state(tensors, facts)
            except (RuntimeError, KeyError) as error:
                raise TrainingError(f"{folder} holds a run of other settings: {error}") from error
            self.minutes = float(facts["minutes"])

    def say(self, text: str) -> None:
        """Print, once for all processes."""
        if not ranks.number():
            print(text, flush=True)

    def go(self, stop: list[int]) -> None:
        """Train, log and save."""
        training, args = self.training, self.args
        begun, before = time.monotonic(), self.minutes
        saved = logged = begun
        window: list[dict[str, float]] = []
        since = training.samples
        while training.samples < args.samples and not ranks.agreed(bool(stop)):
            window.append(training.update())
            now = time.monotonic()
            self.minutes = before + (now - begun) / 60
            if now - logged > 30:
                if not ranks.number():
                    self._log(window, (training.samples - since) / (now - logged))
                window.clear()
                logged, since = now, training.samples
            if now - saved > 60 * args.save_minutes:
                self.save()
                saved = now
            self.between()
        self.save()

    def between(self) -> None:
        """What else is to be done now and then."""

    def facts(self) -> dict[str, Any]:
        """What else a checkpoint says of itself."""
        return {}

    def save(self) -> None:
        """Write the networks, all that resuming needs, and the picture of the curves."""
        if ranks.number():
            return
        tensors, facts = self.training.state()
        facts |= {"minutes": self.minutes, "processes": ranks.count(), "config": asdict(self.config)}
        facts |= self.facts()
        model = self.training.model
        facts |= {"observations": len(model.normalizer.mean), "actions": len(model.log_std)}
        save_tensors(self.folder / "state.safetensors", tensors, facts)
        for part, name in (("model.", "model"), ("style.", "style")):
            weights = {k.removeprefix(part): v for k, v in tensors.items() if k.startswith(part)}
            if weights:
                save_tensors(self.folder / f"{name}.safetensors", weights, facts)
        if (self.folder / "curve.csv").is_file():
            draw_curves(self.folder / "curve.csv")

    def _log(self, window: list[dict[str, float]], speed: float) -> None:
        names = window[0].keys() & window[-1].keys()
        means = {n: sum(w[n] for w in window) / len(window) for n in window[0] if n in names}
        samples = self.training.samples
        row = {"samples": samples, "minutes": self.minutes, "samples_per_s": speed} | means
        append_row(self.folder / "curve.csv", row)
        left = (self.args.samples - samples) / max(speed, 1.0) / 60
        print(f"{samples / 1e6:7.2f} M  {speed:5.0f}/s  {self.told(means)}  {left:.0f} min left", flush=True)
        if means["explained"] < -1.0 or means["kl"] > 1.0:
            print("warning: the critic or the policy diverges", file=sys.stderr, flush=True)

    def told(self, means: dict[str, float]) -> str:
        """The figures of a line of the log."""
        return (
            f"reward {means['reward']:.3f}  failing {means['failing']:.2f} ({means['failures_per_s']:.2f}/s)  "
            f"kl {means['kl']:.3f}  rate {means['rate']:.1e}  explained {means['explained']:.2f}"
        )
