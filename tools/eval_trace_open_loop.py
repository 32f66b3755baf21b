"""Tables 1, 5, 6 and 7 of the TRACE paper and that of the samplers: five seconds of simulated crowds at once."""

import argparse
import dataclasses
import math
import os
import time
from collections.abc import Iterator
from typing import Any

from ..models.trace.evaluation import (
    GUIDES,
    Choice,
    Report,
    TrialScenes,
    Wishes,
    evaluate,
    evaluate_filter,
    no_wish,
)
from ..models.trace.guidance import Guidance
from ..models.trace.network import Trace
from ..models.trace.planner import FEW, SHIPPED, THOROUGH, Sampling, TracePlanner
from ..models.trace.scene_planner import ScenePlanner
from ..models.trace.vae import WEIGHTS as VAE_WEIGHTS
from ..models.trace.vae import VaePlanner, load_vae
from ..models.trace.weights import load_model
from . import eval_trace_paper as paper
from .eval_trace_closed_loop import trained_on
from .eval_trace_paper import Row
from .progress import progress_line

LEAST = 1e-3
"""Of a measure, in its own unit: added to both sides of a ratio."""
WORKERS = os.cpu_count() or 1
UNGUIDED = Sampling(solver="ddpm", samples=3, context_weight=0.5)
"""As the paper's: the unguided row of its table 1 is that of w = 0.5 in its table 7. The mean of three runs varies by
a fifth from seed to seed, more than samplers differ: table 1 takes every one of its 20 samples for a run."""
FAST = dataclasses.replace(SHIPPED, samples=20)
SLOW = Sampling(solver="ddpm", samples=20)
QUICK = Sampling(solver="ddim", steps=20, samples=20)
"""Instead of `SLOW` with `--quick`, which has no time for 100 steps."""
FAITHFUL = Sampling(solver="sde", steps=20, samples=20, context_weight=0.5)
"""Of tables 5 and 6, where 20 samples of all 100 steps would take a quarter of an hour a row, and with `--quick`."""
GUIDANCES = {
    "noisy": Guidance(mode="noisy"),
    "clean": Guidance(mode="clean"),
    "direct_slow": dataclasses.replace(THOROUGH, tries=0, haste=0.0),
    "direct": THOROUGH,
}
"""Noisy: eq 5. Clean: eq 6, through the network. Direct: through the dynamics alone; what the planner ships with.
It takes the four steps of the distilled network, tries again where that does not do, and holds back who hurries; all
others take the steps of the paper. Slow: what the fast one is measured by, without either (the crowd of 100 steps does
not hurry under all objectives)."""
METHODS = ["filter", *GUIDANCES, "vae"]
"""Filter: choose among unguided samples. VAE: latent optimisation (app. C.4)."""

FEWEST = 6
"""Up to so many steps strides and temperature of `dpm` are those of few steps."""
SAMPLERS: list[tuple[str, int]] = [
    ("ddpm", 100),
    ("distilled", 4),
    ("sde", 20),
    *(("ddim", steps) for steps in (4, 6, 8, 12, 20)),
    *(("dpm", steps) for steps in (3, 4, 5, 6, 8, 12, 20)),
]
WEIGHTS_OF_CONTEXT = (0.0, 0.3, 0.5, 0.7, 1.0, 2.0)

METRICS = {
    "obstacle": "obstacle",
    "agent": "agent",
    "emd_vel": "EMD speed",
    "emd_lon": "EMD lon",
    "emd_lat": "EMD lat",
    "emd_lon_compat": "lon, world axes",
    "emd_lat_compat": "lat, world axes",
}
LAST = {"seconds": "CPU s/scene"}
COLUMNS: dict[str, dict[str, str]] = {
    "1": {
        "guide": "guide",
        "method": "method",
        "sampler": "sampler",
        "error": "guide error",
        **METRICS,
        "ratio": "over 100 steps",
        **LAST,
    },
    "5": {"method": "method", "steps": "steps", "ade": "ADE", "fde": "FDE", **METRICS},
    "6": {
        "method": "method",
        "data": "trained on",
        "drop": "drop rate",
        "steps": "steps",
        "ade": "ADE",
        "fde": "FDE",
        **METRICS,
    },
    "7": {"w": "w", "method": "method", **METRICS},
    "samplers": {
        "sampler": "sampler",
        "guide": "guide",
        "error": "waypoint",
        **METRICS,
        "ratio": "vs ddpm",
        **LAST,
    },
}
TITLES = {
    "1": "Guidance on ORCA-Maps (TRACE, table 1)",
    "5": "No guidance, the sample nearest to the truth of 20: architecture (TRACE, table 5)",
    "6": "No guidance, the sample nearest to the truth of 20: training (TRACE, table 6)",
    "7": "Classifier-free sampling without guidance (TRACE, table 7)",
    "samplers": "Quality and time of the samplers",
}


