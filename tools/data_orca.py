"""`footfall data orca`: draw crowds and walk them with ORCA, one file a subset."""

import argparse
import multiprocessing
import os
import sys
import time
from functools import partial
from pathlib import Path

from ..models.trace.crowd_file import pack_crowds
from ..models.trace.orca_scenes import SUBSETS, Crowd, CrowdSpec, simulate_crowds, smallest_gap

BASE_SCENES = 1000  # of these, one in ten is for tests; further scenes only train
LARGE_SCENES = 4000
CHUNK = 20


def add_parser(subparsers) -> None:
    """Add `data orca` to the command line."""
    parser = subparsers.add_parser(
        "orca", help="synthetic crowds walked by ORCA, for training and evaluation"
    )
    parser.add_argument(
        "--subset", choices=SUBSETS, default="maps", help="few people among obstacles, or many without"
    )
    parser.add_argument(
        "--scenes", type=int, default=BASE_SCENES, help="scenes of ten seconds (default %(default)s)"
    )
    parser.add_argument(
        "--large", action="store_true", help=f"{LARGE_SCENES} scenes; the test split stays the same"
    )
    parser.add_argument(
        "--area", type=float, default=15.0, help="side of the square [m] (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)"
    )
    parser.add_argument("--out", type=Path, default=Path("data/orca"), help="folder (default %(default)s)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, check and write; the result depends on the seed, not on the number of workers."""
    scenes = LARGE_SCENES if args.large else args.scenes
    for name, value in (("--scenes", scenes), ("--workers", args.workers), ("--area", args.area)):
        if not value > 0:
            print(f"{name} must be above 0, not {value}", file=sys.stderr)
            return 2
    spec = CrowdSpec(subset=args.subset, area=args.area)
    crowds = simulate_parallel(spec, args.seed, scenes, args.workers)
    path = args.out / f"{args.subset}.npz"
    packed = pack_crowds(spec, crowds, args.seed, base=min(scenes, BASE_SCENES))
    packed.save(path)
    people = sum(len(c.positions) for c in crowds)
    gap = min(smallest_gap(c, spec.radius) for c in crowds)
    size = path.stat().st_size / 1e6
    print(f"{path}: {len(crowds)} scenes, {people} people, smallest gap {100 * gap:.1f} cm, {size:.1f} MB")
    return 0


def simulate_parallel(spec: CrowdSpec, seed: int, scenes: int, workers: int) -> list[Crowd]:
    """Walk scenes 0 .. `scenes` - 1 in several processes, with progress on standard error."""
    chunks = [range(first, min(first + CHUNK, scenes)) for first in range(0, scenes, CHUNK)]
    work = partial(simulate_crowds, spec, seed)
    crowds: list[Crowd] = []
    start = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(min(workers, len(chunks))) as pool:
        for finished in pool.imap(work, chunks):
            crowds += finished
            left = (time.monotonic() - start) / len(crowds) * (scenes - len(crowds))
            print(f"\r{len(crowds)}/{scenes} scenes, {left:.0f} s left ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return crowds


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall data")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
