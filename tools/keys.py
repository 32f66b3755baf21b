"""`footfall keys new NAME`: key pairs for graphs whose topics are open to the network."""

import argparse
from pathlib import Path

from ..messages.secure import new_keys


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add `keys`."""
    parser = subparsers.add_parser("keys", help="make keys for graphs open to the network")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    new = verbs.add_parser("new", help="make a key pair: NAME.key to give away, NAME.key_secret to keep")
    new.add_argument("name", help="whose: a graph, a person, a machine")
    new.add_argument("--dir", type=Path, default=Path("keys"), help="folder (default: ./keys)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make the pair and say where it is."""
    public, secret = new_keys(args.dir, args.name)
    print(f"public  {public}\nsecret  {secret}  (readable by you alone; never share it)")
    return 0
