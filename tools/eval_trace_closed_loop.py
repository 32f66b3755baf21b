"""Tables 2 and 8 of the TRACE paper on recorded crowds: closed loop, ten seconds, a new plan every second."""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..models.trace.closed_loop import LoopReport, LoopTally, asked, recorded, walk_all
from ..models.trace.crowd_file import CrowdFileError, Crowds
from ..models.trace.guidance import Guidance
from ..models.trace.network import Trace
from ..models.trace.planner import DISTILLED, FEW, Sampling, TracePlanner
from ..models.trace.rollouts import LoopPlanner, Rollout, rollouts
from ..models.trace.vae import WEIGHTS as VAE_WEIGHTS
from ..models.trace.vae import VaePlanner, load_vae
from ..models.trace.weights import WeightsError, load_model
from . import eval_trace_paper as paper
from .data_eth_ucy import FOLDS as LEFT_OUT
from .data_eth_ucy import RECORDINGS
from .eval_trace_paper import Row
from .eval_trace_pictures import draw_rollouts
from .progress import progress_line

FOLDS = ("eth", "hotel", "zara")
"""Places with maps, for each of which there is a network that has seen nobody there."""
NETWORKS = ("biwi", "zara")
"""Folds that a network is shipped for each."""
QUICK_ROLLOUTS = 4
SAMPLES = 10  # app. C.5
VAE_ITERATIONS = 200  # app. C.4
GUIDES = ("waypoint", "urgent", "perturbed", "groups")
STRENGTH = 0.6
"""Of guidance: gently, as a second later there is another plan (this and all below chosen on validation scenes)."""
INNER_STEPS = {"groups": 15}
"""Of `direct` guidance: members of a group who move apart, each as far as it takes, have gone too far."""
_TEMPERATURE = 0.85  # of `direct`: of ten samples the best of each plan is followed, so fewer need to be bold
_FEW_STEPS = dataclasses.replace(FEW, steps=8, samples=SAMPLES, keep=0.7)
_MANY_STEPS = Sampling(solver="ddim", steps=20, samples=SAMPLES, keep=0.7)
METHODS: dict[str, tuple[Sampling, Guidance]] = {
    "filter": (_FEW_STEPS, Guidance(strength=0.0, inner_steps=1, polish=0)),
    "noisy": (_MANY_STEPS, Guidance(mode="noisy")),
    "clean": (_MANY_STEPS, Guidance(mode="clean")),
    "direct": (_FEW_STEPS, Guidance(mode="direct", polish=0, temperature=_TEMPERATURE)),
}
"""As in the other tables, with fewer samples and steps of guidance."""
CONTEXT_WEIGHTS = {"direct": (0.0, -0.5), "clean": (0.0, -0.5)}
"""w of classifier-free sampling that table 2 tries; 0 for methods that are not here."""

