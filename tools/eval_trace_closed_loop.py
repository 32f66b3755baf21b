"""Tables 2 and 8 of the TRACE paper on recorded crowds: closed loop, ten seconds, a new plan every second."""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..models.trace.closed_loop import LoopReport, evaluate_loop, recorded
from ..models.trace.config import TraceConfig
from ..models.trace.crowd_file import Crowds
from ..models.trace.guidance import Guidance
from ..models.trace.network import Trace
from ..models.trace.planner import FEW, Sampling, TracePlanner
from ..models.trace.rollouts import Rollout, rollouts
from ..models.trace.vae import WEIGHTS as VAE_WEIGHTS
from ..models.trace.vae import VaePlanner, load_vae
from ..models.trace.weights import load_model
from . import eval_trace_paper as paper
from .eval_trace_paper import Row
from .eval_trace_pictures import draw_rollouts
from .progress import progress_line

FOLDS = ("eth", "hotel", "zara1", "zara2")  # those with maps
QUICK_ROLLOUTS = 4
SAMPLES = 10  # app. C.5
VAE_ITERATIONS = 200  # app. C.4
STRENGTH = {"waypoint": 0.2, "perturbed": 0.2, "groups": 1.0}
"""Of guidance: waypoints gently, as a second later there is another plan (chosen on validation scenes)."""
_FEW_STEPS = dataclasses.replace(FEW, steps=8, samples=SAMPLES)
_MANY_STEPS = Sampling(solver="ddim", steps=20, samples=SAMPLES)
METHODS: dict[str, tuple[Sampling, Guidance]] = {
    "filter": (_FEW_STEPS, Guidance(strength=0.0, inner_steps=1, polish=0)),
    "noisy": (_MANY_STEPS, Guidance(mode="noisy")),
    "clean": (_MANY_STEPS, Guidance(mode="clean")),
    "direct": (_FEW_STEPS, Guidance(mode="direct", inner_steps=1, polish=0)),
}
"""As in the other tables, with fewer samples and steps of guidance."""
GUIDES = ("waypoint", "perturbed", "groups")
WEIGHTS = {"direct": (0.0, -0.5), "clean": (0.0, -0.5)}
"""w of classifier-free sampling that table 2 tries; 0 for methods that are not here."""

