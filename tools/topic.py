"""`footfall topic`: look at topics of a running graph, of a log, or of a graph elsewhere."""

import argparse
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..messages.graph import Graph
    from ..messages.topics import Topic


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `topic` and its verbs."""
    from .observe import add_source_arguments

    parser = subparsers.add_parser("topic", help="topics: list, info, schema, echo, hz, bw, delay, pub")
    verbs = parser.add_subparsers(required=True, dest="verb", metavar="VERB")

    def verb(name: str, text: str, *, topic: bool = True, log: bool = False, remote: bool = False) -> Any:
        sub = verbs.add_parser(name, help=text, description=text)
        if topic:
            sub.add_argument("topic")
        add_source_arguments(sub, log=log, remote=remote)
        sub.add_argument("--json", action="store_true", help="for scripts")
        return sub

    verb("list", "all topics with type, publishers and subscribers", topic=False, log=True)
    verb("info", "type, schema, who publishes and subscribes, measured rate", log=True)
    verb("schema", "the topic's messages as JSON Schema")
    echo = verb("echo", "print messages as they come", log=True, remote=True)
    echo.add_argument("--once", action="store_true", help="one message")
    echo.add_argument("--count", type=int, metavar="N", help="so many messages")
    echo.add_argument("--field", metavar="A.B", help="only this part, e.g. agents.0.objectives")
    echo.add_argument("--full", action="store_true", help="arrays in full")
    echo.add_argument("--timeout", type=float, metavar="S", help="end if nothing comes for so long")
    for name, text in (
        ("hz", "rate of the messages, and how even it is"),
        ("bw", "bytes a second, and size of the messages"),
        ("delay", "time from sending to arriving here"),
    ):
        sub = verb(name, text, remote=name != "delay")
        sub.add_argument("--window", type=float, default=10.0, metavar="S", help="look back so long")
        sub.add_argument("--count", type=int, metavar="N", help="so many reports, one a second")
    sub = verb("pub", "hand a message to all nodes that listen to a topic")
    sub.add_argument("values", help="its fields as YAML or JSON, arrays as lists; - reads them from stdin")
    sub.add_argument("--rate", type=float, metavar="HZ", help="again and again, per second of wall time")
    sub.add_argument(
        "--count", type=int, metavar="N", help="so many times (default: once, with --rate always)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do what the verb says."""
    if args.verb == "echo":
        from .topic_echo import echo

        return echo(args)
    if args.verb in ("hz", "bw", "delay"):
        from .topic_rates import rates

        return rates(args)
    if args.verb == "pub":
        from .topic_pub import pub

        return pub(args)
    if args.verb == "schema":
        return _schema(args)
    if args.log:
        return _log_rows(args)
    return _list(args) if args.verb == "list" else _info(args)


def _schema(args: argparse.Namespace) -> int:
    from ..messages.schema import json_schema
    from ..messages.topics import TOPICS
    from .observe import known_topic

    topics = TOPICS
    if args.graph or args.run_dir:
        topics = _graph_topics(args)[1]
    print(json.dumps(json_schema(known_topic(args.topic, topics).type), indent=2))
    return 0


def _graph_topics(args: argparse.Namespace) -> "tuple[Graph, Mapping[str, Topic]]":
    from ..messages.custom_topics import resolve_topics
    from .observe import graph_of

    graph = graph_of(args)
    return graph, resolve_topics(graph)


def _list(args: argparse.Namespace) -> int:
    from .observe import published

    graph, topics = _graph_topics(args)
    rows = [_facts(graph, topics[name]) for name in published(graph)]
    if args.json:
        print(json.dumps(rows))
        return 0
    lines = [("TOPIC", "TYPE", "PUBLISHERS", "SUBSCRIBERS")]
    lines += [
        (row["topic"], row["type"], _few(row["publishers"]), _few([s["node"] for s in row["subscribers"]]))
        for row in rows
    ]
    _print_table(lines)
    return 0


def _few(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{', '.join(names[:3])} and {len(names) - 3} more"


def _print_table(rows: list[tuple[str, ...]]) -> None:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _facts(graph: "Graph", topic: "Topic[Any]") -> dict[str, Any]:
    """What the graph and the topic table say about a topic."""
    from ..messages.graph import edges
    from ..messages.schema import schema_hash

    subscribers = {}
    for edge in edges(graph):
        if edge.topic == topic.name:
            policy = "reliable (lockstep)" if edge.in_step else edge.input.policy
            subscribers[edge.subscriber, edge.port] = {
                "node": edge.subscriber,
                "port": edge.port,
                "policy": policy if policy != "queue" else f"queue: {edge.input.depth}",
            }
    return {
        "topic": topic.name,
        "type": topic.type.__name__,
        "schema": schema_hash(topic.type).hex(),
        "rate_hz": topic.rate_hz,
        "latched": topic.latched,
        "deterministic": topic.deterministic,
        "publishers": graph.publishers(topic.name),
        "subscribers": list(subscribers.values()),
    }


def _info(args: argparse.Namespace) -> int:
    from time import monotonic

    from .observe import known_topic, observer, published

    graph, topics = _graph_topics(args)
    topic = known_topic(args.topic, topics, published(graph))
    facts = _facts(graph, topic)
    bus = observer(graph, [topic.name])
    try:
        begin = monotonic()
        while monotonic() - begin < 1.5:
            bus.poll(0.1, lambda: False)
        received = {inlet.edge.publisher: inlet.received for inlet in bus.inlets}
        rejected = sum(inlet.rejected for inlet in bus.inlets)
    finally:
        bus.close()
    facts["measured_hz"] = round(sum(received.values()) / 1.5, 1)
    facts["rejected"] = rejected
    if args.json:
        print(json.dumps(facts))
        return 0
    rate = "events" if topic.rate_hz is None else f"{topic.rate_hz:g} Hz of simulated time"
    print(f"topic       {topic.name}\ntype        {facts['type']}, schema {facts['schema']}")
    print(f"            {(topic.type.__doc__ or '').strip().splitlines()[0]}")
    print(f"latched     {'yes' if topic.latched else 'no'}")
    print(f"rate        {rate}; {facts['measured_hz']:g} a second of wall time just now")
    for name in facts["publishers"]:
        print(f"publisher   {name}")
    for one in facts["subscribers"]:
        port = "" if one["port"] == topic.name else f" as {one['port']}"
        print(f"subscriber  {one['node']}{port}: {one['policy']}")
    if rejected:
        print(f"rejected    {rejected} messages")
    return 0


def _log_rows(args: argparse.Namespace) -> int:
    from collections import Counter

    from ..messages.log import LogReader

    reader = LogReader(args.log)
    wanted = None if args.verb == "list" else [args.topic]
    counts: Counter[str] = Counter(logged.source for logged in reader.messages(wanted, order="file"))
    rows = {
        channel.source: {
            "topic": channel.topic,
            "publisher": channel.publisher,
            "type": channel.type_name,
            "schema": channel.schema,
            "latched": channel.latched,
            "messages": counts[channel.source],
        }
        for channel in reader.channels
        if wanted is None or channel.topic in wanted
    }
    if args.json:
        print(json.dumps(list(rows.values())))
        return 0
    table = [("TOPIC", "PUBLISHER", "TYPE", "SCHEMA", "MESSAGES")]
    table += [
        (row["topic"], row["publisher"], row["type"], row["schema"], str(row["messages"]))
        for _, row in sorted(rows.items())
    ]
    _print_table(table)
    return 0
