"""`footfall eval trace`: the tables of the TRACE paper on our own test scenes, beside the printed figures."""

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from ..models.trace.crowd_file import Crowds
from ..models.trace.evaluation import GUIDES, Report, TrialScenes, evaluate
from ..models.trace.guidance import Guidance
from ..models.trace.network import Trace
from ..models.trace.planner import WEIGHTS, Sampling, TracePlanner
from ..models.trace.weights import load_model
from . import eval_trace_closed_loop as closed_loop

QUICK_SCENES = 20
UNGUIDED = Sampling(solver="dpm", steps=20, samples=1)
METHODS: dict[str, tuple[Sampling, Guidance]] = {
    "filter": (Sampling(solver="dpm", steps=8, samples=20), Guidance(strength=0.0, inner_steps=1)),
    "noisy": (Sampling(solver="ddim", steps=20, samples=20), Guidance(mode="noisy")),
    "clean": (Sampling(solver="ddim", steps=20, samples=20), Guidance(mode="clean")),
    "direct": (Sampling(solver="dpm", steps=8, samples=20), Guidance(mode="direct")),
}
"""Filter: choose among unguided samples. Noisy: eq 5. Clean: eq 6, through the network. Direct: through the
dynamics alone, few steps; what the planner ships with."""

# (guide, method): guidance error, obstacle and agent collisions, EMD of speed, lon. and lat. acceleration
PAPER_TABLE_1 = {
    ("none", "paper: TRACE"): (None, 0.050, 0.132, 0.029, 0.008, 0.009),
    ("obstacle", "paper: filter"): (0.018, 0.018, 0.123, 0.019, 0.011, 0.015),
    ("obstacle", "paper: TRACE"): (0.014, 0.014, 0.124, 0.020, 0.011, 0.017),
    ("agent", "paper: filter"): (0.049, 0.050, 0.049, 0.031, 0.012, 0.013),
    ("agent", "paper: TRACE"): (0.000, 0.058, 0.000, 0.025, 0.010, 0.012),
    ("waypoint", "paper: filter"): (0.333, 0.046, 0.112, 0.044, 0.013, 0.013),
    ("waypoint", "paper: TRACE"): (0.105, 0.048, 0.093, 0.057, 0.013, 0.014),
    ("all", "paper: filter"): (0.527, 0.023, 0.096, 0.025, 0.014, 0.016),
    ("all", "paper: TRACE"): (0.211, 0.021, 0.009, 0.036, 0.007, 0.009),
}
# Method: ADE, FDE, then as above
PAPER_TABLE_5 = {
    "paper: VAE": (0.340, 0.774, 0.062, 0.115, 0.041, 0.038, 0.039),
    "paper: TRACE": (0.318, 0.757, 0.046, 0.110, 0.028, 0.020, 0.020),
}
# w: obstacle and agent collisions, EMD of speed, longitudinal, lateral acceleration
PAPER_TABLE_7 = {
    0.0: (0.051, 0.131, 0.019, 0.012, 0.014),
    0.5: (0.050, 0.132, 0.029, 0.008, 0.009),
    1.0: (0.049, 0.130, 0.040, 0.010, 0.009),
    2.0: (0.051, 0.132, 0.063, 0.017, 0.015),
}
COLLISIONS_AND_EMD = ["obstacle", "agent", "EMD speed", "EMD lon", "EMD lat"]
HEADS = {
    "1": ["guide", "method", "guide error", *COLLISIONS_AND_EMD, "CPU s/scene"],
    "5": ["method", "ADE", "FDE", *COLLISIONS_AND_EMD],
    "7": ["w", "method", *COLLISIONS_AND_EMD],
    **closed_loop.HEADS,
}
TITLES = {
    "1": "Guidance on ORCA-Maps (TRACE, table 1)",
    "5": "No guidance, the sample nearest to the truth of 20 (TRACE, table 5)",
    "7": "Classifier-free sampling without guidance (TRACE, table 7)",
    **closed_loop.TITLES,
}
Row = list[str | float | None]


