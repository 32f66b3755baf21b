"""`footfall log`: what can be done with logs, one module a verb."""

import argparse
from importlib import import_module
from typing import Any

VERBS = {
    "info": ("log_info", "what is in a log"),
    "recover": ("log_recover", "make a whole log of one that was cut short or damaged"),
    "hash": ("log_hash", "a number that two logs share when the same has happened in both"),
    "diff": ("log_diff", "where two logs differ first"),
    "export": ("log_export", "topics as CSV, npz or JSON lines"),
    "plot": ("log_plot", "a picture of the run from above"),
    "html": ("log_html", "a replay in one HTML file that needs nothing else"),
    "film": ("log_film", "a film of the run"),
}
"""By verb: the module with `add_arguments` and `run`, and one line about it."""


def add_parser(subparsers: "argparse._SubParsersAction[Any]") -> None:
    """Add `log` and its verbs to the command line."""
    parser = subparsers.add_parser("log", help="look at logs", description="Look at recorded logs.")
    verbs = parser.add_subparsers(required=True, metavar="VERB", parser_class=_lazy(type(parser)))
    for verb, (module, text) in VERBS.items():
        verbs.add_parser(verb, help=text, description=text[0].upper() + text[1:] + ".").module_name = module


def _lazy(base: type[argparse.ArgumentParser]) -> Any:
    """A parser that imports the module of its verb when it is used, not before."""

    class LazyParser(base):
        module_name: str | None = None

        def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # type: ignore[override]
            if self.module_name is not None:
                module, self.module_name = import_module(f"{__package__}.{self.module_name}"), None
                module.add_arguments(self)
                self.set_defaults(run=module.run)
            return super().parse_known_args(args, namespace)

    return LazyParser


def run(args: argparse.Namespace) -> int:
    """Do what the verb says."""
    return args.run(args)
