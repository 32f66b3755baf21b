"""Launch files: what may stand in one, and the graph it describes."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from ..messages.config import ConfigError, configure, near
from ..messages.graph import ClockSpec, Graph, Input, NodeSpec, Remote, Restart, Security
from .expand import Include, expand

DEFAULT_DEPTH = {"latest": 1, "queue": 10, "reliable": 100}
"""Messages an input keeps where the launch file does not say."""


class PortInput(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One input of a node, written out; `{queue: 10}` is short for `{policy: queue, depth: 10}`."""

    topic: str | None = None
    """The topic's name where it is not the port's."""
    policy: Literal["latest", "queue", "reliable"] | None = None
    depth: int | None = None
    """Messages kept: N of `queue`, the bound of `reliable`."""
    queue: int | None = None
    timeout: float = 5.0
    """Longest wait of a publisher for a `reliable` input [s]."""


class NodeFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One node of a launch file."""

    module: str
    """What `python -m` starts."""
    inputs: list[str] | dict[str, Any] = {}
    """By port, `agents: latest`, `plans: {queue: 10}`, `map: reliable`; a list is all `latest`."""
    outputs: list[str] | dict[str, str] = {}
    """Ports, or topic by port."""
    config: dict[str, Any] = {}
    required: bool = True
    """The graph stops when this node fails."""
    restart: Literal["never", "on-failure", "always"] | Restart = Restart()
    threads: int = 1
    """Threads its numerical libraries may use."""
    env: dict[str, str | int | float] = {}
    lockstep: bool = True
    """In lockstep mode the clock waits for it every tick."""
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL"] = "INFO"
    expose: dict[str, str] = {}
    """TCP address by output, `plans: tcp://0.0.0.0:7000`; needs `security`."""
    watchdog: float | None = None
    """Longest time without a sign of life, after which the process is ended, its stacks are written down, and
    `restart` decides [s]; 0 is never. Default: 10; in lockstep a little less than `clock.timeout`."""


class LaunchFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A launch file; its own keys win over those of the files it includes."""

    name: str | None = None
    """Default: the file's name."""
    description: str = ""
    args: dict[str, Any] = {}
    """Arguments with their defaults; used as `$arg` or `${arg}` in any value."""
    include: list[str | Include] = []
    clock: ClockSpec = ClockSpec()
    seed: int = 0
    duration: float | None = None
    """Simulated time after which the graph ends [s]."""
    topics: dict[str, str] = {}
    """Topics of one's own: name -> `package.module:OBJECT`."""
    nodes: dict[str, Any] = {}
    """By name; `null` takes out an included one."""
    security: Security | None = None
    remotes: dict[str, Remote] = {}
    """Graphs elsewhere whose exposed topics are heard here, by the name they go by here."""


def load_launch(
    path: Path,
    args: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
    duration: float | None = None,
    seed: int | None = None,
    name: str | None = None,
) -> Graph:
    """Read a launch file and what it includes.

    Args:
        path: The file.
        args: Arguments given by the caller; they win over those in the files.
        config: Configuration by `node.key` (or `node.key.key`); wins over the files'.
        duration: Simulated time instead of the file's [s]; also given to files with an argument `duration`.
        seed: The same for the seed.
        name: Name of the graph instead of the file's.

    Returns:
        The graph as written; `wiring.complete` adds what every graph has.

    Raises:
        ConfigError: says in which file and where, and what would be right.
        FileNotFoundError: no such file.
    """
    declared: dict[str, Any] = {}
    given = {key: value for key, value in (("duration", duration), ("seed", seed)) if value is not None}
    values = expand(path.resolve(), {**(args or {}), **given}, declared) | given
    if unknown := next((name for name in args or {} if name not in declared), None):
        raise ConfigError(f"{path}: no argument {unknown!r}; {near(unknown, declared)}")
    for key, value in (config or {}).items():
        _set_config(values, key, value, path)
    file = configure(LaunchFile, values, str(path))
    if file.duration is not None and not file.duration > 0:
        raise ConfigError(f"{path}: duration: {file.duration:g} s, must be above 0")
    name = name or file.name or path.stem
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise ConfigError(
            f"{path}: name: {name!r} must be letters, digits, '.', '_' or '-': it names a folder"
        )
    return Graph(
        name=name,
        nodes=[_node(name, node, path) for name, node in file.nodes.items()],
        clock=file.clock,
        seed=file.seed,
        duration=file.duration,
        custom_topics=file.topics,
        security=file.security,
        remotes=file.remotes,
    )


def declared_args(path: Path) -> dict[str, Any]:
    """The arguments a launch file takes, those of included files among them, with their defaults.

    Raises:
        ConfigError: see `load_launch`.
    """
    declared: dict[str, Any] = {}
    expand(path.resolve(), {}, declared)
    return declared


def _set_config(values: dict[str, Any], key: str, value: Any, path: Path) -> None:
    """Set `node.key.key` in the values of a file."""
    name, *keys = key.split(".")
    nodes = values.get("nodes") or {}
    if name not in nodes:
        raise ConfigError(f"{path}: --set {key}: no node {name!r}; {near(name, nodes)}")
    place: Any = nodes[name]
    for step in ["config", *keys[:-1]]:
        if place.get(step) is None:
            place[step] = {}
        place = place[step]
        if not isinstance(place, dict):
            raise ConfigError(f"{path}: --set {key}: {step!r} is {place!r}, which has no keys")
    place[keys[-1]] = value


def _node(name: str, values: Any, path: Path) -> NodeSpec:
    where = f"{path}: nodes.{name}"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ConfigError(f"{where}: a node's name is small letters, digits and '_', a letter first")
    file = configure(NodeFile, values, where)
    if file.threads < 1:
        raise ConfigError(f"{where}.threads: {file.threads}, must be at least 1")
    if file.watchdog is not None and file.watchdog < 0:
        raise ConfigError(f"{where}.watchdog: {file.watchdog:g} s, must be above 0, or 0 for none")
    inputs = dict.fromkeys(file.inputs, "latest") if isinstance(file.inputs, list) else file.inputs
    outputs = {port: port for port in file.outputs} if isinstance(file.outputs, list) else file.outputs
    return NodeSpec(
        name=name,
        module=file.module,
        inputs={port: _input(port, value, f"{where}.inputs.{port}") for port, value in inputs.items()},
        outputs=outputs,
        config=file.config,
        required=file.required,
        restart=file.restart if isinstance(file.restart, Restart) else Restart(policy=file.restart),
        threads=file.threads,
        env={key: str(value) for key, value in file.env.items()},
        lockstep=file.lockstep,
        log_level=file.log_level,
        expose=file.expose,
        watchdog=file.watchdog,
    )


def _input(port: str, value: Any, where: str) -> Input:
    wire = configure(PortInput, {"policy": value} if isinstance(value, str) else value, where)
    if wire.queue is not None and (wire.depth is not None or wire.policy not in (None, "queue")):
        raise ConfigError(f"{where}: `queue: {wire.queue}` stands for policy and depth; leave those out")
    policy = "queue" if wire.queue is not None else wire.policy or "latest"
    depth = next((d for d in (wire.queue, wire.depth) if d is not None), DEFAULT_DEPTH[policy])
    if depth < 1 or (policy == "latest" and depth > 1):
        raise ConfigError(f"{where}: depth {depth}; `latest` keeps 1 message, the others 1 or more")
    if not wire.timeout > 0:
        raise ConfigError(f"{where}.timeout: {wire.timeout:g} s, must be above 0")
    return Input(topic=wire.topic or port, policy=policy, depth=depth, timeout=wire.timeout)
