"""Tables 2 and 8 of the TRACE paper on recorded crowds: closed loop, ten seconds, a new plan every second."""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..models.trace.closed_loop import LoopReport, evaluate_loop, recorded
from ..models.trace.config import TraceConfig
from ..models.trace.crowd_file import Crowds
from ..models.trace.guidance import Guidance
from ..models.trace.network import Trace
from ..models.trace.planner import Sampling, TracePlanner
from ..models.trace.rollouts import Rollout, rollouts
from ..models.trace.vae import WEIGHTS as VAE_WEIGHTS
from ..models.trace.vae import VaePlanner, load_vae

FOLDS = ("eth", "hotel", "zara1", "zara2")  # those with maps
QUICK_ROLLOUTS = 4
SAMPLES = 10  # app. C.5
METHODS: dict[str, tuple[Sampling, Guidance]] = {
    "filter": (Sampling(steps=8, samples=SAMPLES), Guidance(strength=0.0, inner_steps=1)),
    "noisy": (Sampling(solver="ddim", steps=20, samples=SAMPLES), Guidance(mode="noisy")),
    "clean": (Sampling(solver="ddim", steps=20, samples=SAMPLES), Guidance(mode="clean")),
    "direct": (Sampling(steps=8, samples=SAMPLES), Guidance(mode="direct")),
}
"""As in the other tables, with fewer samples."""
GUIDES = ("waypoint", "perturbed", "groups")
WEIGHTS = {"direct": (0.0, -0.5), "clean": (0.0, -0.5)}
"""w of classifier-free sampling that table 2 tries; 0 for methods that are not here."""

# (guide, method, w): guidance error, mean longitudinal and lateral acceleration; on nuScenes
PAPER_TABLE_2 = {
    ("waypoint", "paper: VAE", None): (0.340, 0.193, 0.172),
    ("waypoint", "paper: TRACE", 0.0): (0.551, 0.159, 0.145),
    ("waypoint", "paper: TRACE", -0.5): (0.366, 0.140, 0.132),
    ("perturbed", "paper: VAE", None): (0.962, 0.443, 0.441),
    ("perturbed", "paper: TRACE", 0.0): (1.129, 0.233, 0.218),
    ("perturbed", "paper: TRACE", -0.5): (0.802, 0.212, 0.204),
    ("groups", "paper: VAE", None): (0.297, 0.109, 0.104),
    ("groups", "paper: TRACE", 0.0): (0.244, 0.110, 0.101),
    ("groups", "paper: TRACE", -0.5): (0.245, 0.094, 0.087),
}
# w: perturbed waypoint error, mean longitudinal and lateral acceleration; on nuScenes
PAPER_TABLE_8 = {
    0.0: (1.129, 0.233, 0.218),
    -0.3: (0.972, 0.213, 0.199),
    -0.5: (0.802, 0.212, 0.204),
    -0.7: (0.670, 0.240, 0.233),
    -1.0: (0.546, 0.345, 0.348),
}
FIGURES = ["guide error", "lon acc", "lat acc", "obstacle", "agent", "EMD speed", "CPU s/rollout"]
HEADS = {"2": ["guide", "method", "w", *FIGURES], "8": ["w", "method", *FIGURES]}
TITLES = {
    "2": "Closed loop on recorded crowds (as TRACE, table 2, on nuScenes)",
    "8": "Classifier-free sampling with perturbed waypoints in closed loop (as TRACE, table 8, on nuScenes)",
}
Row = list[str | float | None]


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
    parser.add_argument("--rollouts", type=int, help="only so many of each fold, evenly spread")
    parser.add_argument("--vae", type=Path, default=VAE_WEIGHTS, help="weights of the VAE baseline")


def read_trials(args: argparse.Namespace, config: TraceConfig) -> list[Rollout]:
    """The rollouts of the folds' test splits.

    Raises:
        CrowdFileError: When a fold is not there or its scenes are too short.
    """
    trials = []
    limit = QUICK_ROLLOUTS if args.quick else args.rollouts
    for fold in args.folds:
        kind = "maps" if fold in FOLDS else "open"
        found = rollouts(Crowds.load(args.recorded / fold / f"{kind}.npz"), config)
        kept = np.linspace(0, len(found) - 1, min(limit or len(found), len(found))).round().astype(int)
        trials += [found[i] for i in kept]
    return trials


def figures(report: LoopReport) -> Row:
    """The columns that both tables share."""
    row: Row = [report.error, report.longitudinal, report.lateral, report.obstacle, report.agent]
    return [*row, report.emd_speed, report.seconds]


def planners(
    trace: Trace, method: str, args: argparse.Namespace
) -> Iterator[tuple[float | None, TracePlanner]]:
    """The planners of a method with their w."""
    if method == "vae":
        yield None, VaePlanner(load_vae(args.vae)[0], samples=SAMPLES, iterations=200)
        return
    sampling, guidance = METHODS[method]
    for weight in WEIGHTS.get(method, (0.0,)):
        yield weight, TracePlanner(trace, dataclasses.replace(sampling, context_weight=weight), guidance)


def table_2(trace: Trace, trials: Sequence[Rollout], args: argparse.Namespace) -> Iterator[Row]:
    """Guides by methods, after what was recorded."""
    for guide in GUIDES:
        for (name, label, weight), (error, along, across) in PAPER_TABLE_2.items():
            if name == guide:
                yield [guide, label, weight, error, along, across, None, None, None, None]
        yield [guide, "recorded", None, *figures(recorded(trials, guide))[:-1], None]
        for method in args.methods:
            for weight, planner in planners(trace, method, args):
                report = evaluate_loop(planner, trials, guide, clock=time.process_time)
                yield [guide, method, weight, *figures(report)]


def table_8(trace: Trace, trials: Sequence[Rollout], args: argparse.Namespace) -> Iterator[Row]:
    """The weight of classifier-free sampling."""
    sampling, guidance = METHODS["direct"]
    for weight, (error, along, across) in PAPER_TABLE_8.items():
        yield [weight, "paper: TRACE", error, along, across, None, None, None, None]
        planner = TracePlanner(trace, dataclasses.replace(sampling, context_weight=weight), guidance)
        yield [
            weight,
            "direct",
            *figures(evaluate_loop(planner, trials, "perturbed", clock=time.process_time)),
        ]


TABLES = {"2": table_2, "8": table_8}
