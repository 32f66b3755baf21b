"""Records every message it subscribes, unabridged, into an MCAP log.

In: whatever the launch file wires to it, `reliable`, so that publishers wait rather than lose.
Out: a log (`docs/logs.md`). When the disk is full it says so, stops writing and lets the graph go on.
"""

import logging
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import monotonic

import msgspec

from ..messages.bus import Inlet
from ..messages.codec import Buffer, Header, MessageError
from ..messages.config import ConfigError, configure
from ..messages.graph import Graph
from ..messages.log import DiskFullError, LogError, LogWriter
from ..messages.log_format import REPEATED
from ..messages.topics import CLOCK, TOPICS, Topic
from .node import NodeConfig
from .process import Process, Stopped, run_process

log = logging.getLogger(__name__)

QUIET = 0.3
"""After a stop, the log is closed when nothing has come for this long [s]."""
FAREWELL = 5.0
"""Longest wait for the last messages of the others [s]."""
_MB = 1_000_000


class Config(NodeConfig, frozen=True):
    """Where and how to record."""

    path: str
    """The log. With splits `run.mcap` becomes `run.000.mcap`, `run.001.mcap`, ..."""
    overwrite: bool = False
    """Replace an existing log instead of refusing."""
    split_size: float | None = None
    """Begin a new file at this size [MB]."""
    split_duration: float | None = None
    """Begin a new file after this simulated time [s]."""
    quota: float | None = None
    """Stop recording when the files together reach this size [MB]."""
    chunk_size: int = 512
    """Size of a chunk before compression [kB]."""
    flush_period: float = 1.0
    """Wall time after which a chunk is written, full or not [s]: the most a killed recorder loses."""
    strict: bool = False
    """End in failure when anything was lost."""


@dataclass(slots=True)
class Tally:
    """What became of the messages of one publisher on one topic."""

    received: int = 0
    written: int = 0
    lost: int = 0
    """Never came (gaps in the sequence numbers), or came and could not be written."""


@dataclass(slots=True)
class _Latched:
    """A message that the next split must begin with."""

    topic: Topic
    publisher: str
    sequence: int
    stamp_ns: int
    sent_ns: int
    record: bytes