def metrics(report: Report) -> Row:
    """The columns that all tables share."""
    names = {"speed": "vel", "longitudinal": "lon", "lateral": "lat"}
    return {
        "obstacle": report.obstacle,
        "agent": report.agent,
        **{f"emd_{names[k]}": v for k, v in report.emd.items()},
        **{f"emd_{names[k]}_compat": v for k, v in report.emd_compat.items() if k != "speed"},
    }


def measures_ratio(row: Row, reference: Row) -> float:
    """Geometric mean of a row's measures over those of another row; what differs by far less than .001 is equal.

    A single column says little: EMDs of three runs vary by a sixth from seeds to seeds.
    """
    names = ["obstacle", "agent", "emd_vel", "emd_lon", "emd_lat"]
    if row["guide"] in ("waypoint", "all"):  # else it is none, or one of these
        names.append("error")
    logs = [math.log((float(row[n] or 0) + LEAST) / (float(reference[n] or 0) + LEAST)) for n in names]
    return math.exp(sum(logs) / len(logs))


def guide_error(guide: str, report: Report) -> float | None:
    """What the guide is about (app. C.2); nothing without one."""
    errors = {"none": None, "obstacle": report.obstacle, "agent": report.agent}
    return errors.get(guide, report.waypoint)


def evaluate_all(
    scenes: TrialScenes,
    planner: ScenePlanner,
    wishes: Wishes = no_wish,
    choice: Choice = "guide",
    runs: int = 1,
) -> Report:
    """`evaluate` with a scene a core, and progress on a terminal."""
    progress = progress_line("scene")
    return evaluate(planner, scenes, wishes, choice, time.process_time, WORKERS, runs, progress)


