"""The keys of a player, and of a clock: play, pause, step, rate, seek."""

import logging
from typing import Any

log = logging.getLogger(__name__)


class Transport:
    """Play, pause, step, rate, seek: what the control messages have asked for."""

    def __init__(self, rate: float | None, paused: bool) -> None:
        self.rate = rate
        self.paused = paused
        self.steps = 0
        """Single steps still to take."""
        self.seek_ns: int | None = None
        self.changed = False
        """Whether the wall time of the next tick has to be found anew."""

    def obey(self, name: str, value: Any) -> None:
        """Take one control verb; others are not the player's business."""
        try:
            match name:
                case "pause" | "resume":
                    self.paused = name == "pause"
                case "step":
                    self.steps += int(value or 1)
                case "rate":
                    rate = float(value) if value else None  # 0 is as fast as it goes
                    if rate is not None and not rate > 0:
                        raise ValueError("must not be below 0")
                    self.rate = rate
                case "seek":
                    self.seek_ns = round(float(value) * 1e9)
                case _:
                    return
            self.changed = True
        except (TypeError, ValueError) as error:
            log.error("control %s: %r: %s", name, value, error)
