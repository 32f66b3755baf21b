"""`footfall bench fuzz`: broken frames of every message type against the receiving end of the bus.

Whatever comes, an inlet either hands out a valid message or counts a `MessageError` that names the topic.
"""

import argparse
import json
import re
import resource
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import msgpack
import numpy as np

from ..messages.bus import Inlet
from ..messages.codec import Buffer, Codec, Header, MessageError, validate
from ..messages.graph import Edge, Input
from ..messages.samples import sample
from ..messages.topics import TOPICS
from .results import table, write_section

PROGRESS_FRAMES = 10_000
"""Frames between two reports of progress."""

Parts = list[bytes]
Mutation = Callable[[Parts, np.random.Generator], Parts]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bench."""
    parser.add_argument("--frames", type=int, default=100_000, help="messages to break (default: 100000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the figures into this Markdown file")


def run(args: argparse.Namespace) -> int:
    """Break messages; 1 if anything but a counted rejection came of it."""
    result = fuzz(args.frames, args.seed, _progress if sys.stderr.isatty() else None)
    if args.write:
        words = f"footfall bench fuzz --frames {args.frames} --seed {args.seed}"
        write_section(args.write, "fuzz", f"### Broken frames (`{words}`)\n\n{result.markdown()}")
    if args.json:
        print(json.dumps(result.facts()))
    else:
        for key, value in result.facts().items():
            print(f"{key:22} {value}")
    return 1 if result.crashes else 0


def _progress(done: int, frames: int) -> None:
    end = "\n" if done == frames else ""
    print(f"\r{done} of {frames} frames{end}", end="", file=sys.stderr, flush=True)


@dataclass
class Result:
    """What came of the broken messages."""

    frames: int = 0
    accepted: int = 0
    rejected: int = 0
    crashes: list[str] = field(default_factory=list)
    by_mutation: Counter[str] = field(default_factory=Counter)
    fields: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    memory_growth: int = 0
    """Growth of the peak resident memory [bytes]."""

    def markdown(self) -> str:
        """The figures as a table."""
        rows = [(key, value) for key, value in self.facts().items() if isinstance(value, (int, float))]
        rows += [(f"rejected, {name}", count) for name, count in self.by_mutation.most_common()]
        return table(("", "count"), [(key.replace("_", " "), str(value)) for key, value in rows])

    def facts(self) -> dict[str, object]:
        """For printing."""
        return {
            "frames": self.frames,
            "accepted": self.accepted,
            "rejected": self.rejected,
            "crashes": len(self.crashes),
            "first_crash": self.crashes[0] if self.crashes else None,
            "rejected_by_mutation": dict(self.by_mutation.most_common()),
            "fields_named": len(self.fields),
            "frames_per_second": round(self.frames / max(self.seconds, 1e-9)),
            "memory_growth_mb": round(self.memory_growth / 2**20, 1),
        }


def fuzz(frames: int, seed: int = 0, progress: Callable[[int, int], None] | None = None) -> Result:
    """Break so many messages, all types in turn, and watch what an inlet makes of them.

    Args:
        frames: How many.
        seed: Of everything random.
        progress: Told now and then how many are done, and of how many.
    """
    rng = np.random.default_rng(seed)
    result = Result()
    targets = [target for topic in TOPICS for target in _targets(topic)]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = perf_counter()
    for index in range(frames):
        topic, codec, parts = targets[index % len(targets)]
        mutation = MUTATIONS[int(rng.integers(len(MUTATIONS)))]
        other = targets[int(rng.integers(len(targets)))][2]
        broken = splice(parts, other, rng) if mutation is None else mutation(list(parts), rng)
        name = "splice" if mutation is None else mutation.__name__
        _feed(topic, codec, broken, name, result)
        if progress and ((index + 1) % PROGRESS_FRAMES == 0 or index + 1 == frames):
            progress(index + 1, frames)
    result.seconds = perf_counter() - begin
    result.memory_growth = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    return result


def _targets(topic: str) -> Iterator[tuple[str, Codec, Parts]]:
    """A small message of the topic, and a large one whose arrays travel in frames."""
    codec = Codec(topic, TOPICS[topic].type)
    for scale in (1, 30):
        body, arrays = codec.encode(sample(TOPICS[topic].type, scale))
        header = Header(5, 1, 1, codec.schema, len(arrays)).pack()
        yield topic, codec, [header + body, *(array.tobytes() for array in arrays)]


def _feed(topic: str, codec: Codec, parts: Parts, mutation: str, result: Result) -> None:
    edge = Edge(topic, "source", "sink", topic, Input(topic, "queue", 10), False, False)
    inlet = Inlet(edge, codec, False)
    buffers: list[Buffer] = list(parts)
    result.frames += 1
    try:
        inlet.put(buffers or [b""])
        for received in inlet.take(None):
            validate(topic, received.message)
            codec.encode(received.message)
            result.accepted += 1
    except Exception as error:  # exactly what must never happen
        result.crashes.append(f"{topic}: {mutation}: {type(error).__name__}: {error}")
        return
    if inlet.rejected:
        result.rejected += inlet.rejected
        result.by_mutation[mutation] += inlet.rejected
    for fault in inlet.faults:
        if not isinstance(fault, MessageError) or fault.topic != topic:
            result.crashes.append(f"{topic}: {mutation}: {fault!r} does not name the topic")
        name = re.match(r"\w*", fault.field)
        result.fields[f"{topic}.{name[0] if name else ''}"] += 1


def flip_bits(parts: Parts, rng: np.random.Generator) -> Parts:
    """Turn one to eight bits of one part, mostly behind the header."""
    which = int(rng.integers(len(parts)))
    data = bytearray(parts[which])
    low = Header.SIZE if which == 0 and rng.random() < 0.9 else 0
    if len(data) > low:
        for at in rng.integers(low, len(data), int(rng.integers(1, 9))):
            data[at] ^= 1 << int(rng.integers(8))
    parts[which] = bytes(data)
    return parts


def truncate(parts: Parts, rng: np.random.Generator) -> Parts:
    """Cut one part short."""
    which = int(rng.integers(len(parts)))
    parts[which] = parts[which][: int(rng.integers(len(parts[which]) + 1))]
    return parts


def edit_header(parts: Parts, rng: np.random.Generator) -> Parts:
    """Put random bytes into the header."""
    data = bytearray(parts[0])
    at = int(rng.integers(Header.SIZE))
    count = min(int(rng.integers(1, 9)), Header.SIZE - at)
    data[at : at + count] = rng.bytes(count)
    return [bytes(data), *parts[1:]]


def drop_or_repeat_parts(parts: Parts, rng: np.random.Generator) -> Parts:
    """Lose an array frame, or send one twice."""
    which = int(rng.integers(len(parts)))
    return parts[:which] + (parts[which:] if rng.random() < 0.5 else []) + parts[which:]


def lie_about_arrays(parts: Parts, rng: np.random.Generator) -> Parts:
    """Change dtype, shape or place of one array, in valid msgpack."""
    body = msgpack.unpackb(parts[0][Header.SIZE :])
    arrays = [(holder, key) for holder, key in _arrays(body)]
    if arrays:
        holder, key = arrays[int(rng.integers(len(arrays)))]
        dtype, shape, where = holder[key]
        lies = [
            ["|O", shape, where],
            ["<f8", shape, where],
            [">f4", shape, where],
            [dtype, [-1, *shape[1:]], where],
            [dtype, [2**31 - 1] * 8, where],
            [dtype, [2**62, 2**62], where],
            [dtype, [0, 2**63 - 1], b""],
            [dtype, [*shape, 1], where],
            [dtype, shape[::-1], where],
            [dtype, [1.5, "x"], where],
            [dtype, [*shape, 2**40, b"x"], where],
            [dtype, [2**40, [None]], where],
            [dtype, [1] * 40, where],
            [dtype, shape, int(rng.integers(-3, 300))],
            [dtype, shape, None],
            [dtype, shape],
            None,
            [{"a": 1}, [[]], {}],
        ]
        holder[key] = lies[int(rng.integers(len(lies)))]
    return [parts[0][: Header.SIZE] + msgpack.packb(body), *parts[1:]]  # type: ignore[operator]


def claim_huge_lengths(parts: Parts, rng: np.random.Generator) -> Parts:
    """Say that gigabytes follow: maps, lists, texts and bytes of 2^32 - 1."""
    bombs = [b"\xdf", b"\xdd", b"\xdb", b"\xc6", b"\xc9"]
    bomb = bombs[int(rng.integers(len(bombs)))] + b"\xff\xff\xff\xff"
    at = int(rng.integers(Header.SIZE, len(parts[0]) + 1))
    return [parts[0][:at] + bomb * int(rng.integers(1, 5)) + parts[0][at:], *parts[1:]]


def nest_deeply(parts: Parts, rng: np.random.Generator) -> Parts:
    """A list in a list in a list."""
    at = int(rng.integers(Header.SIZE, len(parts[0]) + 1))
    return [parts[0][:at] + b"\x91" * int(rng.integers(1, 20_000)) + parts[0][at:], *parts[1:]]


def change_values(parts: Parts, rng: np.random.Generator) -> Parts:
    """Another value, in valid msgpack, in place of one field."""
    body = msgpack.unpackb(parts[0][Header.SIZE :])
    keys = list(body)
    if keys:
        values = [
            None,
            True,
            -1,
            2**63,
            float("nan"),
            float("inf"),
            "x" * 50,
            [],
            {},
            b"\x00",
            [[1, 2]],
            {"a": 1},
        ]
        body[keys[int(rng.integers(len(keys)))]] = values[int(rng.integers(len(values)))]
    return [parts[0][: Header.SIZE] + msgpack.packb(body), *parts[1:]]  # type: ignore[operator]


def splice(parts: Parts, other: Parts, rng: np.random.Generator) -> Parts:
    """Our header with the rest of another message, or two halves."""
    if rng.random() < 0.5:
        return [parts[0][: Header.SIZE] + other[0][Header.SIZE :], *other[1:]]
    at = int(rng.integers(1, len(parts[0]) + 1))
    return [parts[0][:at] + other[0][at:], *parts[1:]]


def random_bytes(parts: Parts, rng: np.random.Generator) -> Parts:
    """Noise behind a good header."""
    return [parts[0][: Header.SIZE] + rng.bytes(int(rng.integers(0, 200))), *parts[1:]]


MUTATIONS: list[Mutation | None] = [
    flip_bits,
    truncate,
    edit_header,
    drop_or_repeat_parts,
    lie_about_arrays,
    claim_huge_lengths,
    nest_deeply,
    change_values,
    random_bytes,
    None,
]
"""None is `splice`, which takes two messages."""


def _arrays(value: Any) -> Iterator[tuple[Any, Any]]:
    """Where the arrays of a plain body stand: container and key."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        if isinstance(item, list) and len(item) == 3 and isinstance(item[0], str) and item[0][:1] in "<|":
            yield value, key
        else:
            yield from _arrays(item)
