"""Tables of figures in `docs/results.md`: each between its own markers, written by the command that measures."""

from collections.abc import Iterable, Sequence
from pathlib import Path

Cell = str | float | int | bool | None


def table(head: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A Markdown table; numbers with three significant digits, None as an empty cell."""
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    return "\n".join([*lines, *(f"| {' | '.join(map(_text, row))} |" for row in rows)])


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "NO"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def write_section(path: Path, name: str, text: str) -> None:
    """Replace the section between this name's markers, or append it."""
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    before = path.read_text() if path.is_file() else "# Results\n"
    section = f"{begin}\n{text}\n{end}"
    if begin in before and end in before:
        head, rest = before.split(begin, 1)
        path.write_text(head + section + rest.split(end, 1)[1])
    else:
        path.write_text(f"{before.rstrip()}\n\n{section}\n")
