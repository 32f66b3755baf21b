"""`footfall eval trace`: the tables of the TRACE paper on our own test scenes, beside the printed figures."""

import argparse
import dataclasses
import json
import math
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from ..models.trace.crowd_file import Crowds
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
from ..models.trace.planner import DISTILLED, FEW, SHIPPED, THOROUGH, WEIGHTS, Sampling, TracePlanner
from ..models.trace.vae import WEIGHTS as VAE_WEIGHTS
from ..models.trace.vae import VaePlanner, load_vae
from ..models.trace.weights import load_model
from . import eval_trace_closed_loop as closed_loop
from . import eval_trace_paper as paper
from .eval_trace_paper import Row
from .eval_trace_pictures import draw_guides, draw_samplers, draw_samples, draw_weights
from .progress import progress_line
from .results import write_section

QUICK_SCENES = 4
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
"""Of tables 5 and 6: 20 samples of all 100 steps would take a quarter of an hour a row."""
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
CHOICES = ["filter", *GUIDANCES, "vae"]
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
    **closed_loop.COLUMNS,
}
"""Of each table: key in JSON and heading in Markdown."""
TITLES = {
    "1": "Guidance on ORCA-Maps (TRACE, table 1)",
    "5": "No guidance, the sample nearest to the truth of 20: architecture (TRACE, table 5)",
    "6": "No guidance, the sample nearest to the truth of 20: training (TRACE, table 6)",
    "7": "Classifier-free sampling without guidance (TRACE, table 7)",
    "samplers": "Quality and time of the samplers",
    **closed_loop.TITLES,
}