FIGURES = {
    "error": "guide error",
    "lon": "lon acc",
    "lat": "lat acc",
    "obstacle": "obstacle",
    "agent": "agent",
    "emd_vel": "EMD speed",
    "seconds": "CPU s/rollout",
}
COLUMNS = {
    "2": {"guide": "guide", "method": "method", "w": "w", **FIGURES},
    "8": {"w": "w", "method": "method", **FIGURES},
}
TITLES = {
    "2": "Closed loop on recorded crowds, ETH/UCY (TRACE, table 2; the paper's figures are on nuScenes)",
    "8": "Classifier-free sampling with perturbed waypoints, ETH/UCY (TRACE, table 8; the paper's on nuScenes)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what tables 2 and 8 need to `eval trace`."""
    parser.add_argument(
        "--recorded",
        type=Path,
        default=Path("data/eth_ucy"),
        help="made by `data eth-ucy`, for tables 2 and 8",
    )
    parser.add_argument(
        "--folds", nargs="+", default=list(FOLDS), help="of tables 2 and 8 (default: %(default)s)"
    )
    parser.add_argument("--vae", type=Path, default=VAE_WEIGHTS, help="weights of the VAE baseline")


def read_trials(args: argparse.Namespace, config: TraceConfig) -> list[Rollout]:
    """The rollouts of a split of the folds, `--scenes` of each, evenly spread.

    Raises:
        CrowdFileError: When a fold is not there or its scenes are too short.
    """
    trials = []
    limit = QUICK_ROLLOUTS if args.quick else args.scenes
    for fold in args.folds:
        kind = "maps" if fold in FOLDS else "open"
        found = rollouts(Crowds.load(args.recorded / fold / f"{kind}.npz"), config, args.split)
        kept = np.linspace(0, len(found) - 1, min(limit or len(found), len(found))).round().astype(int)
        trials += [found[i] for i in kept]
    return trials


def trained_on(facts: Mapping[str, Any]) -> str:
    """The names of the training sets of weights."""
    names = [str(source["name"]) for source in facts.get("data", []) if "scenes" in source]
    return ", ".join(name.removeprefix("orca-") for name in names)


def source(
    trace: Trace, facts: Mapping[str, Any], trials: Sequence[Rollout], args: argparse.Namespace
) -> str:
    """What stands above a table: the weights and the rollouts."""
    model = f"{trace.config.name}, step {facts.get('step')}, trained on {trained_on(facts)}"
    where = f"{len(trials)} {args.split} rollouts of {', '.join(args.folds)}"
    return f"{model} (a fold bears the name of the place it leaves out); {where}"


def figures(report: LoopReport) -> Row:
    """The columns that both tables share."""
    return {
        "error": report.error,
        "lon": report.longitudinal,
        "lat": report.lateral,
        "obstacle": report.obstacle,
        "agent": report.agent,
        "emd_vel": report.emd_speed,
        "seconds": report.seconds or None,
    }


def walked(planner: TracePlanner, trials: Sequence[Rollout], guide: str) -> LoopReport:
    """`evaluate_loop`, with progress on a terminal."""
    progress = progress_line("rollout")
    return evaluate_loop(planner, trials, guide, clock=time.process_time, progress=progress)


def planners(
    trace: Trace, method: str, guide: str, args: argparse.Namespace
) -> Iterator[tuple[float | None, TracePlanner]]:
    """The planners of a method with their w; none where its weights are not there."""
    if method == "vae":
        if args.vae.is_file():
            yield None, VaePlanner(load_vae(args.vae)[0], samples=SAMPLES, iterations=VAE_ITERATIONS)
        return
    sampling, guidance = METHODS[method]
    if method != "filter":
        guidance = dataclasses.replace(guidance, strength=STRENGTH[guide])
    for weight in WEIGHTS.get(method, (0.0,)):
        yield weight, TracePlanner(trace, dataclasses.replace(sampling, context_weight=weight), guidance)


def table_2(trace: Trace, trials: Sequence[Rollout], args: argparse.Namespace) -> Iterator[Row]:
    """Guides by methods, after what was recorded."""
    for guide in GUIDES:
        yield from (row for row in paper.TABLE_2 if row["guide"] == guide)
        yield {"guide": guide, "method": "recorded", **figures(recorded(trials, guide))}
        for method, weight, planner in compared(trace, guide, args):
            report = walked(planner, trials, guide)
            labels: Row = {"guide": guide, "method": method, "config": planner.config.name, "w": weight}
            yield labels | figures(report)


def compared(
    trace: Trace, guide: str, args: argparse.Namespace
) -> Iterator[tuple[str, float | None, TracePlanner]]:
    """Methods with their w and planners; then those of `--others`, guided as shipped."""
    for method in args.methods:
        for weight, planner in planners(trace, method, guide, args):
            yield method, weight, planner
    for path in args.others:
        other, facts = load_model(path)
        weight, planner = next(planners(other, "direct", guide, args))
        yield f"direct, trained on {trained_on(facts)}", weight, planner


def table_8(trace: Trace, trials: Sequence[Rollout], args: argparse.Namespace) -> Iterator[Row]:
    """The weight of classifier-free sampling."""
    sampling, guidance = METHODS["direct"]
    guidance = dataclasses.replace(guidance, strength=STRENGTH["perturbed"])
    for row in paper.TABLE_8:
        yield row
        planner = TracePlanner(
            trace, dataclasses.replace(sampling, context_weight=float(row["w"] or 0)), guidance
        )
        report = walked(planner, trials, "perturbed")
        yield {"w": row["w"], "method": "direct", "config": trace.config.name, **figures(report)}


def picture(trace: Trace, trials: Sequence[Rollout], args: argparse.Namespace) -> Path:
    """Perturbed waypoints with w = 0 and -0.5, and groups."""
    shown: dict[str, tuple[str, TracePlanner]] = {}
    for guide, title in (("perturbed", "perturbed waypoints"), ("groups", "groups")):
        for weight, planner in planners(trace, "direct", guide, args):
            shown[f"{title}, w = {weight:g}"] = guide, planner
    return draw_rollouts(args.pictures, shown, trials)


TABLES = {"2": table_2, "8": table_8}
