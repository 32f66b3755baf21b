"""What a run shows in the terminal: one live status line, warnings of nodes, nothing else."""

import sys
from contextlib import suppress
from time import monotonic


class Console:
    """Writes to stderr; the status line only where a person watches.

    Args:
        quiet: Show errors only.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._live = sys.stderr.isatty() and not quiet
        self._shown = ""
        self._due = 0.0

    def say(self, text: str, important: bool = False) -> None:
        """Print a line above the status line."""
        if self.quiet and not important:
            return
        with suppress(OSError):  # the terminal may have gone; the run's end is not its business
            erase = "\r\x1b[K" if self._shown else ""
            sys.stderr.write(f"{erase}{text}\n{self._shown}")
            sys.stderr.flush()

    @property
    def wants_status(self) -> bool:
        """Whether it is time for a new status line."""
        return self._live and monotonic() >= self._due

    def status(self, text: str) -> None:
        """Replace the status line."""
        self._due = monotonic() + 0.2
        with suppress(OSError):
            sys.stderr.write(f"\r\x1b[K{text}")
            sys.stderr.flush()
        self._shown = text

    def clear(self) -> None:
        """Take the status line away."""
        if self._shown:
            self.status("")


def status_text(
    sim_seconds: float, factor: float, agents: int | None, dropped: int, duration: float | None
) -> str:
    """`12.3 s simulated, 4.1x real time, 18 agents, 0 dropped, 3 s left`."""
    parts = [f"{sim_seconds:.1f} s simulated", f"{factor:.1f}x real time"]
    if agents is not None:
        parts.append(f"{agents} agent{'s' * (agents != 1)}")
    parts.append(f"{dropped} dropped")
    if duration is not None and factor > 0:
        left = max(0.0, duration - sim_seconds) / factor
        parts.append(f"{int(left) // 60} min {int(left) % 60} s left" if left >= 60 else f"{left:.0f} s left")
    return ", ".join(parts)
