"""`footfall steer`: ask something of a running scene, as the viewer's panel does."""

import argparse
import types
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from ..messages.steering import Command


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `steer` to the command line."""
    parser = subparsers.add_parser(
        "steer",
        help="ask something of a running scene",
        description="Send one command to a running scene, e.g. `footfall steer SetWaypoint agent=3 "
        "position=[4,5]`. Without a command: list them.",
    )
    parser.add_argument("command", nargs="?", help="SetWaypoint, SetSpeed, DropObstacle, Push, ...")
    parser.add_argument("values", nargs="*", metavar="KEY=VALUE", help="its fields, values as in YAML")
    parser.add_argument("--graph", metavar="NAME", help="which running graph (default: the only one)")


def run(args: argparse.Namespace) -> int:
    """Send it; an error says why it cannot be sent."""
    from ..launch.running import find_graph
    from ..messages.link import Steer
    from .control import ask

    if args.command is None:
        print("\n".join(usage()))
        return 0
    command = parse(args.command, args.values)
    ask(find_graph(args.graph), Steer(command))
    return 0


def usage() -> list[str]:
    """A line a command: its name and fields, optional ones in brackets."""
    lines = []
    for kind in get_args(_union()):
        count = len(kind.__struct_fields__) - len(kind.__struct_defaults__)
        fields = [name if index < count else f"[{name}]" for index, name in enumerate(kind.__struct_fields__)]
        lines.append(f"{kind.__name__:<15} {' '.join(fields)}")
    return lines


def _union() -> types.UnionType:
    from ..messages.steering import Command

    return Command


def parse(name: str, values: list[str]) -> "Command":
    """A command from its name and `KEY=VALUE`s.

    Raises:
        ConfigError: there is no such command or field, or a value does not fit.
    """
    import yaml

    from ..messages.config import ConfigError, configure, near

    kinds = {kind.__name__: kind for kind in get_args(_union())}
    if name not in kinds:
        raise ConfigError(f"no command {name!r}; {near(name, kinds)}")
    fields: dict[str, Any] = {}
    for value in values:
        key, equals, text = value.partition("=")
        if not equals:
            raise ConfigError(f"{name}: {value!r} must be KEY=VALUE")
        if key not in kinds[name].__struct_fields__:
            raise ConfigError(f"{name}: no field {key!r}; {near(key, kinds[name].__struct_fields__)}")
        try:
            fields[key] = yaml.safe_load(text)
        except yaml.YAMLError:
            raise ConfigError(f"{name}: {value}: the value is not valid YAML; put it in quotes") from None
    return configure(kinds[name], {"type": name, **fields}, name)
