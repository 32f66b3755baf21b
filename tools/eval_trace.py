"""`footfall eval trace`: the tables of the TRACE paper on our own test scenes, beside the printed figures."""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from ..models.trace.crowd_file import Crowds
from ..models.trace.evaluation import GUIDES, TrialScenes
from ..models.trace.network import Trace
from ..models.trace.planner import DISTILLED, WEIGHTS, TracePlanner
from ..models.trace.weights import load_model
from . import eval_trace_closed_loop as closed_loop
from . import eval_trace_open_loop as open_loop
from .eval_trace_paper import Row
from .eval_trace_pictures import draw_guides, draw_samplers, draw_samples, draw_weights
from .results import write_section

QUICK_SCENES = 4
COLUMNS = {**open_loop.COLUMNS, **closed_loop.COLUMNS}
"""Of each table: key in JSON and heading in Markdown."""
TITLES = {**open_loop.TITLES, **closed_loop.TITLES}


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
    parser.add_argument(
        "--methods", nargs="+", choices=open_loop.METHODS, default=open_loop.METHODS, help="of table 1"
    )
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
    rows = show(args, open_loop.TABLES[args.table](trace, fast, scenes, args), source, section)
    if args.pictures:
        print(draw_samplers(args.pictures, rows))
    return 0


def pictures(trace: Trace, fast: Trace, scenes: TrialScenes, args: argparse.Namespace) -> Iterator[Path]:
    """Figures 4, 12 and 13, one after the other."""
    yield draw_guides(args.pictures, TracePlanner(fast, open_loop.FAST), scenes)
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