def add_parser(subparsers) -> None:
    """Add `eval trace` to the command line."""
    parser = subparsers.add_parser("trace", help="tables of the TRACE paper on ORCA-Maps")
    parser.add_argument("--table", choices=sorted(COLUMNS), default="1")
    parser.add_argument("--data", type=Path, default=Path("data/orca/maps.npz"), help="made by `data orca`")
    parser.add_argument("--split", choices=("val", "test"), default="test", help="settings are tuned on val")
    parser.add_argument(
        "--weights", type=Path, help=f"default: {WEIGHTS.name}; of tables 2 and 8 those without the fold"
    )
    parser.add_argument("--distilled", type=Path, default=DISTILLED, help="weights of what takes four steps")
    parser.add_argument(
        "--guides", nargs="+", choices=sorted(GUIDES), default=list(GUIDES), help="of table 1"
    )
    parser.add_argument("--methods", nargs="+", choices=CHOICES, default=CHOICES, help="of table 1")
    parser.add_argument(
        "--others",
        type=Path,
        nargs="+",
        default=[],
        metavar="WEIGHTS",
        help="ablations and others, for tables 2, 5, 6",
    )
    parser.add_argument(
        "--runs",
        type=int,
        default=1,
        help="of guided rows of table 1, averaged (default %(default)s): figures of one vary by a tenth to a third",
    )
    parser.add_argument("--scenes", type=int, default=None, help="only so many (default: all of the split)")
    parser.add_argument("--quick", action="store_true", help=f"the first {QUICK_SCENES} scenes")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")
    parser.add_argument(
        "--pictures",
        type=Path,
        metavar="FOLDER",
        help="draw figures 4, 12, 13 instead of a table, 5 instead of table 2, and the curve of the samplers",
    )
    closed_loop.add_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate and print; each row is shown as soon as it is known."""
    try:
        if args.runs < 1:
            raise ValueError(f"--runs must be at least 1, not {args.runs}")
        if args.table in closed_loop.TABLES:
            folds = closed_loop.read_folds(args)
            if args.pictures:
                print(closed_loop.picture(folds[0], args.pictures))
                return 0
            rows = closed_loop.TABLES[args.table](folds, args)
            show(args, rows, closed_loop.source(folds, args.split), f"trace-{args.table}")
            return 0
        args.weights = args.weights or WEIGHTS
        trace, facts = load_model(args.weights)
        fast, fast_facts = load_model(args.distilled)
        crowds = Crowds.load(args.data)
        limit = QUICK_SCENES if args.quick else args.scenes
        scenes = TrialScenes(crowds, trace.config, args.split, limit)
        if not len(scenes):
            raise ValueError(
                f"{args.data}: there is no {args.split} scene with anybody who is seen throughout"
            )
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if args.pictures and args.table != "samplers":
        for path in pictures(trace, fast, scenes, args):
            print(path)
        return 0
    area = crowds.source.get("area", 15.0)
    models = (
        f"{trace.config.name}, step {facts.get('step')}; {fast.config.name}, step {fast_facts.get('step')}"
    )
    source = f"{models}; {len(scenes)} {args.split} scenes of {area:g} m"
    section = f"trace-{args.table}" + ("" if area == 15 else f"-{area:g}m")
    rows = show(args, TABLES[args.table](trace, fast, scenes, args), source, section)
    if args.pictures:
        print(draw_samplers(args.pictures, rows))
    return 0


def pictures(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Path]:
    """Figures 4, 12 and 13, one after the other."""
    yield draw_guides(args.pictures, TracePlanner(fast, FAST), scenes)
    others = {model.config.name: model for model, _ in map(load_model, args.others)}
    yield draw_samples(args.pictures, trace, scenes, others)
    yield draw_weights(args.pictures, trace, scenes, (0.0, 1.0, 4.0))


def show(args: argparse.Namespace, found: Iterator[Row], source: str, section: str) -> list[Row]:
    """Print rows as they come, then the whole table, write it if asked, and return its rows."""
    rows = []
    for row in found:
        rows.append(row)
        print(markdown_row(args.table, row), file=sys.stderr, flush=True)
    text = markdown(args.table, rows, source)
    if args.json:
        print(json.dumps({"table": args.table, "model": source, "rows": rows}))
    else:
        print(text)
    if args.write:
        write_section(args.write, section, text)
    return rows


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
    planner: TracePlanner,
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

    def planner(method: str) -> TracePlanner:
        if method == "vae":
            return VaePlanner(load_vae()[0], 20)
        network, sampling = (fast, FAST) if method == "direct" else (trace, slow)
        return TracePlanner(network, sampling, GUIDANCES[method])

    def unguided() -> Iterator[tuple[str, TracePlanner]]:
        runs = UNGUIDED.samples if args.quick else FAST.samples
        yield "unguided", TracePlanner(trace, dataclasses.replace(UNGUIDED, samples=runs))
        yield "direct", TracePlanner(fast, dataclasses.replace(FAST, samples=runs))
        if "vae" in methods:
            yield "vae", VaePlanner(load_vae()[0], runs)

    slowly: dict[str, Row] = {}  # by guide, what fewer steps are measured by

    def row(guide: str, method: str, sampler: str, report: Report) -> Row:
        name = shipped if method == "direct" else config
        labels: Row = {"guide": guide, "method": method, "sampler": sampler, "config": name}
        found = labels | {"error": guide_error(guide, report), **metrics(report), "seconds": report.seconds}
        if method in ("unguided", "direct_slow"):
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


def sampler_name(planner: TracePlanner) -> str:
    """Of a table's row; a VAE has none."""
    return "" if isinstance(planner, VaePlanner) else planner.sampling.name(planner.config)


def nearest_to_truth(scenes: TrialScenes, planner: TracePlanner) -> Row:
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
    planners = [
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
        labels = {"data": closed_loop.trained_on(facts), "drop": facts["drop"]}
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


def markdown_row(table: str, row: Row) -> str:
    """One line of a Markdown table."""
    values = [row.get(key) for key in COLUMNS[table]]
    cells = ["" if v is None else f"{v:.3f}" if isinstance(v, float) else str(v) for v in values]
    return f"| {' | '.join(cells)} |"


def markdown(table: str, rows: list[Row], source: str) -> str:
    """A titled Markdown table."""
    head = COLUMNS[table].values()
    lines = [
        f"### {TITLES[table]}",
        "",
        f"Model: {source}.",
        "",
        f"| {' | '.join(head)} |",
        "|---" * len(head) + "|",
    ]
    return "\n".join([*lines, *(markdown_row(table, row) for row in rows)])


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall eval")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
