"""`footfall bench`: measurements that stand in the documentation, one verb each."""

import argparse
import signal
from importlib import import_module
from types import FrameType
from typing import NoReturn

BENCHES = {
    "bus": ("bench_bus", "round trips and throughput of the bus beside raw pyzmq and other buses"),
    "env": ("bench_env", "control steps per second of the tracker's worlds beside bare MuJoCo"),
    "crowd": ("bench_crowd", "real-time factor of crowds in physics, by how many walk"),
    "planner": ("bench_planner", "how long TRACE plans, beside the paper's sampler, and what speed costs"),
    "kill": ("bench_kill", "SIGKILL every process of a graph in turn; what ends, comes back, is left"),
    "soak": ("bench_soak", "memory of every process over half an hour, and what was lost on the way"),
    "fuzz": ("fuzz", "broken frames of every message type against the receiving end"),
    "viewer": ("bench_viewer", "what the window costs a running crowd, and how soon a click shows in a plan"),
}
"""By verb: the module in tools/ that has `add_arguments` and `run`, and one line about it."""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `bench` and its verbs; a bench's module is imported when it is run."""
    parser = subparsers.add_parser("bench", help=f"measure: {', '.join(BENCHES)}")
    verbs = parser.add_subparsers(required=True, dest="bench", metavar="BENCH")
    for name, (module, text) in BENCHES.items():
        import_module(f"{__package__}.{module}").add_arguments(
            verbs.add_parser(name, help=text, description=text)
        )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run one bench; SIGTERM ends it as Ctrl-C does, with whatever it has launched."""
    signal.signal(signal.SIGTERM, _end)
    return import_module(f"{__package__}.{BENCHES[args.bench][0]}").run(args)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)
