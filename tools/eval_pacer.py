"""`footfall eval pacer`: how well the walker keeps to random paths and to its feet; film and pictures."""

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from ..models.pacer.courses import CourseSettings
from ..models.pacer.crowd_evaluation import roll_out_together, unaware
from ..models.pacer.walker import WALKER
from ..models.pacer.walker_evaluation import Rollouts, roll_out
from ..models.pacer.walker_weights import load_discriminator, load_walker

COURSE = CourseSettings(levels=4, columns=8, tile=10.0, border=25.0)
"""Random terrain."""


class EvaluationError(ValueError):
    """Numbers that cannot be."""


def add_parser(subparsers) -> None:
    """Add `eval pacer` to the command line."""
    parser = subparsers.add_parser("pacer", help="the walker")
    parser.add_argument("--model", type=Path, default=WALKER)
    parser.add_argument("--terrain", choices=["flat", "random", "obstacles", "crowd"], default="flat")
    parser.add_argument("--rollouts", type=int, default=600)
    parser.add_argument("--people", type=int, default=30, help="different bodies")
    parser.add_argument("--duration", type=float, default=10.0, help="s of each rollout")
    parser.add_argument("--push", type=float, default=0.0, help="N for 0.2 s from a random side after 3 s")
    parser.add_argument("--style", type=Path, help="a discriminator, style.safetensors of a run")
    parser.add_argument("--unaware", action="store_true", help="people look at nothing but their paths")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--film", type=Path, help="six walkers as a film (.mp4) or strips (.png)")
    parser.add_argument("--plot", type=Path, help="paths and where people went, as a picture")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print, draw."""
    if args.rollouts < 1 or args.people < 1 or not args.duration > 0 or args.threads < 1:
        raise EvaluationError("--rollouts, --people, --duration and --threads must be positive")
    torch.set_num_threads(args.threads)
    model, config, facts = load_walker(args.model)
    judge = load_discriminator(args.style) if args.style else None
    if args.unaware:
        config = unaware(config)
    if args.terrain in ("obstacles", "crowd"):
        result = roll_out_together(
            model,
            config,
            args.rollouts,
            args.terrain,
            people=args.people,
            duration=args.duration,
            discriminator=judge,
            seed=args.seed,
        )
    else:
        result = roll_out(
            model,
            config,
            args.rollouts,
            people=args.people,
            duration=args.duration,
            push=args.push,
            course=COURSE if args.terrain == "random" else None,
            discriminator=judge,
            seed=args.seed,
        )
    figures = result.summary() | gait_figures(result) | {"samples": facts.get("samples", 0)}
    if args.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
    if args.film or args.plot:
        from .pacer_pictures import draw_paths, record

        walk = record(model, config, seconds=8.0, seed=args.seed)
        if args.plot:
            draw_paths(args.plot, walk)
        if args.film:
            walk.draw(args.film)
    return 0


def gait_figures(result: Rollouts) -> dict[str, float]:
    """Cadence (steps/s) and step length (m) of steady walking at 1.2 to 1.5 m/s, and failures by stature."""
    width = round(1.0 / result.period)
    steps, speeds, counts = result.strikes.sum(-1), result.speed, []
    for first in range(0, len(steps) - width + 1, width):
        speed = speeds[first : first + width]
        steady = (speed.min(0) > 1.1) & (speed.max(0) < 1.6) & (np.abs(speed.mean(0) - 1.35) < 0.15)
        counts.append(np.stack([steps[first : first + width].sum(0), speed.mean(0)], -1)[steady])
    found = np.concatenate(counts) if counts else np.zeros((0, 2))
    if not len(found):
        return {}
    cadence = float(found[:, 0].mean())
    small = result.stature < np.median(result.stature)
    return {
        "cadence_per_s": cadence,
        "step_length_m": float(found[:, 1].mean()) / max(cadence, 1e-9),
        "fail_rate_small": float(result.failed[small].mean()) if small.any() else 0.0,
        "fail_rate_tall": float(result.failed[~small].mean()),
    }
