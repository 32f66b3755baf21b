"""Finds recorded motions in a folder of data and reads them with their known faults mended.

A data set is a folder with an ``index.csv``. Two kinds are known by their columns: CMU clips as BVH (``file,
description, skeleton, unit_to_m, valid_start, valid_end, fps``) and DeepMimic clips (``file, kind,
dof_cols``).
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path

from .bvh import read_bvh
from .deepmimic import read_deepmimic
from .recording import MotionFormatError, Recording

_SKELETONS = {"cmu_mb31": "cmu", "daz43": "daz"}
_UNFIT = ("stair", "step", "climb", "uneven", "ladder", "hop", "stealthy", "zombie")
"""Words in descriptions of locomotion that is not on level ground, or no way pedestrians walk."""


class DataError(ValueError):
    """The folder of data is unknown, missing or holds no motions."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One recorded motion."""

    path: Path
    name: str
    description: str
    skeleton: str
    """As the index says: ``cmu_mb31``, ``daz43`` or ``deepmimic``."""
    locomotion: bool
    """Whether it is walking or running on level ground."""
    unit_to_m: float = 1.0
    first: int = 0
    last: int | None = None
    """Frames that are motion, before resampling; None: to the end."""
    rate_hz: float = 0.0

    def read(self) -> Recording:
        """Read the motion without its glitches.

        Raises:
            MotionFormatError: the file is not what the index says.
        """
        if self.skeleton == "deepmimic":
            return read_deepmimic(self.path).without_glitches()
        kind = _SKELETONS[self.skeleton]
        whole = read_bvh(self.path, kind, self.unit_to_m, self.rate_hz)
        return whole.cut(self.first, self.last or len(whole)).without_glitches()


def data_folder(given: Path | str | None = None) -> Path:
    """The folder of data: `given`, or that of the environment variable FOOTFALL_DATA.

    Raises:
        DataError: neither is set, or there is no such folder.
    """
    folder = given or os.environ.get("FOOTFALL_DATA")
    if not folder:
        raise DataError("Where is the motion data? Give --data FOLDER or set FOOTFALL_DATA.")
    if not Path(folder).is_dir():
        raise DataError(f"There is no data folder {folder}.")
    return Path(folder)


def read_catalogue(folder: Path) -> list[Entry]:
    """List all motions below a folder, by name.

    Raises:
        DataError: there is none.
        MotionFormatError: an index cannot be read.
    """
    entries: list[Entry] = []
    for index in sorted([*folder.glob("index.csv"), *folder.glob("*/index.csv")]):
        with index.open(newline="") as file:
            rows = list(csv.DictReader(file))
        columns = set(rows[0]) if rows else set()
        try:
            if {"skeleton", "unit_to_m", "valid_start"} <= columns:
                entries += [_cmu(index.parent, row) for row in rows if row["skeleton"] in _SKELETONS]
            elif {"dof_cols", "kind"} <= columns:
                entries += [_deepmimic(index.parent, row) for row in rows if row["dof_cols"] == "44"]
        except (KeyError, ValueError) as error:
            raise MotionFormatError(f"{index}: {error}.") from error
    if not entries:
        raise DataError(
            f"{folder} holds no motions: no index.csv of CMU or DeepMimic clips in it or one below."
        )
    return sorted(entries, key=lambda entry: entry.name)


def _cmu(folder: Path, row: dict[str, str]) -> Entry:
    description = row["description"].lower()
    skeleton = row["skeleton"]
    moves = any(word in description for word in ("walk", "run", "jog", "stride"))
    agile = any(word in description for word in (*_UNFIT, "jump", "leap", "kick", "dribbl", "cartwheel"))
    return Entry(
        path=folder / row["file"],
        name=f"cmu_{Path(row['file']).stem}",
        description=description,
        skeleton=skeleton,
        locomotion=moves and not agile,
        unit_to_m=float(row["unit_to_m"]),
        first=int(row["valid_start"]),
        last=int(row["valid_end"]),
        rate_hz=float(row["fps"]),
    )


def _deepmimic(folder: Path, row: dict[str, str]) -> Entry:
    name = Path(row["file"]).stem.removeprefix("humanoid3d_")
    fit = row["kind"] == "locomotion" and not any(word in name for word in _UNFIT)
    return Entry(folder / row["file"], f"dm_{name}", name.replace("_", " "), "deepmimic", fit)