class Recorder:
    """Writes what inlets bring; owns the log and its splits.

    Args:
        config: See `Config`.
        graph: The graph that runs; attached to each file.
        topics: Topics by name, built-in and custom.

    Raises:
        LogError: the log exists or cannot be made.
    """

    def __init__(self, config: Config, graph: Graph, topics: Mapping[str, Topic] = TOPICS) -> None:
        self.config = config
        self.full: DiskFullError | None = None
        """Why recording has stopped."""
        self.written: dict[str, int] = {}
        """Messages in the log, by `topic@publisher`."""
        self.unwritten: dict[str, int] = {}
        """Messages that came and are not in the log."""
        self.paths: list[Path] = []
        self.now_ns = 0
        """Simulation time of the last tick seen."""
        self._graph = graph if graph.versions else msgspec.structs.replace(graph, versions=_versions())
        self._topics = topics
        self._latched: dict[str, _Latched] = {}
        self._closed_bytes = 0
        self._split_from_ns: int | None = None
        self._writer = self._open({})

    @property
    def size(self) -> int:
        """Bytes in all files of the log."""
        return self._closed_bytes + self._writer.size

    @property
    def lost(self) -> int:
        """Messages that came and are not in the log."""
        return sum(self.unwritten.values())

    def _open(self, repeated: dict[str, str]) -> LogWriter:
        config, path = self.config, Path(self.config.path)
        if config.split_size or config.split_duration:
            path = path.with_name(f"{path.stem}.{len(self.paths):03d}{path.suffix}")
        quota = None if config.quota is None else int(config.quota * _MB) - self._closed_bytes
        writer = LogWriter(
            path,
            self._graph,
            {REPEATED: repeated} if repeated else {},
            overwrite=config.overwrite,
            chunk_bytes=config.chunk_size << 10,
            flush_period=config.flush_period,
            quota=quota,
        )
        self.paths.append(path)
        return writer

    def take(self, inlets: Iterable[Inlet]) -> None:
        """Write everything that is pending."""
        for inlet in inlets:
            edge, pending = inlet.edge, inlet.pending
            topic = self._topics[edge.topic]
            while pending:
                header, body, frames = pending.popleft()
                try:
                    record = self._record(inlet, header, body, frames)
                except MessageError as error:
                    inlet.reject(error)
                    continue
                self.write(topic, edge.publisher, header, record)

    def _record(self, inlet: Inlet, header: Header, body: Buffer, frames: Sequence[Buffer]) -> bytes:
        """A message as one self-contained record; most are already."""
        codec = inlet.codec
        if header.schema != codec.schema:  # of another release, which the schema in the log is not
            return codec.encode_inline(codec.decode(body, frames, schema=header.schema))
        return codec.encode_inline(codec.decode(body, frames)) if frames else bytes(body)

    def write(self, topic: Topic, publisher: str, header: Header, record: bytes) -> None:
        """Write one message."""
        source = f"{topic.name}@{publisher}"
        if topic.name == CLOCK.name:
            self.now_ns = header.stamp_ns
        item = _Latched(topic, publisher, header.sequence, header.stamp_ns, header.sent_ns, record)
        try:
            if self.full is None:
                self._split_if_due(header.stamp_ns)
                self._put(item)
                self.written[source] = self.written.get(source, 0) + 1
                if topic.latched:
                    self._latched[source] = item
                return
        except DiskFullError as error:
            self._stop(error)
        except LogError as error:
            log.error("%s", error)
        self.unwritten[source] = self.unwritten.get(source, 0) + 1

    def _put(self, item: _Latched) -> None:
        self._writer.write(
            item.topic, item.publisher, item.sequence, item.stamp_ns, item.sent_ns, item.record
        )

    def _split_if_due(self, stamp_ns: int) -> None:
        config, start = self.config, self._split_from_ns
        if start is None:
            self._split_from_ns = stamp_ns
            return
        too_large = config.split_size and self._writer.size >= config.split_size * _MB
        too_long = config.split_duration and stamp_ns - start >= config.split_duration * 1e9
        if not (too_large or too_long):
            return
        self._split_from_ns = stamp_ns
        self._writer.close()
        self._closed_bytes += self._writer.size
        repeated = {source: str(item.sequence) for source, item in self._latched.items()}
        try:
            self._writer = self._open(repeated)
        except LogError as error:  # no room for another file
            self._closed_bytes -= self._writer.size
            raise DiskFullError(str(error), {}) from None
        for item in self._latched.values():
            self._put(item)

    def tick(self) -> None:
        """Write out what has waited long enough; to be called often, also when nothing comes."""
        if self.full is None:
            try:
                self._writer.tick()
            except DiskFullError as error:
                self._stop(error)

    def _stop(self, error: DiskFullError) -> None:
        self.full = error
        log.error("%s", error)
        for source, count in error.given_up.items():
            self.written[source] -= count
            self.unwritten[source] = self.unwritten.get(source, 0) + count

    def close(self) -> None:
        """Finish the log."""
        if self.full is None:
            try:
                self._writer.close()
            except DiskFullError as error:
                self._stop(error)

    def tallies(self, inlets: Iterable[Inlet]) -> dict[str, Tally]:
        """What became of the messages of each inlet, by `topic@publisher`."""
        return {
            inlet.source: Tally(
                inlet.received,
                self.written.get(inlet.source, 0),
                inlet.dropped + inlet.rejected + self.unwritten.get(inlet.source, 0),
            )
            for inlet in sorted(inlets, key=lambda inlet: inlet.source)
        }

    def summary(self, inlets: Iterable[Inlet]) -> list[str]:
        """Lines that say what has been recorded."""
        tallies = self.tallies(inlets)
        rows = [
            f"{source}: {tally.received} received, {tally.written} written, {tally.lost} lost"
            for source, tally in tallies.items()
            if tally.received or tally.lost
        ]
        written, lost = sum(t.written for t in tallies.values()), sum(t.lost for t in tallies.values())
        files = ", ".join(str(path) for path in self.paths)
        return [*rows, f"recorded {written} messages, {lost} lost, {self.size / _MB:.1f} MB: {files}"]


def _versions() -> dict[str, str]:
    packages = ("footfall", "mcap", "msgspec", "numpy", "pyzmq")
    return {"python": platform.python_version()} | {package: version(package) for package in packages}


def record(process: Process) -> None:
    """Record until told to stop.

    Raises:
        ConfigError: the configuration does not fit, or the log exists.
        LogError: `strict`, and something was lost.
    """
    config = configure(Config, process.spec.config, f"{process.name}: config")
    if process.restarts:  # the log of the life before is worth keeping
        path = Path(config.path)
        path = path.with_name(f"{path.stem}.restart{process.restarts}{path.suffix}")
        config = msgspec.structs.replace(config, path=str(path))
    try:
        recorder = Recorder(config, process.graph, process.topics)
    except LogError as error:
        raise ConfigError(str(error)) from None
    bus = process.bus
    try:
        process.ready()
        while True:
            process.wait()
            recorder.take(bus.inlets)
            recorder.tick()
            process.now_ns = recorder.now_ns
            process.facts = {
                "written": sum(recorder.written.values()),
                "megabytes": recorder.size / _MB,
                "lost": recorder.lost,
                "recording": float(recorder.full is None),
            }
            if recorder.full and config.strict:
                raise recorder.full
    except Stopped:  # what is still on its way belongs into the log
        begin = monotonic()
        here = [inlet for inlet in bus.inlets if inlet.edge.publisher not in process.graph.remotes]
        while (
            bus.poll(QUIET, lambda: any(inlet.pending for inlet in here)) and monotonic() - begin < FAREWELL
        ):
            recorder.take(bus.inlets)
        raise
    finally:
        recorder.close()
        for line in recorder.summary(bus.inlets):
            log.info("%s", line)
        lost = sum(tally.lost for tally in recorder.tallies(bus.inlets).values())
        if config.strict and lost:
            raise recorder.full or LogError(f"{config.path}: {lost} messages are not in the log")


def main() -> int:
    """Run as a process of a graph."""
    return run_process(record)


if __name__ == "__main__":
    sys.exit(main())
