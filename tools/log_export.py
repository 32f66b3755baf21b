"""`footfall log export`: topics of a log as CSV, npz or JSON lines, for tools that know nothing of logs."""

import argparse
import csv
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..messages.agents import STATE_COLUMNS, AgentStates
from ..messages.codec import plain
from ..messages.config import ConfigError
from ..messages.log import Logged, LogReader

FORMATS = ("csv", "npz", "jsonl")
MAX_COLUMNS = 400
"""A CSV wider than this is refused: arrays belong into npz."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command line takes."""
    parser.add_argument("log", type=Path, help="recorded log (.mcap)")
    parser.add_argument("--topics", metavar="TOPIC,...", help="only these (default: all)")
    parser.add_argument("--format", choices=FORMATS, help="default: by the output's suffix, else csv")
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        required=True,
        help="folder for one file a topic; or, for one topic, a file, or - for the screen",
    )
    parser.add_argument("--json", action="store_true", help="print what was written as one JSON object")


def run(args: argparse.Namespace) -> int:
    """Export topics."""
    reader = LogReader(args.log)
    topics = [name for name in args.topics.split(",") if name] if args.topics else reader.topics
    reader.check_topics(topics)
    suffix = Path(args.output).suffix[1:]
    format = args.format or (suffix if suffix in FORMATS else "csv")
    written = {}
    for topic in topics:
        items = reader.messages([topic])
        if args.output == "-":
            if len(topics) > 1 or format == "npz":
                raise ConfigError("-o -: the screen takes one topic, as csv or jsonl")
            export(items, topic, format, sys.stdout)
            continue
        path = Path(args.output) if suffix and len(topics) == 1 else Path(args.output) / f"{topic}.{format}"
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            written[topic] = {"path": str(path), "rows": _export_file(items, topic, format, path)}
        except ConfigError as error:
            if args.topics:
                raise
            print(f"left out: {error}", file=sys.stderr)
    if args.json:
        print(json.dumps(written))
    else:
        for row in written.values():
            print(f"{row['path']}: {row['rows']} rows")
    return 0


def _export_file(items: Iterable[Logged[Any]], topic: str, format: str, path: Path) -> int:
    """Write a file, whole or not at all; returns the number of rows."""
    if path.exists() and not path.is_file():  # a pipe, or a device
        return _write(items, topic, format, path)
    part = path.with_name(f"{path.name}.part")
    try:
        rows = _write(items, topic, format, part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return rows


def _write(items: Iterable[Logged[Any]], topic: str, format: str, path: Path) -> int:
    if format == "npz":
        columns = to_arrays(items)
        with path.open("wb") as file:
            np.savez_compressed(file, **columns)  # type: ignore[arg-type]
        return len(columns["stamp_ns"])
    with path.open("w", newline="") as file:
        return export(items, topic, format, file)


def export(items: Iterable[Logged[Any]], topic: str, format: str, file: IO[str]) -> int:
    """Write messages as text; returns the number of rows.

    Raises:
        ConfigError: a message is too wide for CSV.
    """
    if format == "jsonl":
        return _write_lines(items, file)
    writer = None
    count = 0
    for item in items:
        for row in csv_rows(item):
            if len(row) > MAX_COLUMNS:
                raise ConfigError(f"{topic}: {len(row)} columns are too many for CSV; use --format npz")
            if writer is None:
                writer = csv.DictWriter(file, list(row), restval="")
                writer.writeheader()
            if not row.keys() <= {*writer.fieldnames}:
                raise ConfigError(f"{topic}: its arrays change in shape; use --format npz or jsonl")
            writer.writerow(row)
            count += 1
    return count


def csv_rows(item: Logged[Any]) -> Iterator[dict[str, Any]]:
    """A message as flat rows: one for each element of its arrays' first axis where they share one.

    `agents` gives one row a pedestrian with its present state, the columns named.
    """
    head = {"time": item.stamp_ns * 1e-9, "publisher": item.publisher, "sequence": item.sequence}
    message = item.message
    if isinstance(message, AgentStates):
        for id, group, state in zip(message.ids, message.groups, message.now, strict=True):
            yield (
                head
                | {"id": int(id), "group": int(group)}
                | dict(zip(STATE_COLUMNS, state.tolist(), strict=True))
            )
        return
    fields = plain(message)
    arrays = {name: value for name, value in fields.items() if isinstance(value, np.ndarray) and value.ndim}
    lengths = {len(value) for value in arrays.values()}
    for name, value in fields.items():
        if name not in arrays:
            head |= _flat(name, value)
    if len(lengths) != 1:
        yield head | {column: v for name, value in arrays.items() for column, v in _flat(name, value).items()}
        return
    for index in range(lengths.pop()):
        row = dict(head)
        for name, value in arrays.items():
            row |= _flat(name, value[index])
        yield row


def _flat(name: str, value: Any) -> dict[str, Any]:
    """A value as columns: arrays by element, the rest as text."""
    if isinstance(value, (np.ndarray, np.generic)):
        if np.ndim(value) == 0:
            return {name: value.item()}
        return {f"{name}_{'_'.join(map(str, at))}": v.item() for at, v in np.ndenumerate(value)}
    return {name: json.dumps(_jsonable(value)) if isinstance(value, (dict, list, tuple)) else value}


def _write_lines(items: Iterable[Logged[Any]], file: IO[str]) -> int:
    count = 0
    for item in items:
        line = {
            "topic": item.topic,
            "publisher": item.publisher,
            "sequence": item.sequence,
            "stamp_ns": item.stamp_ns,
            "sent_ns": item.sent_ns,
            "message": _jsonable(plain(item.message)),
        }
        file.write(json.dumps(line) + "\n")
        count += 1
    return count


def _jsonable(value: Any) -> Any:
    """Arrays as lists; NaN and infinity, which JSON does not know, as null."""
    if isinstance(value, np.ndarray):
        return _jsonable(value.tolist())
    if isinstance(value, dict):
        return {key: _jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_jsonable(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def to_arrays(items: Iterable[Logged[Any]]) -> dict[str, np.ndarray]:
    """Messages as arrays with one row a message.

    Fields whose arrays differ in length are joined along their first axis, with the lengths beside them in
    `FIELD.lengths` (M,); other values stand as numbers or, where they are not numbers, as JSON text.
    """
    rows = list(items)
    columns: dict[str, np.ndarray] = {
        "stamp_ns": np.array([item.stamp_ns for item in rows], np.int64),
        "sequence": np.array([item.sequence for item in rows], np.int64),
        "publisher": np.array([item.publisher for item in rows], np.str_),
    }
    messages = [plain(item.message) for item in rows]
    for name in dict.fromkeys(name for message in messages for name in message):
        columns |= _column(name, [message.get(name) for message in messages])
    return columns


def _column(name: str, values: list[Any]) -> dict[str, np.ndarray]:
    arrays = [value for value in values if isinstance(value, np.ndarray)]
    if len(arrays) == len(values) and len({value.shape for value in arrays}) == 1:
        return {name: np.stack(arrays)}
    if arrays and len({value.shape[1:] for value in arrays if value.ndim}) == 1:
        lengths = [len(value) if isinstance(value, np.ndarray) else 0 for value in values]
        return {name: np.concatenate(arrays), f"{name}.lengths": np.array(lengths)}
    if all(isinstance(value, (bool, int, float)) for value in values):
        return {name: np.array(values)}
    texts = [value if isinstance(value, str) else json.dumps(_jsonable(value)) for value in values]
    return {name: np.array(texts, np.str_)}