def table_1(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Guides by methods."""
    methods, slow = list(args.methods), QUICK if args.quick else SLOW
    config, shipped = trace.config.name, fast.config.name
    if "vae" in methods and not VAE_WEIGHTS.is_file():
        methods.remove("vae")
    if args.quick and "direct_slow" in methods:
        methods.remove("direct_slow")
    filtered = {}
    if "filter" in methods and (chosen := {g: GUIDES[g] for g in args.guides if g != "none"}):
        unguided_slow, progress = TracePlanner(trace, slow), progress_line("scene")
        filtered = evaluate_filter(unguided_slow, scenes, chosen, time.process_time, WORKERS, progress)

    def planner(method: str) -> ScenePlanner:
        if method == "vae":
            return VaePlanner(load_vae()[0], 20)
        network, sampling = (fast, FAST) if method == "direct" else (trace, slow)
        return TracePlanner(network, sampling, GUIDANCES[method])

    def unguided() -> Iterator[tuple[str, ScenePlanner]]:
        paper_like, runs = (FAITHFUL, UNGUIDED.samples) if args.quick else (UNGUIDED, FAST.samples)
        yield "unguided", TracePlanner(trace, dataclasses.replace(paper_like, samples=runs))
        yield "direct", TracePlanner(fast, dataclasses.replace(FAST, samples=runs))
        if "vae" in methods:
            yield "vae", VaePlanner(load_vae()[0], runs)

    slowly: dict[str, Row] = {}  # by guide, what fewer steps are measured by: rows of 100 steps

    def row(guide: str, method: str, sampler: str, report: Report) -> Row:
        name = shipped if method == "direct" else config
        labels: Row = {"guide": guide, "method": method, "sampler": sampler, "config": name}
        found = labels | {"error": guide_error(guide, report), **metrics(report), "seconds": report.seconds}
        if method in ("unguided", "direct_slow") and not args.quick:
            slowly[guide] = found
        elif method == "direct" and guide in slowly:
            found["ratio"] = measures_ratio(found, slowly[guide])
        return found

    for guide in args.guides:
        yield from (row for row in paper.TABLE_1 if row["guide"] == guide)
        if guide == "none":
            for method, ours in unguided():
                report = evaluate_all(scenes, ours, choice="every")
                yield row(guide, method, sampler_name(ours), report)
            continue
        for method in methods:
            if method == "filter":
                yield row(guide, method, slow.name(trace.config), filtered[guide])
            else:
                ours = planner(method)
                report = evaluate_all(scenes, ours, GUIDES[guide], runs=args.runs)
                yield row(guide, method, sampler_name(ours), report)


def sampler_name(planner: ScenePlanner) -> str:
    """Of a table's row; a VAE has none."""
    return "" if isinstance(planner, VaePlanner) else planner.sampling.name(planner.config)


def nearest_to_truth(scenes: TrialScenes, planner: ScenePlanner) -> Row:
    """Figures of the best of an unguided planner's samples."""
    report = evaluate_all(scenes, planner, choice="truth")
    return {"ade": report.ade, "fde": report.fde, **metrics(report)}


def table_5(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Other samplers and architectures."""
    yield from paper.TABLE_5
    apart = Trace(dataclasses.replace(trace.config, joint=False))
    apart.load_state_dict(trace.state_dict())
    name = trace.config.name
    step = load_model(args.weights)[1].get("step")
    planners: list[tuple[str, Any, ScenePlanner]] = [
        (name, step, TracePlanner(trace, FAITHFUL)),
        (f"{fast.config.name}, 4 steps", load_model(args.distilled)[1].get("step"), TracePlanner(fast, FAST)),
        (f"{name}, neighbours at constant velocity", step, TracePlanner(apart.eval(), FAITHFUL)),
    ]
    for path in args.others:
        other, facts = load_model(path)
        planners.append((other.config.name, facts.get("step"), TracePlanner(other, FAITHFUL)))
    if VAE_WEIGHTS.is_file():
        vae, facts = load_vae()
        planners.append(("VAE", facts.get("step"), VaePlanner(vae, 20)))
    for method, steps, planner in planners:
        yield {"method": method, "steps": steps, **nearest_to_truth(scenes, planner)}


def table_6(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Other data and rates of dropping map and neighbours; ours among those of `--others` that differ in them."""
    yield from paper.TABLE_6
    for path in (args.weights, *args.others):
        model, facts = load_model(path)
        if model.config != trace.config:
            continue
        labels = {"data": trained_on(facts), "drop": facts["drop"]}
        row = nearest_to_truth(scenes, TracePlanner(model, FAITHFUL))
        yield {"method": trace.config.name, **labels, "steps": facts["step"], **row}


def table_7(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """The weight of classifier-free sampling."""
    yield from paper.TABLE_7
    for weight in WEIGHTS_OF_CONTEXT:
        sampling = dataclasses.replace(UNGUIDED, context_weight=weight)
        report = evaluate_all(scenes, TracePlanner(trace, sampling), choice="every")
        yield {"w": weight, "method": trace.config.name, **metrics(report)}


def table_samplers(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Every sampler without guidance, and with all objectives at once.

    `ratio` is the guided waypoint error over that of all 100 steps.
    """
    reference = None
    for solver, steps in SAMPLERS:
        for guide in ("none", "all"):
            samples = UNGUIDED.samples if guide == "none" else FAST.samples
            if solver == "distilled":
                network, sampling = fast, dataclasses.replace(FAST, samples=samples)
            else:
                base = FEW if solver == FEW.solver and steps <= FEWEST else Sampling()
                sampling = dataclasses.replace(base, solver=solver, steps=steps, samples=samples)  # pyright: ignore[reportArgumentType]
                network = trace
            planner = TracePlanner(network, sampling, Guidance())  # the same for all: no second tries
            choice = "every" if guide == "none" else "guide"
            report = evaluate_all(scenes, planner, GUIDES[guide], choice)
            reference = reference or (report.waypoint if guide == "all" else None)
            ratio = report.waypoint / reference if guide == "all" and reference else None
            labels: Row = {"sampler": f"{solver} {steps}", "guide": guide}
            error = guide_error(guide, report)
            yield labels | {"error": error, **metrics(report), "ratio": ratio, "seconds": report.seconds}


TABLES = {"1": table_1, "5": table_5, "6": table_6, "7": table_7, "samplers": table_samplers}
