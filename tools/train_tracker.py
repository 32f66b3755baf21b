"""`footfall train tracker`: train the motion tracker on a library of clips.

    footfall motion retarget --data FOLDER --out data/motions.npz
    footfall train tracker --config compact --motions data/motions.npz

Run it again with the same `--out` to go on where it stopped. Besides the files of every policy's training
(`tools/train_policy.py`) the folder holds `evaluation.csv`.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..models import ranks
from ..models.motion.library import MotionLibrary, load_clips
from ..models.pacer.config import CONFIGS, TrackerConfig
from ..models.pacer.tracker_env import TrackerEnv
from ..models.pacer.tracker_evaluation import evaluate
from ..models.pacer.tracker_training import TrackerTraining
from .curve_file import append_row
from .train_policy import PolicyRun, add_policy_arguments, configured, train


def add_parser(subparsers) -> None:
    """Add `train tracker` to the command line."""
    parser = subparsers.add_parser("tracker", help="the motion tracker")
    parser.add_argument("--config", choices=sorted(CONFIGS), default="compact")
    parser.add_argument("--motions", type=Path, default=Path("data/motions.npz"))
    parser.add_argument("--out", type=Path, default=None, help="folder (default runs/tracker_CONFIG)")
    parser.add_argument("--masked", type=float, help="share of episodes that hide part of the body")
    parser.add_argument("--lookahead", type=int, nargs="+", help="frames ahead that are seen")
    parser.add_argument("--evaluate-minutes", type=float, default=15.0)
    add_policy_arguments(parser, 40e6)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train until `--samples`, Ctrl-C or SIGTERM; all leave a checkpoint."""
    return train(args, lambda: TrackerRun(args))


def _config(args: argparse.Namespace) -> TrackerConfig:
    config: TrackerConfig = configured(CONFIGS[args.config], args, "masked")
    return replace(config, lookahead=tuple(args.lookahead)) if args.lookahead else config


class TrackerRun(PolicyRun):
    """A run of the tracker, which is evaluated on the recorded clips now and then.

    Args:
        args: The command line.
    """

    def __init__(self, args: argparse.Namespace):
        config = _config(args)
        library = MotionLibrary(*load_clips(args.motions))
        recorded = [clip for clip in library.clips if "parent" not in clip.tags]
        self.judged = MotionLibrary(recorded, library.bodies)
        seed = args.seed + 1000 * ranks.number()
        env = TrackerEnv(config, library, max(config.worlds // ranks.count(), 1), seed)
        folder = args.out or Path("runs") / f"tracker_{args.config}"
        super().__init__(args, folder, TrackerTraining(env, config), config)
        self._evaluated = time.monotonic()
        self.say(
            f"{len(library)} clips, {library.duration / 60:.1f} min; {len(self.judged)} recorded ones are judged; "
            f"{len(env)} worlds, {ranks.count()} processes; from sample {self.training.samples:,}"
        )

    def facts(self) -> dict[str, Any]:
        """Which clips."""
        return {"motions": str(self.args.motions.name)}

    def go(self, stop: list[int]) -> None:
        """Train, log, save and evaluate."""
        super().go(stop)
        self._evaluate()

    def between(self) -> None:
        """Evaluate when it is time."""
        if time.monotonic() - self._evaluated > 60 * self.args.evaluate_minutes:
            self._evaluate()
            self._evaluated = time.monotonic()

    def _evaluate(self) -> None:
        """Track all recorded clips and write what came of it."""
        if ranks.number():
            return
        figures = evaluate(self.training.model, self.judged, self.config).summary()
        so_far = {"samples": self.training.samples, "minutes": self.minutes}
        append_row(self.folder / "evaluation.csv", so_far | figures)
        self.say("  ".join(f"{name} {value:.3g}" for name, value in figures.items()))

    def told(self, means: dict[str, float]) -> str:
        """The figures of a line of the log."""
        return f"{super().told(means)}  clips {means['active_clips']:.0f}"
