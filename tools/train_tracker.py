"""`footfall train tracker`: train the motion tracker on a library of clips.

    footfall motion retarget --data FOLDER --out data/motions.npz
    footfall train tracker --config compact --motions data/motions.npz

Run it again with the same `--out` to go on where it stopped. The folder holds `curve.csv`, `curve.png`,
`evaluation.csv`, `model.safetensors` (the network) and `state.safetensors` (all that resuming needs).
"""

import argparse
import signal
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import torch

from ..models.motion.library import MotionLibrary, load_clips
from ..models.pacer.config import CONFIGS, TrackerConfig
from ..models.pacer.tracker_env import TrackerEnv
from ..models.pacer.tracker_evaluation import evaluate
from ..models.pacer.tracker_training import TrackerTraining
from ..models.trace.weights import load_tensors, save_tensors
from .curve_file import append_row


class TrainingError(ValueError):
    """Settings that cannot be, or a checkpoint that does not fit them."""


def add_parser(subparsers) -> None:
    """Add `train tracker` to the command line."""
    parser = subparsers.add_parser("tracker", help="the motion tracker")
    parser.add_argument("--config", choices=sorted(CONFIGS), default="compact")
    parser.add_argument("--motions", type=Path, default=Path("data/motions.npz"))
    parser.add_argument("--out", type=Path, default=None, help="folder (default runs/tracker_CONFIG)")
    parser.add_argument(
        "--samples", type=float, default=40e6, help="control steps in all (default %(default)g)"
    )
    parser.add_argument("--threads", type=int, default=2, help="of physics and networks")
    parser.add_argument("--worlds", type=int, help="simulated at once")
    parser.add_argument("--masked", type=float, help="share of episodes that hide part of the body")
    parser.add_argument("--noise", type=float, help="standard deviation of actions")
    parser.add_argument("--lookahead", type=int, nargs="+", help="frames ahead that are seen")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save-minutes", type=float, default=3.0)
    parser.add_argument("--evaluate-minutes", type=float, default=15.0)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train until `--samples`, Ctrl-C or SIGTERM; all leave a checkpoint."""
    if args.samples < 1 or args.threads < 1:
        raise TrainingError("--samples and --threads must be at least 1")
    torch.set_num_threads(args.threads)
    config = _config(args)
    training_run = TrainingRun(args, config)
    stop: list[int] = []
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = {s: signal.signal(s, lambda number, _: stop.append(number)) for s in signals}
    try:
        training_run.go(stop)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    return 0


def _config(args: argparse.Namespace) -> TrackerConfig:
    config = CONFIGS[args.config]
    given = {
        name: getattr(args, name) for name in ("worlds", "masked", "noise") if getattr(args, name) is not None
    }
    if args.lookahead:
        given["lookahead"] = tuple(args.lookahead)
    return replace(config, seed=args.seed, physics=replace(config.physics, threads=args.threads), **given)


class TrainingRun:
    """A run in its folder.

    Args:
        args: the command line.
        config: settings.
    """

    def __init__(self, args: argparse.Namespace, config: TrackerConfig):
        self.args, self.config = args, config
        self.folder: Path = args.out or Path("runs") / f"tracker_{args.config}"
        self.library = MotionLibrary(*load_clips(args.motions))
        self.judged = MotionLibrary(
            [c for c in self.library.clips if "parent" not in c.tags], self.library.bodies
        )
        self.training = TrackerTraining(TrackerEnv(config, self.library, seed=args.seed), config)
        self.minutes = 0.0
        if (self.folder / "state.safetensors").is_file():
            tensors, facts = load_tensors(self.folder / "state.safetensors")
            try:
                self.training.load_state(tensors, facts)
            except (RuntimeError, KeyError) as error:
                raise TrainingError(f"{self.folder} holds a run of other settings: {error}") from error
            self.minutes = float(facts["minutes"])
        print(
            f"{len(self.library)} clips, {self.library.duration / 60:.1f} min; "
            f"{len(self.judged)} recorded ones are judged; {len(self.training.env.world)} worlds; "
            f"from sample {self.training.samples:,}",
            flush=True,
        )

    def go(self, stop: list[int]) -> None:
        """Train, log, save and evaluate."""
        training, args = self.training, self.args
        begun, before = time.monotonic(), self.minutes
        saved = logged = evaluated = begun
        window: list[dict[str, float]] = []
        first = training.samples
        while training.samples < args.samples and not stop:
            window.append(training.update())
            now = time.monotonic()
            self.minutes = before + (now - begun) / 60
            if now - logged > 30:
                self._log(window, (training.samples - first) / (now - begun))
                window.clear()
                logged = now
            if now - saved > 60 * args.save_minutes:
                self.save()
                saved = now
            if now - evaluated > 60 * args.evaluate_minutes:
                self.evaluate()
                evaluated = time.monotonic()
        self.save()
        self.evaluate()

    def save(self) -> None:
        """Write both files."""
        tensors, facts = self.training.state()
        facts |= {
            "minutes": self.minutes,
            "config": asdict(self.config),
            "motions": str(self.args.motions.name),
        }
        facts |= {"observations": self.training.env.observation.size, "actions": self.training.env.n_actions}
        save_tensors(self.folder / "state.safetensors", tensors, facts)
        model = {k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")}
        save_tensors(self.folder / "model.safetensors", model, facts)

    def evaluate(self) -> None:
        """Track all recorded clips and write what came of it."""
        figures = evaluate(self.training.model, self.judged, self.config).summary()
        append_row(
            self.folder / "evaluation.csv",
            {"samples": self.training.samples, "minutes": self.minutes} | figures,
        )
        print("  ".join(f"{name} {value:.3g}" for name, value in figures.items()), flush=True)

    def _log(self, window: list[dict[str, float]], speed: float) -> None:
        means = {name: sum(w[name] for w in window) / len(window) for name in window[0]}
        row = {"samples": self.training.samples, "minutes": self.minutes, "samples_per_s": speed} | means
        append_row(self.folder / "curve.csv", row)
        print(
            f"{self.training.samples / 1e6:7.2f} M  {speed:5.0f}/s  reward {means['reward']:.3f}  failing "
            f"{means['failing']:.2f} ({means['failures_per_s']:.2f}/s)  clips {means['active_clips']:.0f}  "
            f"kl {means['kl']:.3f}  rate {means['rate']:.1e}  explained {means['explained']:.2f}",
            flush=True,
        )
        if means["explained"] < -1.0 or means["kl"] > 1.0:
            print("warning: the critic or the policy diverges", file=sys.stderr, flush=True)