FIGURES = {
    "error": "guide error",
    **{f"error_{fold}": f"in {fold}" for fold in FOLDS},
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


@dataclass(frozen=True)
class Fold:
    """A place, and a network that has seen nobody there.

    Attributes:
        name: Of the place.
        trials: Its rollouts.
        trace: The network.
        facts: How it was trained.
    """

    name: str
    trials: list[Rollout]
    trace: Trace
    facts: Mapping[str, Any]

    def has(self, guide: str) -> bool:
        """Whether anybody can be guided so: in groups there must be somebody who walks with somebody."""
        return next(asked(self.trials, guide, seed=0), None) is not None

    def with_weights(self, path: Path) -> "Fold":
        """The same with another network.

        Raises:
            WeightsError: When there is none, or it has seen people of the place.
        """
        trace, facts = load_unseen(path, self.name)
        return dataclasses.replace(self, trace=trace, facts=facts)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what tables 2 and 8 need to `eval trace`."""
    parser.add_argument(
        "--recorded",
        type=Path,
        default=Path("data/eth_ucy"),
        help="made by `data eth-ucy`, for tables 2 and 8",
    )
    parser.add_argument(
        "--folds",
        nargs="+",
        choices=sorted(LEFT_OUT),
        default=list(FOLDS),
        help="of tables 2 and 8: each with the weights that have seen nobody there, or with --weights "
        f"(default: {' '.join(FOLDS)})",
    )
    parser.add_argument("--vae", type=Path, default=VAE_WEIGHTS, help="weights of the VAE baseline")


def read_folds(args: argparse.Namespace) -> list[Fold]:
    """The rollouts of a split of each fold, `--scenes` of each, evenly spread, with their networks.

    Raises:
        CrowdFileError: When a fold is not there or its scenes are too short.
        WeightsError: When a fold has no network, or one that has seen people there.
    """
    folds = []
    limit = QUICK_ROLLOUTS if args.quick else args.scenes
    for name in args.folds:
        trace, facts = load_unseen(args.weights or shipped(name), name)
        kind = "maps" if all(RECORDINGS[place].scene for place in LEFT_OUT[name]) else "open"
        crowds = Crowds.load(args.recorded / name / f"{kind}.npz")
        found = rollouts(crowds, trace.config, args.split)
        if not found:
            raise CrowdFileError(f"{args.recorded / name}: nobody in it is seen for ten seconds")
        kept = np.linspace(0, len(found) - 1, min(limit or len(found), len(found))).round().astype(int)
        folds.append(Fold(name, [found[i] for i in kept], trace, facts))
    return folds


def shipped(fold: str) -> Path:
    """Weights that have seen nobody of a fold.

    Raises:
        WeightsError: When there are none.
    """
    for name in NETWORKS:
        if set(LEFT_OUT[fold]) <= set(LEFT_OUT[name]):
            return DISTILLED.with_name(f"trace_compact_mixed_{name}.safetensors")
    raise WeightsError(f"no weights are shipped that have seen nobody of {fold}: --weights must name some")


def load_unseen(path: Path, fold: str) -> tuple[Trace, dict[str, Any]]:
    """A network that has seen nobody of a fold, and its facts.

    Raises:
        WeightsError: When there is none, or it has.
    """
    trace, facts = load_model(path)
    check_left_out(path, facts, fold)
    return trace, facts


def check_left_out(path: Path, facts: Mapping[str, Any], fold: str) -> None:
    """Nobody of a fold may have been seen in training, nor in that of the weights it started from.

    Raises:
        WeightsError: Says which training set tells so.
    """
    for source in facts.get("data", []):
        check_left_out(path, source, fold)
        if "fold" in source and not set(LEFT_OUT[fold]) <= set(LEFT_OUT.get(source["fold"], ())):
            raise WeightsError(
                f"{path}: trained on {source['name']}, which holds people of {fold}; table 2 wants weights that have "
                "seen nobody there"
            )


def trained_on(facts: Mapping[str, Any]) -> str:
    """The names of the training sets of weights."""
    names = [str(source["name"]) for source in facts.get("data", []) if "scenes" in source]
    return ", ".join(name.removeprefix("orca-") for name in names)


def source(folds: Sequence[Fold], split: str) -> str:
    """What stands above a table: the weights and the rollouts."""
    parts = [
        f"{len(fold.trials)} {split} rollouts of {fold.name} by {fold.trace.config.name}, "
        f"step {fold.facts.get('step')}, trained on {trained_on(fold.facts)}"
        for fold in folds
    ]
    return f"{'; '.join(parts)} (a fold bears the name of the place it leaves out)"


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


def pooled(tallies: Mapping[str, LoopTally]) -> Row:
    """Figures of all people of all folds, and of each fold with its name behind the key."""
    together = LoopTally(next(iter(tallies.values())).dt)
    apart: Row = {}
    for name, tally in tallies.items():
        together.extend(tally)
        apart |= {f"{key}_{name}": value for key, value in figures(tally.report()).items()}
    return figures(together.report()) | apart


def walked(planned: Mapping[str, LoopPlanner], folds: Sequence[Fold], guide: str) -> Row:
    """Figures of a planner for each fold, with progress on a terminal."""
    return pooled(
        {
            fold.name: walk_all(
                planned[fold.name],
                fold.trials,
                guide,
                clock=time.process_time,
                progress=progress_line(f"rollout of {fold.name}"),
            )
            for fold in folds
        }
    )


def make_planner(trace: Trace, method: str, guide: str, weight: float) -> TracePlanner:
    """The planner of a method, guided gently."""
    sampling, guidance = METHODS[method]
    if method != "filter":
        guidance = dataclasses.replace(
            guidance, strength=STRENGTH, inner_steps=INNER_STEPS.get(guide, guidance.inner_steps)
        )
    return TracePlanner(trace, dataclasses.replace(sampling, context_weight=weight), guidance)


def planners(folds: Sequence[Fold], method: str, guide: str, weight: float) -> dict[str, TracePlanner]:
    """The planner of a method for each fold, with its network."""
    return {fold.name: make_planner(fold.trace, method, guide, weight) for fold in folds}


def compared(
    folds: Sequence[Fold], guide: str, args: argparse.Namespace
) -> Iterator[tuple[str, float | None, Mapping[str, LoopPlanner]]]:
    """Methods with their w and planners."""
    for method in args.methods:
        if method == "vae" and args.vae.is_file():
            vae = VaePlanner(load_vae(args.vae)[0], samples=SAMPLES, iterations=VAE_ITERATIONS)
            yield method, None, {fold.name: vae for fold in folds}
        elif method in METHODS:
            for weight in CONTEXT_WEIGHTS.get(method, (0.0,)):
                yield method, weight, planners(folds, method, guide, weight)


def table_2(folds: Sequence[Fold], args: argparse.Namespace) -> Iterator[Row]:
    """Guides by methods, after what was recorded; then the networks of `--others`, guided as shipped."""
    others = [[fold.with_weights(path) for fold in folds] for path in args.others]
    for guide in GUIDES:
        yield from (row for row in paper.TABLE_2 if row["guide"] == guide)
        if not (led := [fold for fold in folds if fold.has(guide)]):
            continue
        truth = pooled({fold.name: recorded(fold.trials, guide) for fold in led})
        yield {"guide": guide, "method": "recorded", **truth}
        rows = list(compared(led, guide, args))
        for other in others:
            name = f"direct, trained on {trained_on(other[0].facts)}"
            rows.append((name, 0.0, planners(other, "direct", guide, 0.0)))
        for method, weight, planned in rows:
            config = planned[led[0].name].config.name
            labels: Row = {"guide": guide, "method": method, "config": config, "w": weight}
            yield labels | walked(planned, led, guide)


def table_8(folds: Sequence[Fold], args: argparse.Namespace) -> Iterator[Row]:
    """The weight of classifier-free sampling."""
    for row in paper.TABLE_8:
        yield row
        planned = planners(folds, "direct", "perturbed", float(row["w"] or 0))
        labels: Row = {"w": row["w"], "method": "direct", "config": folds[0].trace.config.name}
        yield labels | walked(planned, folds, "perturbed")


def picture(fold: Fold, folder: Path) -> Path:
    """Perturbed waypoints with w = 0 and -0.5, and groups."""
    shown = {
        f"{title}, w = {weight:g}": (guide, make_planner(fold.trace, "direct", guide, weight))
        for guide, title in (("perturbed", "perturbed waypoints"), ("groups", "groups"))
        for weight in CONTEXT_WEIGHTS["direct"]
    }
    return draw_rollouts(folder, shown, fold.trials)


TABLES = {"2": table_2, "8": table_8}
