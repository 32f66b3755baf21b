"""`footfall train pace`: let a distilled network's crowd walk as fast as that of all 100 steps."""

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

from ..models.trace.crowd_file import Crowds
from ..models.trace.evaluation import TrialScenes
from ..models.trace.network import Trace
from ..models.trace.pace import kept_pace, mean_speed
from ..models.trace.planner import DISTILLED, WEIGHTS, Sampling, TracePlanner, default_sampling
from ..models.trace.weights import load_model, save_model
from .progress import progress_line
from .train_distil import load_teacher

WORKERS = os.cpu_count() or 1


def add_parser(subparsers) -> None:
    """Add `train pace` to the command line."""
    parser = subparsers.add_parser("pace", help="the last touch to what `train distil` made")
    parser.add_argument("--weights", type=Path, default=DISTILLED, help="distilled (default: those shipped)")
    parser.add_argument(
        "--teacher", type=Path, default=WEIGHTS, help="for 100 steps (default: those shipped)"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("data/orca/maps.npz"),
        help="made by `data orca`; its training scenes",
    )
    parser.add_argument("--scenes", type=int, default=400, help="default %(default)s; 150 err by half of it")
    parser.add_argument("--samples", type=int, default=4, help="futures a person (default %(default)s)")
    parser.add_argument("--context-weight", type=float, default=0.5, help="w of the teacher")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the weights")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure both crowds, and write the network that keeps the pace."""
    try:
        if min(args.scenes, args.samples) < 1:
            raise ValueError("--scenes and --samples must be at least 1")
        if args.out.is_dir():
            raise ValueError(f"--out {args.out} is a folder; it must be a file")
        args.out.parent.mkdir(parents=True, exist_ok=True)
        teacher = load_teacher(args.teacher)
        student, facts = load_model(args.weights)
        if not student.config.timesteps:
            raise ValueError(f"{args.weights} is not distilled: it has the pace it learned")
        scenes = TrialScenes(Crowds.load(args.data), student.config, "train", args.scenes)

        def planner_of(trace: Trace) -> TracePlanner:
            return TracePlanner(trace, replace(default_sampling(trace.config), samples=args.samples))

        slow = Sampling(solver="ddpm", samples=args.samples, context_weight=args.context_weight)
        print(f"walking {len(scenes)} scenes in all {teacher.config.diffusion_steps} steps", flush=True)
        wanted = mean_speed(TracePlanner(teacher, slow), scenes, WORKERS, progress_line("scene"))
        found, pace = kept_pace(student, planner_of, wanted, scenes, WORKERS)
        save_model(args.out, found, {**facts, "pace": pace}, half=True)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(
        f"all steps walk {wanted:.4f} m/s, few {pace['before']:.4f}; "
        f"with {pace['acceleration']:+.4f} m/s^2 {pace['after']:.4f}; weights in {args.out}"
    )
    return 0


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall train")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
