"""Adds a viewer to a graph: where its window is, and the token of one that is open to others."""

import os
import re
import secrets
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..messages.config import ConfigError
from ..messages.graph import Graph, Input, NodeSpec
from ..messages.shown_topics import SHOWN
from ..messages.topics import DIAGNOSTICS, LOG, PARAMETERS
from .wiring import with_node

VIEWER = "viewer"
PORT = 8080
WATCHDOG = 60.0
"""Longest time without a sign of life: opening a window takes a while, and nobody waits for it [s]."""
LOOPBACK = ("127.0.0.1", "::1", "localhost")


def with_viewer(graph: Graph, config: Mapping[str, Any]) -> Graph:
    """The graph with a viewer of what it publishes; a slow one loses messages and delays nobody.

    Args:
        graph: The graph to look at.
        config: Configuration of `footfall.nodes.viewer`.
    """
    published = {topic for node in graph.nodes for topic in node.outputs.values()}
    published |= {DIAGNOSTICS.name, LOG.name, PARAMETERS.name}
    wires = {
        shown.topic.name: Input(shown.topic.name, "queue", shown.queue)
        if shown.queue
        else Input(shown.topic.name)
        for shown in SHOWN
    }
    viewer = NodeSpec(
        VIEWER,
        "footfall.nodes.viewer",
        {name: wire for name, wire in wires.items() if wire.topic in published},
        config=dict(config),
        required=False,
        lockstep=False,
        watchdog=WATCHDOG,
    )
    return with_node(graph, viewer)


def viewer_config(address: str) -> tuple[dict[str, Any], str]:
    """Configuration of a viewer at HOST:PORT, and what to open in a browser.

    Without an address the first free port from 8080 on is taken, with port 0 any.

    Raises:
        ConfigError: not an address, or one that is taken.
    """
    host, port = _parse(address) if address else ("127.0.0.1", _free_port())
    port = _free(host, port)
    shown = f"[{host}]" if ":" in host else host
    if host in LOOPBACK:
        return {"host": host, "port": port}, f"http://{shown}:{port}"
    path, token = own_token()
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else shown
    return {"host": host, "port": port, "token_file": str(path)}, f"http://{shown}:{port}/?token={token}"


def own_token() -> tuple[Path, str]:
    """This user's token for viewers open to others, and the file it is kept in; made when missing."""
    home = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    path = home / "footfall" / "viewer-token"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as file:
            file.write(secrets.token_hex(16) + "\n")
    return path, path.read_text().strip()


def _parse(address: str) -> tuple[str, int]:
    match = re.fullmatch(r"(?:(\[[0-9a-fA-F:]+\]|[^:\s]+):)?(\d+)", address)
    if not match or int(match[2]) > 65535:
        raise ConfigError(f"--view {address}: must be PORT or HOST:PORT, e.g. 8080 or 0.0.0.0:8080")
    return (match[1] or "127.0.0.1").strip("[]"), int(match[2])


def _free_port() -> int:
    for port in (*range(PORT, PORT + 20), 0):
        try:
            with socket.create_server(("127.0.0.1", port)) as server:
                return server.getsockname()[1]
        except OSError:
            continue
    raise ConfigError("--view: no free port")


def _free(host: str, port: int) -> int:
    """The port itself, or any free one for 0."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.create_server((host, port), family=family) as server:
            return server.getsockname()[1]
    except OSError as error:
        raise ConfigError(f"--view {host}:{port}: cannot listen there: {error.strerror}") from None
