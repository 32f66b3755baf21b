"""`footfall launch`: start a graph, watch it, say what it came to."""

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..launch.summary import Summary


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `launch` to the command line."""
    parser = subparsers.add_parser(
        "launch",
        help="start a graph from a launch file or a scene",
        description="Start the nodes of a launch file and stay until they end. Ctrl-C stops everything.",
    )
    parser.add_argument("name", nargs="?", help="launch file, shipped launch (crossing, plaza, ...) or scene")
    parser.add_argument("--duration", type=float, metavar="S", help="simulated time [s]")
    parser.add_argument("--record", type=Path, metavar="FILE", help="record every topic to an MCAP log")
    parser.add_argument(
        "--view",
        nargs="?",
        const="",
        metavar="[HOST:]PORT",
        help="show the run in a browser and steer it there (default port 8080 on this machine only)",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random")
    parser.add_argument("--mode", choices=("realtime", "free", "lockstep"), help="how time passes")
    parser.add_argument("--rate", type=float, metavar="X", help="simulated time per wall time")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="an argument of the launch file, or node.key of a node's configuration; repeatable",
    )
    parser.add_argument("--run-dir", type=Path, metavar="DIR", help="where sockets and logs go")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, last line")
    parser.add_argument("--quiet", action="store_true", help="show errors only")
    parser.add_argument("--schema", action="store_true", help="print the JSON Schema of launch files")


def run(args: argparse.Namespace) -> int:
    """Launch, and return 0, 1 (a node failed), 2 (the user's input) or 128 + signal."""
    if args.schema:
        from ..launch.launch_schema import launch_schema

        print(json.dumps(launch_schema(), indent=2))
        return 0

    from ..launch.console import Console
    from ..launch.find import find_launch, shipped_launches
    from ..launch.launch_file import load_launch
    from ..launch.prepare import prepare
    from ..launch.runner import Runner
    from ..launch.viewing import viewer_config
    from ..messages.config import ConfigError

    if args.name is None:
        raise ConfigError(f"which launch file or scene? shipped are {', '.join(shipped_launches())}")
    target = find_launch(args.name)
    arguments, config = parse_settings(args.set)
    graph = load_launch(target.path, target.args | arguments, config, args.duration, args.seed, target.name)
    view, rate = None, args.rate
    if args.view is not None:
        view, url = viewer_config(args.view)
        if rate is None and graph.clock.rate is None:
            rate = 1.0  # as fast as it goes is too fast to watch
        print(f"open {url}", flush=True)
    graph, topics = prepare(graph, args.mode, rate, args.record, view)
    summary = Runner(graph, topics, Console(args.quiet), args.run_dir, args.record).run()
    return report(summary, args.json)


def parse_settings(settings: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Take `--set KEY=VALUE` apart: arguments of the launch file, and configuration by `node.key`.

    Raises:
        ConfigError: it is not of that form.
    """
    import yaml

    from ..messages.config import ConfigError

    arguments: dict[str, Any] = {}
    config: dict[str, Any] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key or "" in key.split("."):
            raise ConfigError(f"--set {setting}: must be ARGUMENT=VALUE or NODE.KEY=VALUE")
        try:
            value = yaml.safe_load(text)
        except (yaml.YAMLError, ValueError, RecursionError):
            raise ConfigError(f"--set {setting}: the value is not valid YAML; put it in quotes") from None
        (config if "." in key else arguments)[key] = value
    return arguments, config


def report(summary: "Summary", as_json: bool) -> int:
    """Print what a run came to; returns the exit code."""
    import msgspec

    from ..launch.summary import summary_text

    failure = summary.first_failure
    if as_json:
        print(msgspec.json.encode(summary).decode(), flush=True)
    elif failure is None or summary.sim_seconds:
        print(summary_text(summary), flush=True)
    if failure is not None:
        logs = "" if failure.usage else f"; logs are in {summary.run_dir}/log"
        print(f"footfall: error: {failure.text}{logs}", file=sys.stderr)
        return 2 if failure.usage else 1
    if summary.signal is None:
        return 0
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C pressed once more than needed changes nothing
    return 128 + summary.signal
