"""What makes an MCAP file a log of ours: names, channels, and the error all of them share."""

from dataclasses import dataclass
from typing import Any

import msgspec

PROFILE = "footfall"
"""MCAP profile of every log."""
MESSAGE_ENCODING = "msgpack"
SCHEMA_ENCODING = "jsonschema"
GRAPH_FILE = "graph.json"
"""Attachment that holds the graph the log was recorded from."""
RUN = "run"
"""Metadata record: format, graph name, seed, when it was recorded."""
VERSIONS = "versions"
"""Metadata record: releases of the packages that took part."""
REPEATED = "repeated"
"""Metadata record of a split: sequence number by `topic@publisher` of latched messages carried over."""
FORMAT = "1"
"""Version of the conventions in `docs/logs.md`."""


class LogError(ValueError):
    """A log that cannot be read or written as asked: says which file, what is wrong, what would be right."""


@dataclass(frozen=True, slots=True)
class LogChannel:
    """One life of one publisher on one topic: an MCAP channel."""

    id: int
    topic: str
    publisher: str
    life: int
    """How often the publisher had been restarted: the upper 32 bits of its sequence numbers."""
    schema: str
    """Schema hash of the message type, hexadecimal."""
    type_name: str
    json_schema: dict[str, Any]
    latched: bool
    deterministic: bool

    @property
    def source(self) -> str:
        """`topic@publisher`."""
        return f"{self.topic}@{self.publisher}"


class RunFacts(msgspec.Struct, frozen=True):
    """What a log says about the run it comes from."""

    graph: str = ""
    seed: int = 0
    recorded: str = ""
    """When recording began: ISO 8601, UTC."""
    format: str = FORMAT
