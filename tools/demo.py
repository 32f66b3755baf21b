"""`footfall demo`: twenty pedestrians at a street corner, recorded and drawn."""

import argparse
import sys
from pathlib import Path

SECONDS = 20.0
PEDESTRIANS = 20


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `demo` to the command line."""
    parser = subparsers.add_parser(
        "demo",
        help="a street corner: launch, record, draw",
        description=f"Simulate {PEDESTRIANS} pedestrians at a street corner for {SECONDS:g} s, record every"
        " message and draw where they walked; the last line is the picture's path.",
    )
    parser.add_argument("--out", type=Path, default=Path("runs"), metavar="DIR", help="default: ./runs")
    parser.add_argument("--seed", type=int, default=0, metavar="N")


def run(args: argparse.Namespace) -> int:
    """Launch, record, draw."""
    from ..launch.console import Console
    from ..launch.find import find_launch
    from ..launch.launch_file import load_launch
    from ..launch.prepare import prepare
    from ..launch.runner import Runner
    from .launch import report

    log = args.out / "crossing.mcap"
    target = find_launch("crossing")
    graph = load_launch(target.path, {"count": PEDESTRIANS}, duration=SECONDS, seed=args.seed)
    graph, topics = prepare(graph, record=log)
    summary = Runner(graph, topics, Console(), log=log).run()
    if (code := report(summary, as_json=False)) != 0:
        return code

    from .log_plot import plot

    print("drawing ...", file=sys.stderr)
    print(plot(log, log.with_suffix(".png")))
    return 0
