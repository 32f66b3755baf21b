"""Curves of a training run as CSV files that grow a row at a time."""

import csv
from collections.abc import Mapping
from pathlib import Path


def append_row(path: Path, row: Mapping[str, float]) -> None:
    """Append a row; a file that is there keeps its columns, one that is not is begun with those of the row."""
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = list(row)
    if path.is_file():
        with path.open(newline="") as file:
            columns = next(csv.reader(file))
    else:
        with path.open("w", newline="") as file:
            csv.writer(file).writerow(columns)
    with path.open("a", newline="") as file:
        csv.writer(file).writerow([f"{row[c]:.6g}" if c in row else "" for c in columns])
