"""`footfall data eth-ucy`: recorded pedestrians with the leave-one-out folds, in the files that training reads.

The folder holds the text files of the ETH/UCY benchmark (`all_data/`, `train/`, `val/`, as Social GAN and
Trajectron++ publish them), the other one the recordings as their authors published them, with obstacles.
The benchmark's copy of ETH takes every tenth frame of a 15 Hz video as 0.4 s, which makes people walk 1.67
times too fast; its positions are therefore read from the original, at 2.5 Hz. So are Hotel's.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..models.trace.crowd_file import SPLITS, CrowdFileError, Crowds
from ..models.trace.recordings import Recording, Split, census, pack_recordings
from .biwi_source import read_recording
from .import_biwi import find_recording, read_scene

RADIUS = 0.25  # m; the recordings do not say how wide people are


@dataclass(frozen=True)
class Benchmark:
    """One recording of the benchmark.

    Attributes:
        file: Its name in `all_data/`.
        rate_hz: Frames of the video per second, in which times are counted.
        scene: The original recording with obstacles, None where no obstacles were published.
        original: Tracks, too, are read from the original.
        smoothing: The one of 0, .001, .003, .01, .03, .1, .3, 1 s^3 with the least error when each sample is
            left out in turn: BIWI was annotated with 4-6 cm of noise, UCY by splines.
    """

    file: str
    rate_hz: float
    scene: str | None = None
    original: bool = False
    smoothing: float = 0.001


RECORDINGS = {
    "eth": Benchmark("biwi_eth", 15.0, "eth", original=True, smoothing=0.03),
    "hotel": Benchmark("biwi_hotel", 25.0, "hotel", original=True, smoothing=0.03),
    "students001": Benchmark("students001", 25.0),
    "students003": Benchmark("students003", 25.0),
    "zara01": Benchmark("crowds_zara01", 25.0, "zara01"),
    "zara02": Benchmark("crowds_zara02", 25.0, "zara02"),
}
FOLDS = {
    "eth": ("eth",),
    "hotel": ("hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("zara01",),
    "zara2": ("zara02",),
    "biwi": ("eth", "hotel"),
    "zara": ("zara01", "zara02"),
}
"""What each fold leaves out of training and tests on: the five of the benchmark, and both halves of what has maps."""


def add_parser(subparsers) -> None:
    """Add `data eth-ucy` to the command line."""
    parser = subparsers.add_parser(
        "eth-ucy",
        help="recorded pedestrians: the ETH/UCY benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="holds all_data/, train/ and val/")
    parser.add_argument(
        "--biwi", type=Path, required=True, help="holds the folders eth, hotel, zara01 and zara02"
    )
    parser.add_argument("--fold", choices=[*FOLDS, "all"], default="all", help="what is left out for tests")
    parser.add_argument("--out", type=Path, default=Path("data/eth_ucy"), help="folder (default %(default)s)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read, cut, write and count: `FOLD/maps.npz` with obstacles, `FOLD/open.npz` where none are known."""
    read = {name: read_recording_of(name, args.folder, args.biwi) for name in RECORDINGS}
    for fold in FOLDS if args.fold == "all" else [args.fold]:
        for kind, known in (("maps", True), ("open", False)):
            recordings = [
                replace(recording, intervals=intervals(recording, name in FOLDS[fold]))
                for name, recording in read.items()
                if (recording.obstacles is not None) == known
            ]
            crowds = pack_recordings(f"eth-ucy-{fold}-{kind}", recordings, RADIUS, {"fold": fold})
            path = args.out / fold / f"{kind}.npz"
            crowds.save(path)
            shares = ", ".join(f"{(crowds.split == i).sum()} {split}" for i, split in enumerate(SPLITS))
            print(f"{path}: {shares} scenes, {path.stat().st_size / 1e6:.1f} MB")
            report(crowds, recordings)
    return 0


def read_recording_of(name: str, folder: Path, biwi: Path) -> Recording:
    """One recording of the benchmark, all of it for training until `val/` begins, then for validation.

    Args:
        name: In `RECORDINGS`.
        folder: Of the benchmark.
        biwi: Of the original recordings.

    Raises:
        CrowdFileError: When a file is missing or not in its format.
        SceneError: The same for an original.
    """
    source = RECORDINGS[name]
    rows = read_rows(folder / "all_data" / f"{source.file}.txt")
    start, end = rows[:, 0].min(), rows[:, 0].max()
    turn = read_rows(folder / "val" / f"{source.file}_val.txt")[:, 0].min()
    outlines = None
    tracks = [rows[rows[:, 1] == person][:, [0, 2, 3]] for person in np.unique(rows[:, 1])]
    tracks = [(track - [start, 0, 0]) / [source.rate_hz, 1, 1] for track in tracks]
    if source.scene is not None:
        outlines = [o.polygon for o in read_scene(biwi, source.scene, name).obstacles]
        if source.original:
            tracks = list(read_recording(find_recording(biwi, source.scene)).tracks.values())
    seconds = (np.array([turn, end + 1]) - start) / source.rate_hz
    parts: list[tuple[float, float, Split]] = [(0.0, seconds[0], "train"), (seconds[0], seconds[1], "val")]
    return Recording(name, tracks, parts, outlines, source.smoothing)


def read_rows(path: Path) -> np.ndarray:
    """Rows [frame, person, x, y], in order of person and frame.

    Raises:
        CrowdFileError: When the file is missing or not in its format.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise CrowdFileError(f"{path}: no such file; the benchmark has one") from error
    except ValueError as error:
        raise CrowdFileError(f"{path}: {error}") from error
    if rows.shape[1:] != (4,) or not np.isfinite(rows).all():
        raise CrowdFileError(f"{path}: four finite numbers a row are needed: frame, person, x, y")
    return rows[np.lexsort((rows[:, 0], rows[:, 1]))]


def intervals(recording: Recording, left_out: bool) -> list[tuple[float, float, Split]]:
    """The recording's own split, or all of it for tests."""
    own = list(recording.intervals)
    return [(own[0][0], own[-1][1], "test")] if left_out else own


def report(crowds: Crowds, recordings: list[Recording]) -> None:
    """Print a line about each recording."""
    starts = np.array([name for name, _ in crowds.source["starts"]])
    for recording in recordings:
        found = census(crowds, np.flatnonzero(starts == recording.name))
        minutes = (recording.intervals[-1][1] - recording.intervals[0][0]) / 60
        walls = f"{100 * found.in_obstacles:.1f} % of the time in obstacles, " if crowds.has_map else ""
        print(
            f"  {recording.name}: {recording.intervals[-1][2]}, {minutes:.1f} min, {len(recording.tracks)} people, "
            f"{found.people:.1f} a scene, {found.speed:.2f} m/s, {found.acceleration:.2f} m/s2, "
            f"{walls}{100 * found.in_people:.1f} % within {2 * crowds.radius:.1f} m of somebody"
        )


def main() -> int:
    """Run without the front end."""
    parser = argparse.ArgumentParser(prog="footfall data")
    add_parser(parser.add_subparsers(required=True))
    args = parser.parse_args()
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
