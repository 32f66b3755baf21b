"""`footfall eval pacer`: how well the walker keeps to random paths and to its feet; tables, film and pictures."""

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from ..models.body import Body, describe
from ..models.body.anthropometry import shape_for
from ..models.pacer.courses import SHARES, Course, CourseSettings, make_course
from ..models.pacer.crowd_evaluation import roll_out_together, unaware
from ..models.pacer.gait_measures import measure_steps
from ..models.pacer.policy import ActorCritic
from ..models.pacer.style import Discriminator
from ..models.pacer.walker import WALKER
from ..models.pacer.walker_config import WalkerConfig
from ..models.pacer.walker_evaluation import Rollouts, roll_out, stroll_paths
from ..models.pacer.walker_weights import STYLE, load_discriminator, load_walker
from .eval_pacer_tables import GROUNDS_9, tell_steps, tell_table

COURSE_SEED = 4242
"""Of the ground that is judged on; that of training has small seeds."""
COURSE = CourseSettings(levels=5, columns=9, tile=10.0, border=25.0, cell=0.05)
BUILDS = ((1.5, 50), (1.5, 75), (1.75, 55), (1.75, 80), (1.75, 110), (2.0, 70), (2.0, 110))
"""Stature [m] and mass [kg] of `--bodies extreme`."""
GROUNDS = ("flat", "random", "obstacles", "crowd")


class EvaluationError(ValueError):
    """Numbers that cannot be."""


UNAWARE = WALKER.with_name("pacer_unaware_compact.safetensors")
"""The twin of `WALKER`, trained as one who takes everybody for average (table 9)."""


def add_parser(subparsers) -> None:
    """Add `eval pacer` to the command line."""
    parser = subparsers.add_parser("pacer", help="the walker")
    parser.add_argument("--model", type=Path, default=WALKER)
    parser.add_argument("--terrain", choices=GROUNDS, default="flat")
    parser.add_argument("--rollouts", type=int, default=600)
    parser.add_argument("--people", type=int, default=30, help="different bodies; in a crowd, people")
    parser.add_argument(
        "--bodies", choices=["usual", "extreme"], default="usual", help="extreme: 1.5 to 2 m, 50 to 110 kg"
    )
    parser.add_argument("--duration", type=float, default=10.0, help="s of each rollout")
    parser.add_argument(
        "--paths",
        choices=["random", "strolls"],
        default="random",
        help="PACER's, with sharp turns, or gentle bends at 0.9 to 1.5 m/s",
    )
    parser.add_argument("--push", type=float, default=0.0, help="N for 0.2 s from a random side after 3 s")
    parser.add_argument(
        "--style",
        type=Path,
        help="a discriminator, style.safetensors of a run (default: that of the shipped walker)",
    )
    parser.add_argument(
        "--unaware",
        choices=list(GROUNDS_9),
        nargs="?",
        const="others",
        help="people look at nothing but their paths, or are not told how they are built (default: %(const)s)",
    )
    parser.add_argument("--gait", action="store_true", help="measure steps on straight ways, by speed")
    parser.add_argument(
        "--table", type=int, choices=[3, 9], help="the paper's: all grounds, or without awareness"
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--film", type=Path, help="six walkers as a film (.mp4) or strips (.png)")
    parser.add_argument("--plot", type=Path, help="paths and where people went, as a picture")
    parser.add_argument("--failures", type=Path, help="where on the ground people failed, as a picture")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print, draw."""
    if args.rollouts < 1 or args.people < 1 or not args.duration > 0 or args.threads < 1:
        raise EvaluationError("--rollouts, --people, --duration and --threads must be positive")
    if (args.push or args.paths == "strolls") and args.terrain in ("obstacles", "crowd"):
        raise EvaluationError("--push and --paths strolls need --terrain flat or random")
    torch.set_num_threads(args.threads)
    model, config, facts = load_walker(args.model)
    style = args.style or (STYLE if args.model == WALKER else None)
    judge = load_discriminator(style) if style else None
    if args.unaware:
        config = unaware(config, args.unaware)
    if args.gait:
        tell_steps(measure_steps(model, config), args.json, args.write)
    elif args.table:

        def judged(terrain: str, of: str, bodies: str | None) -> dict[str, Any]:
            case = argparse.Namespace(**vars(args) | {"bodies": bodies or args.bodies})
            walks, told = model, unaware(config, of) if of else config
            if of == "their body" and args.model == WALKER:
                walks, told, _ = load_walker(UNAWARE)
            return evaluate(case, walks, told, terrain, judge)

        tell_table(args.table, args.rollouts, facts.get("samples", 0), judged, args.json, args.write)
    else:
        figures = evaluate(args, model, config, args.terrain, judge) | {"samples": facts.get("samples", 0)}
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


def evaluate(
    args: argparse.Namespace,
    model: ActorCritic,
    config: WalkerConfig,
    terrain: str,
    judge: Discriminator | None,
) -> dict[str, Any]:
    """Figures of one kind of ground; of style, too, with somebody to judge it."""
    shared: dict[str, Any] = {"duration": args.duration, "discriminator": judge, "seed": args.seed}
    if terrain in ("obstacles", "crowd"):
        result = roll_out_together(model, config, args.rollouts, terrain, people=args.people, **shared)  # type: ignore[arg-type]
        return result.summary()
    course = None
    if terrain == "random":
        kinds = {kind: share for kind, share in SHARES.items() if kind != "obstacles"}
        course = make_course(COURSE, kinds, COURSE_SEED)
    result = roll_out(
        model,
        config,
        args.rollouts,
        people=args.people,
        bodies=_bodies(args),
        paths=stroll_paths(args.duration) if args.paths == "strolls" else None,
        push=args.push,
        course=course,
        **shared,
    )
    if args.failures and course:
        from .pacer_pictures import draw_failures

        draw_failures(args.failures, course, result)
    return result.summary() | ({"fail_rate_by_ground": _by_ground(result, course)} if course else {})


def _bodies(args: argparse.Namespace) -> list[Body] | None:
    if args.bodies == "usual":
        return None
    return [describe(shape_for(stature, mass)) for stature, mass in BUILDS]


def _by_ground(result: Rollouts, course: Course) -> dict[str, float]:
    """Share of those who ended on each kind of ground that failed there."""
    kinds = course.kinds_at(result.ends)
    return {kind: float(result.failed[[k == kind for k in kinds]].mean()) for kind in sorted(set(kinds))}