def add_parser(subparsers) -> None:
    """Add `eval trace` to the command line."""
    parser = subparsers.add_parser("trace", help="tables of the TRACE paper on ORCA-Maps")
    parser.add_argument("--table", choices=sorted(HEADS), default="1")
    parser.add_argument("--data", type=Path, default=Path("data/orca/maps.npz"), help="made by `data orca`")
    parser.add_argument("--weights", type=Path, default=WEIGHTS)
    parser.add_argument(
        "--guides", nargs="+", choices=sorted(GUIDES), default=list(GUIDES), help="of table 1"
    )
    parser.add_argument(
        "--methods", nargs="+", choices=sorted(METHODS), default=list(METHODS), help="of table 1"
    )
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SCENES} test scenes instead of all")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")
    closed_loop.add_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate and print; each row is shown as soon as it is known."""
    try:
        trace, facts = load_model(args.weights)
        if args.table in closed_loop.TABLES:
            scenes = closed_loop.read_trials(args, trace.config)
        else:
            limit = QUICK_SCENES if args.quick else None
            scenes = TrialScenes(Crowds.load(args.data), trace.config, limit=limit)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    rows = []
    for row in TABLES[args.table](trace, scenes, args):
        rows.append(row)
        print(markdown_row(row), file=sys.stderr, flush=True)
    source = f"{trace.config.name}, step {facts.get('step')}, {len(scenes)} scenes"
    if args.json:
        print(json.dumps({"table": args.table, "model": source, "head": HEADS[args.table], "rows": rows}))
    else:
        print(markdown(args.table, rows, source))
    if args.write:
        write_section(args.write, f"trace-{args.table}", markdown(args.table, rows, source))
    return 0


def collisions_and_emd(report: Report) -> Row:
    """The columns that all tables share."""
    return [report.obstacle, report.agent, *report.emd.values()]


def table_1(trace: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Guides by methods."""
    for guide in args.guides:
        for (name, label), figures in PAPER_TABLE_1.items():
            if name == guide:
                yield [guide, label, *figures, None]
        if guide == "none":  # a random sample, three times (app. C.5)
            report = evaluate(TracePlanner(trace, UNGUIDED), scenes, repeats=3, clock=time.process_time)
            yield [guide, "unguided", None, *collisions_and_emd(report), report.seconds]
            continue
        for method in args.methods:
            planner = TracePlanner(trace, *METHODS[method])
            report = evaluate(planner, scenes, GUIDES[guide], clock=time.process_time)
            errors = {"obstacle": report.obstacle, "agent": report.agent}
            error = errors.get(guide, report.waypoint)
            yield [guide, method, error, *collisions_and_emd(report), report.seconds]


def table_5(trace: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """Accuracy of the best of 20 unguided samples, for each sampler."""
    yield from ([name, *figures] for name, figures in PAPER_TABLE_5.items())
    for sampling in (
        Sampling(solver="dpm", steps=8, samples=20),
        Sampling(solver="sde", steps=16, samples=20),
        Sampling(solver="ddpm", samples=20),
    ):
        report = evaluate(TracePlanner(trace, sampling), scenes, choose_best=True)
        steps = trace.config.diffusion_steps if sampling.solver == "ddpm" else sampling.steps
        yield [
            f"{trace.config.name}, {sampling.solver} {steps}",
            report.ade,
            report.fde,
            *collisions_and_emd(report),
        ]


def table_7(trace: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Row]:
    """The weight of classifier-free sampling."""
    for weight, figures in PAPER_TABLE_7.items():
        yield [weight, "paper: TRACE", *figures]
        sampling = dataclasses.replace(UNGUIDED, context_weight=weight)
        report = evaluate(TracePlanner(trace, sampling), scenes)
        yield [weight, trace.config.name, *collisions_and_emd(report)]


TABLES = {"1": table_1, "5": table_5, "7": table_7, **closed_loop.TABLES}


def markdown_row(row: Row) -> str:
    """One line of a Markdown table."""
    cells = ["" if v is None else v if isinstance(v, str) else f"{v:.3f}" for v in row]
    return f"| {' | '.join(cells)} |"


def markdown(table: str, rows: list[Row], source: str) -> str:
    """A titled Markdown table."""
    head = HEADS[table]
    lines = [
        f"### {TITLES[table]}",
        "",
        f"Model: {source}.",
        "",
        markdown_row(list(head)),
        "|---" * len(head) + "|",
    ]
    return "\n".join([*lines, *map(markdown_row, rows)])


def write_section(path: Path, name: str, text: str) -> None:
    """Replace the section between this name's markers, or append it."""
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    before = path.read_text() if path.is_file() else "# Results\n"
    section = f"{begin}\n{text}\n{end}"
    if begin in before and end in before:
        head, rest = before.split(begin, 1)
        tail = rest.split(end, 1)[1]
        path.write_text(head + section + tail)
    else:
        path.write_text(f"{before.rstrip()}\n\n{section}\n")


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall eval")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
