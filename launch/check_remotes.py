"""What must be right about graphs elsewhere, before any process is started."""

import re
from collections.abc import Mapping

from ..messages.bus import PortError
from ..messages.config import ConfigError, near
from ..messages.graph import LAUNCHER, OUTSIDE, Graph
from ..messages.topics import Topic


def tcp_address(where: str, address: str) -> tuple[str, int]:
    """Host and port of `tcp://HOST:PORT`.

    Raises:
        ConfigError: it is not of that form.
    """
    match = re.fullmatch(r"tcp://([^:/\s]+|\[[0-9a-fA-F:]+\]):(\d+)", address)
    if not match or not 0 < int(match[2]) < 65536:
        raise ConfigError(f"{where}: {address!r} must be tcp://HOST:PORT, HOST an address or `*`")
    return match[1].strip("[]"), int(match[2])


def check_remotes(graph: Graph, topics: Mapping[str, Topic]) -> None:
    """Every remote has a name of its own, topics we know, addresses and keys that work.

    Raises:
        ConfigError: one sentence that names the remote and the topic, and what would be right.
    """
    from ..messages.secure import load_public, load_secret

    for name, remote in graph.remotes.items():
        where = f"{graph.name}: remote {name}"
        if name in {LAUNCHER, OUTSIDE, *(node.name for node in graph.nodes)}:
            raise ConfigError(f"{where}: {name!r} is the name of a node here; choose another")
        for topic, address in remote.topics.items():
            if topic not in topics:
                raise ConfigError(f"{where}: no topic {topic!r}; {near(topic, topics)}")
            host, _ = tcp_address(f"{where}: {topic!r}", address)
            if host in ("*", "0.0.0.0"):
                raise ConfigError(f"{where}: {topic!r}: {address!r} names no machine to connect to")
        if graph.security is None:
            raise ConfigError(
                f"{where}: needs keys: set `security: {{secret_key_file: ...}}` (`footfall keys new` makes them)"
            )
        try:
            load_secret(graph.security.secret_key_file)
            load_public(remote.server_key_file)
        except PortError as error:
            raise ConfigError(f"{where}: {error}") from None
    for node in graph.nodes:
        for port, wire in node.inputs.items():
            if wire.policy == "reliable" and graph.remote_publishers(wire.topic):
                raise ConfigError(
                    f"{graph.name}: node {node.name}: input {port!r} comes from elsewhere, where nobody waits for"
                    " it; say `queue: N` instead of `reliable`"
                )
