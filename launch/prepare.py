"""From a graph as written to one that can be run: mode, recorder, common ports, checks."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from ..messages.config import ConfigError
from ..messages.custom_topics import resolve_topics
from ..messages.graph import Graph
from ..messages.topics import Topic
from .check import check
from .viewing import with_viewer
from .wiring import complete, with_recorder

_MCAP_MAGIC = b"\x89MCAP"


def prepare(
    graph: Graph,
    mode: str | None = None,
    rate: float | None = None,
    record: Path | None = None,
    view: Mapping[str, Any] | None = None,
) -> tuple[Graph, dict[str, Topic]]:
    """Complete and check a graph.

    Args:
        graph: As a launch file gives it.
        mode: How time passes, instead of the file's.
        rate: Simulated per wall time, instead of the file's.
        record: Where to record to.
        view: Configuration of a viewer to add; None for no viewer.

    Returns:
        The graph, and its topics by name.

    Raises:
        ConfigError: it cannot work.
    """
    if os.getcwd() not in sys.path:  # where `python -m` looks for modules of one's own
        sys.path.append(os.getcwd())
    if rate is not None and not rate > 0:
        raise ConfigError(f"--rate {rate:g}: must be above 0")
    changes = {key: value for key, value in (("mode", mode), ("rate", rate)) if value is not None}
    graph = msgspec.structs.replace(graph, clock=msgspec.structs.replace(graph.clock, **changes))
    topics = resolve_topics(graph)
    graph = complete(graph)
    check(graph, topics)
    if view is not None:
        graph = with_viewer(graph, view)
        check(graph, topics)
    if record:
        graph = with_recorder(graph, {"path": str(_free_log(record)), "overwrite": True}, topics)
        check(graph, topics)
    return graph, topics


def _free_log(path: Path) -> Path:
    """A log may replace an older log, but nothing else."""
    path = path.absolute()
    if path.is_dir():
        raise ConfigError(f"--record {path}: is a directory; name a file in it")
    if path.exists() and path.stat().st_size:
        with path.open("rb") as file:
            if file.read(len(_MCAP_MAGIC)) != _MCAP_MAGIC:
                raise ConfigError(f"--record {path}: exists and is not a log; choose another name")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
