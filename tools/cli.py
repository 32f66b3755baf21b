"""The `footfall` command: finds the verb, imports only its module, and puts errors in one line."""

import argparse
import difflib
import errno
import os
import sys
from importlib import import_module
from typing import NoReturn

VERBS: dict[str, tuple[str, str]] = {
    "launch": ("launch", "start a graph from a launch file or a scene"),
    "demo": ("demo", "a street corner: launch, record, draw"),
    "record": ("record", "record a running graph"),
    "replay": ("replay", "play a log into a graph"),
    "topic": ("topic", "topics: list, info, schema, echo, hz, bw, delay, pub"),
    "param": ("param", "see and change parameters of running nodes: list, set"),
    "control": ("control", "rule the clock of a running graph, or end it: pause, resume, step, rate, stop"),
    "steer": ("steer", "ask something of a running scene: waypoints, speeds, groups, obstacles, pushes"),
    "view": ("view", "look at recorded runs in a browser: play, scrub, compare"),
    "graph": ("graph", "draw a graph"),
    "top": ("top", "watch the nodes of a running graph"),
    "doctor": ("doctor", "check the installation and look for left-over processes"),
    "log": ("log", "look at logs: info, plot, html, film, hash, diff, export, recover"),
    "regress": ("regress", "replay a node's inputs and compare its outputs with a log"),
    "import biwi": ("import_biwi", "make scenes of the ETH and UCY recordings"),
    "data orca": ("data_orca", "synthetic crowds for training"),
    "data eth-ucy": ("data_eth_ucy", "recorded crowds of the ETH/UCY benchmark"),
    "data nuscenes": ("data_nuscenes", "recorded crowds of nuScenes"),
    "motion": ("motion", "motion capture libraries: retarget, info, film"),
    "train trace": ("train_trace", "train the trajectory diffusion model"),
    "train distil": ("train_distil", "teach that model to need four steps"),
    "train pace": ("train_pace", "let its crowd walk as fast as with all steps"),
    "train tracker": ("train_tracker", "train the motion tracker"),
    "train pacer": ("train_pacer", "train the walker"),
    "eval trace": ("eval_trace", "evaluate it"),
    "eval pacer": ("eval_pacer", "walk random paths with a trained walker: figures, film, pictures"),
    "eval tracker": ("eval_tracker", "follow clips with a trained tracker: figures and film"),
    "bench": ("bench", "measure: bus, fuzz, kill, soak, ..."),
    "keys": ("keys", "make keys for graphs open to the network"),
}
"""By command: the module in tools/ that has `add_parser` and `run`, and one line about it."""


class UsageError(ValueError):
    """The command line is not one we know."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see `{self.prog} --help`")


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns 0, 1 (it failed), 2 (the user's input), 130 (Ctrl-C) or 141 (closed pipe)."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    traceback = "--traceback" in arguments
    if traceback:
        arguments.remove("--traceback")
    try:
        code = _run(arguments)
        sys.stdout.flush()  # a closed pipe shows here, not when the interpreter ends
        return code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # `footfall topic echo ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except Exception as error:
        code = exit_code(error)
        if traceback or code is None:
            raise
        print(f"footfall: error: {describe(error)}", file=sys.stderr)
        return code


def _run(arguments: list[str]) -> int:
    verb, module_name = find_verb(arguments)
    parser = _Parser(
        prog="footfall",
        description="Physically simulated, controllable pedestrians on a message bus.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Put --traceback anywhere to see where an error comes from.",
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    if module_name is None:
        return _general(parser, arguments)
    module = import_module(f"{__package__}.{module_name}")
    subparsers = parser.add_subparsers(required=True)
    group, _, leaf = verb.partition(" ")
    if leaf:
        subparsers = subparsers.add_parser(group).add_subparsers(required=True)
    module.add_parser(subparsers)
    args = parser.parse_args(arguments)
    return getattr(args, "run", module.run)(args) or 0


def find_verb(arguments: list[str]) -> tuple[str, str | None]:
    """The command meant, and its module; no module where only general help can be given.

    Raises:
        UsageError: there is no such command; names the nearest.
    """
    if not arguments or arguments[0].startswith("-"):
        return "", None
    first, second = arguments[0], arguments[1] if len(arguments) > 1 else ""
    if first in VERBS:
        return first, VERBS[first][0]
    leaves = [verb.partition(" ")[2] for verb in VERBS if verb.startswith(f"{first} ")]
    if not leaves:
        raise UsageError(f"no command {first!r}; {_near(first, [verb.split()[0] for verb in VERBS])}")
    if f"{first} {second}" in VERBS:
        return f"{first} {second}", VERBS[f"{first} {second}"][0]
    if not second or second.startswith("-"):
        return first, None
    raise UsageError(f"no command '{first} {second}'; {_near(second, leaves)}")


def _general(parser: argparse.ArgumentParser, arguments: list[str]) -> int:
    """Help and version."""
    if "--version" in arguments:
        from importlib.metadata import version

        print(f"footfall {version('footfall')}")
        return 0
    group = arguments[0] if arguments and not arguments[0].startswith("-") else ""
    shown = {verb: text for verb, (_, text) in VERBS.items() if not group or verb.startswith(f"{group} ")}
    width = max(map(len, shown))
    table = "\n".join(f"  {verb:<{width}}  {text}" for verb, text in shown.items())
    parser.usage = f"footfall {group or 'COMMAND'} ..."
    parser.epilog = f"commands:\n{table}\n\n`footfall COMMAND --help` tells more. {parser.epilog}"
    if group or not arguments:
        parser.print_help()
        return 0 if arguments[1:] else 2
    parser.parse_args(arguments)
    return 2


def _near(name: str, known: list[str]) -> str:
    match = difflib.get_close_matches(name, known, 1)
    return f"did you mean {match[0]!r}?" if match else f"known: {', '.join(dict.fromkeys(known))}"


def exit_code(error: Exception) -> int | None:
    """2 for the user's input, 1 for what failed and says why; None for a fault of the program.

    A `ValueError` of our own is about what the user gave, a `RuntimeError` of our own about the world.
    """
    place = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, FileExistsError)
    if isinstance(error, place) and error.filename is not None:
        return 2
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):
        return 1
    if type(error).__module__.partition(".")[0] not in ("footfall", "__main__"):
        return None
    if isinstance(error, (ValueError, OSError)):
        return 2
    return 1 if isinstance(error, RuntimeError) else None


def describe(error: Exception) -> str:
    """An error in one line."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(main())
