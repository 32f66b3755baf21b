"""Says in the window what a node could not do of what somebody asked for."""

from time import monotonic
from typing import TYPE_CHECKING

from ..messages.diagnostics import LogLine

if TYPE_CHECKING:
    import viser

MARK = "steering: "
"""How the lines begin in which nodes refuse a command."""
SHOWN_FOR = 8.0
"""How long a refusal stands in the window [s]."""
QUIET_FOR = 2.0
"""Wall time in which the same refusal is not told again [s]."""


class Refusals:
    """Turns log lines that refuse a command into notes in every browser.

    Args:
        server: Where the browsers are.
    """

    def __init__(self, server: "viser.ViserServer") -> None:
        self._server = server
        self._told: dict[str, float] = {}

    def take(self, line: LogLine) -> str | None:
        """Show a refusal; returns what was told, None for any other line."""
        if line.level not in ("WARNING", "ERROR") or not line.text.startswith(MARK):
            return None
        text, now = line.text.removeprefix(MARK).strip(), monotonic()
        if now - self._told.get(text, -QUIET_FOR) < QUIET_FOR:
            return None
        self._told[text] = now
        for client in self._server.get_clients().values():
            client.add_notification(
                f"{line.node} cannot do that",
                text[:1].upper() + text[1:],
                auto_close_seconds=SHOWN_FOR,
                color="orange",
            )
        return text
