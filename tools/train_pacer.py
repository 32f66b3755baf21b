"""`footfall train pacer`: train the walker.

    footfall train pacer --config compact

Run it again with the same `--out` to go on where it stopped; settings may change on the way. The folder holds
`curve.csv`, `curve.png`, `model.safetensors` (policy and critic), `style.safetensors` (the discriminator, if
there is one) and `state.safetensors` (all that resuming needs).
"""

import argparse
import signal
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import torch

from ..models.motion.library import MotionLibrary
from ..models.pacer.style import DemoWindows
from ..models.pacer.walker_config import CONFIGS, WalkerConfig
from ..models.pacer.walker_env import WalkerEnv
from ..models.pacer.walker_observation import WAYPOINTS
from ..models.pacer.walker_training import WalkerTraining
from ..models.pacer.walker_weights import grown
from ..models.trace.weights import load_tensors, save_tensors
from .curve_file import append_row
from .pacer_pictures import draw_curves

_DEMO_BODIES = 4  # of those who walk, on whom motion capture is shown to the discriminator


class TrainingError(ValueError):
    """Settings that cannot be, or a checkpoint that does not fit them."""


def add_parser(subparsers) -> None:
    """Add `train pacer` to the command line."""
    parser = subparsers.add_parser("pacer", help="the walker")
    parser.add_argument("--config", choices=sorted(CONFIGS), default="compact")
    parser.add_argument("--out", type=Path, default=None, help="folder (default runs/pacer_CONFIG)")
    parser.add_argument("--init", type=Path, help="a walker's model.safetensors to begin with")
    parser.add_argument(
        "--samples", type=float, default=60e6, help="control steps in all (default %(default)g)"
    )
    parser.add_argument("--threads", type=int, default=2, help="of physics and networks")
    parser.add_argument("--worlds", type=int, help="simulated at once")
    parser.add_argument("--noise", type=float, help="standard deviation of actions")
    parser.add_argument("--discount", type=float, help="per control step")
    parser.add_argument("--push-force", type=float, help="N at most")
    parser.add_argument("--style", type=float, help="share of the style reward; needs --motions")
    parser.add_argument(
        "--motions", type=Path, default=Path("data/motions.npz"), help="motion capture library"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save-minutes", type=float, default=3.0)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train until `--samples`, Ctrl-C or SIGTERM; all leave a checkpoint."""
    if args.samples < 1 or args.threads < 1:
        raise TrainingError("--samples and --threads must be at least 1")
    torch.set_num_threads(args.threads)
    training_run = TrainingRun(args, _config(args))
    stop: list[int] = []
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = {s: signal.signal(s, lambda number, _: stop.append(number)) for s in signals}
    try:
        training_run.go(stop)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    return 0


def _config(args: argparse.Namespace) -> WalkerConfig:
    config = CONFIGS[args.config]
    names = ("worlds", "noise", "discount", "push_force")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.style is not None:
        if not 0 <= args.style < 1:
            raise TrainingError("--style is a share, at least 0 and less than 1")
        given["style"] = replace(config.style, weight=args.style)
    return replace(config, seed=args.seed, physics=replace(config.physics, threads=args.threads), **given)


def _demos(args: argparse.Namespace, env: WalkerEnv) -> DemoWindows | None:
    """Motion capture on a few of the bodies that walk, if style counts."""
    if not env.config.style.weight > 0:
        return None
    bodies = env.world.bodies[:_DEMO_BODIES]
    library = MotionLibrary.load(args.motions, bodies)
    print(f"{len(library)} clips of motion capture on {len(bodies)} bodies", flush=True)
    return DemoWindows(library, env.world.hinges, env.config.style.window)


class TrainingRun:
    """A run in its folder.

    Args:
        args: the command line.
        config: settings.
    """

    def __init__(self, args: argparse.Namespace, config: WalkerConfig):
        self.args, self.config = args, config
        self.folder: Path = args.out or Path("runs") / f"pacer_{args.config}"
        env = WalkerEnv(config, seed=args.seed)
        self.training = WalkerTraining(env, config, _demos(args, env))
        self.minutes = 0.0
        if args.init:
            tensors, _ = load_tensors(args.init)
            weights = grown(tensors, env.size, len(tensors["normalizer.mean"]) + WAYPOINTS.start)
            noise = self.training.model.log_std.clone()
            try:
                self.training.model.load_state_dict(weights)
            except RuntimeError as error:
                raise TrainingError(f"{args.init} does not fit --config {args.config}: {error}") from error
            self.training.model.log_std.copy_(noise)
        if (self.folder / "state.safetensors").is_file():
            tensors, facts = load_tensors(self.folder / "state.safetensors")
            try:
                self.training.load_state(tensors, facts)
            except (RuntimeError, KeyError) as error:
                raise TrainingError(f"{self.folder} holds a run of other settings: {error}") from error
            self.minutes = float(facts["minutes"])
        print(
            f"{len(env)} worlds of {len(env.world.bodies)} bodies; from sample {self.training.samples:,}",
            flush=True,
        )

    def go(self, stop: list[int]) -> None:
        """Train, log and save."""
        training, args = self.training, self.args
        begun, before = time.monotonic(), self.minutes
        saved = logged = begun
        window: list[dict[str, float]] = []
        since = training.samples
        while training.samples < args.samples and not stop:
            window.append(training.update())
            now = time.monotonic()
            self.minutes = before + (now - begun) / 60
            if now - logged > 30:
                self._log(window, (training.samples - since) / (now - logged))
                window.clear()
                logged, since = now, training.samples
            if now - saved > 60 * args.save_minutes:
                self.save()
                saved = now
        self.save()

    def save(self) -> None:
        """Write the networks, all that resuming needs, and the picture of the curves."""
        tensors, facts = self.training.state()
        facts |= {"minutes": self.minutes, "config": asdict(self.config)}
        facts |= {"observations": self.training.env.size, "actions": self.training.env.n_actions}
        save_tensors(self.folder / "state.safetensors", tensors, facts)
        for part, name in (("model.", "model"), ("style.", "style")):
            weights = {k.removeprefix(part): v for k, v in tensors.items() if k.startswith(part)}
            if weights:
                save_tensors(self.folder / f"{name}.safetensors", weights, facts)
        if (self.folder / "curve.csv").is_file():
            draw_curves(self.folder / "curve.csv")

    def _log(self, window: list[dict[str, float]], speed: float) -> None:
        means = {name: sum(w[name] for w in window) / len(window) for name in window[0]}
        row = {"samples": self.training.samples, "minutes": self.minutes, "samples_per_s": speed} | means
        append_row(self.folder / "curve.csv", row)
        print(
            f"{self.training.samples / 1e6:7.2f} M  {speed:5.0f}/s  reward {means['reward']:.3f}  failing "
            f"{means['failing']:.2f} ({means['failures_per_s']:.2f}/s)  path {means['path_error']:.3f} m  "
            f"skate {means['skate']:.3f}  kl {means['kl']:.3f}  rate {means['rate']:.1e}  "
            f"explained {means['explained']:.2f}  difficulty {means['difficulty']:.2f}",
            flush=True,
        )
        if means["explained"] < -1.0 or means["kl"] > 1.0:
            print("warning: the critic or the policy diverges", file=sys.stderr, flush=True)
