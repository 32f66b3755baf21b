"""`footfall replay`: play a log into a graph in the place of the nodes that were recorded."""

import argparse
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..launch.summary import Summary
    from ..messages.graph import Graph
    from ..messages.log import LogReader


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `replay` to the command line."""
    parser = subparsers.add_parser(
        "replay",
        help="play a log into a graph",
        description="Play a log in the place of the nodes that were recorded; the other nodes run live. "
        "Ends by comparing what was sent with what arrived.",
    )
    parser.add_argument("log", type=Path, help="recorded log (.mcap)")
    parser.add_argument(
        "--launch", metavar="NAME", help="launch file or scene (default: the graph in the log)"
    )
    parser.add_argument(
        "--replace", metavar="NODE,...", type=_names, help="nodes to play (default: all recorded)"
    )
    parser.add_argument("--topics", metavar="TOPIC,...", type=_names, help="play only these")
    parser.add_argument("--exclude", metavar="TOPIC,...", type=_names, default=[], help="do not play these")
    parser.add_argument("--remap", metavar="A:=B", action="append", default=[], help="play topic A as B")
    parser.add_argument("--rate", type=_rate, default=1.0, metavar="X|max", help="simulated per wall time")
    parser.add_argument("--start", type=float, metavar="S", help="simulation time to start from [s]")
    parser.add_argument("--duration", type=float, metavar="S", help="simulated time to play [s]")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until stopped")
    parser.add_argument("--pause", action="store_true", help="stop after the first tick")
    parser.add_argument("--record", type=Path, metavar="FILE", help="record the replay")
    parser.add_argument("--run-dir", type=Path, metavar="DIR", help="where sockets and logs go")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object, last line")
    parser.add_argument("--quiet", action="store_true", help="show errors only")


def _names(text: str) -> list[str]:
    return [name for name in text.split(",") if name]


def _rate(text: str) -> float | None:
    """A factor, or None for `max`."""
    if text == "max":
        return None
    rate = float(text)
    if not rate > 0:
        raise ValueError
    return rate


def run(args: argparse.Namespace) -> int:
    """Replay; returns 0, 1 (a node failed, or messages were lost), 2 (the user's input) or 128 + signal."""
    from ..launch.console import Console
    from ..launch.prepare import prepare
    from ..launch.runner import Runner
    from ..messages.log import LogReader

    reader = LogReader(args.log)
    with TemporaryDirectory(prefix="footfall-replay-") as folder:
        report = Path(folder) / "report.json"
        graph = replay_graph(reader, args, report)
        graph, topics = prepare(graph, record=args.record)
        summary = Runner(graph, topics, Console(args.quiet), args.run_dir, args.record).run()
        played = json.loads(report.read_text()) if report.exists() else None
    return _conclude(summary, played, args)


def replay_graph(reader: "LogReader", args: argparse.Namespace, report: Path) -> "Graph":
    """The graph that plays a log.

    Raises:
        ConfigError: the log, the graph and the options do not fit together.
    """
    import msgspec

    from ..launch.substitute import substitute
    from ..messages.config import ConfigError
    from ..messages.graph import ClockSpec

    reader.check_topics([*(args.topics or ()), *args.exclude])
    recorded: dict[str, set[str]] = {}
    for channel in reader.channels:
        recorded.setdefault(channel.publisher, set()).add(channel.topic)
    if not recorded:
        raise ConfigError(f"{reader.path}: holds no messages")
    graph = _base_graph(reader, args.launch)
    if args.launch is None and args.replace is None:  # the whole log is played, nobody is live
        graph = msgspec.structs.replace(graph, nodes=[])
    config = {
        "path": str(args.log.absolute()),
        "start": args.start,
        "duration": args.duration,
        "loop": args.loop,
        "paused": args.pause,
        "report": str(report),
    }
    config = {key: value for key, value in config.items() if value not in (None, False)}
    remap = dict(_remapping(text) for text in args.remap)
    graph = substitute(graph, recorded, config, args.replace, args.topics, args.exclude, remap)
    mode = "lockstep" if args.rate is None or graph.clock.mode == "lockstep" else "realtime"
    clock = ClockSpec(mode, args.rate, graph.clock.timeout)
    return msgspec.structs.replace(graph, clock=clock)


def _base_graph(reader: "LogReader", launch: str | None) -> "Graph":
    from ..messages.graph import Graph

    if launch is not None:
        from ..launch.find import find_launch
        from ..launch.launch_file import load_launch

        target = find_launch(launch)
        return load_launch(target.path, target.args, name=target.name)
    return reader.graph or Graph("log", [])


def _remapping(text: str) -> tuple[str, str]:
    from ..messages.config import ConfigError

    old, sign, new = text.partition(":=")
    if not (sign and old and new):
        raise ConfigError(f"--remap {text}: must be OLD:=NEW")
    return old, new


def _conclude(summary: "Summary", played: dict[str, Any] | None, args: argparse.Namespace) -> int:
    """Print what was played and whether it arrived; returns the exit code."""
    failure = summary.first_failure
    lost = lost_messages(played) if played else {}
    facts = {
        "log": str(args.log),
        "sim_seconds": played["sim_seconds"] if played else 0.0,
        "wall_seconds": played["wall_seconds"] if played else 0.0,
        "real_time_factor": played["real_time_factor"] if played else 0.0,
        "sent": played["sent"] if played else {},
        "delivered": played["delivered"] if played else {},
        "unreadable": played["unreadable"] if played else 0,
        "lost": lost,
        "lossless": played is not None and not lost,
        "recorded": summary.log,
        "ended": summary.ended,
        "first_failure": failure.text if failure else None,
        "run_dir": summary.run_dir,
    }
    print(json.dumps(facts) if args.json else _text(facts), flush=True)
    if failure is not None:
        print(f"footfall: error: {failure.text}; logs are in {summary.run_dir}/log", file=sys.stderr)
        return 2 if failure.usage else 1
    if summary.signal:
        return 128 + summary.signal
    return 1 if lost and args.rate is None else 0


def lost_messages(played: dict[str, Any]) -> dict[str, dict[str, int]]:
    """How many messages have not arrived, by subscriber and topic; only where there are any."""
    short = {
        subscriber: {
            topic: played["sent"][topic] - n for topic, n in row.items() if played["sent"][topic] != n
        }
        for subscriber, row in played["delivered"].items()
    }
    return {subscriber: row for subscriber, row in short.items() if row}


def _text(facts: dict[str, Any]) -> str:
    if not facts["sent"]:
        return f"nothing was compared: {facts['ended']}"
    width = max(map(len, facts["sent"]))
    rows = []
    for topic, sent in sorted(facts["sent"].items()):
        counts = [f"{name} {row[topic]}" for name, row in facts["delivered"].items() if topic in row]
        rows.append(f"{topic:<{width}} {sent:>7} sent; delivered to {', '.join(counts) or 'nobody'}")
    verdict = "everything has arrived" if facts["lossless"] else f"not arrived: {facts['lost']}"
    speed = (
        f"{facts['sim_seconds']:.1f} s played in {facts['wall_seconds']:.1f} s "
        f"({facts['real_time_factor']:.1f}x real time)"
    )
    return "\n".join([*rows, f"{speed}; {verdict}"])
