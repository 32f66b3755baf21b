"""Long work on a terminal: how much is done, and the time left."""

import sys
from collections.abc import Callable
from time import monotonic


def progress_line(what: str = "frame") -> Callable[[int, int], None]:
    """Shows what is done, and the time left, on a terminal's standard error."""
    begin = monotonic()

    def show(done: int, total: int) -> None:
        if sys.stderr.isatty():
            left = (monotonic() - begin) / done * (total - done)
            end = "\n" if done == total else ""
            print(f"\r{what} {done} of {total}, {left:.0f} s left ", end=end, file=sys.stderr, flush=True)

    return show
