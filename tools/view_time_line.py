"""The time line of a window: play, pause, scrub, loop."""

from collections.abc import Callable
from time import monotonic, sleep
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import viser

FRAME_RATE_HZ = 20
"""Pictures a second."""
BUTTONS = ("Start", "Back", "Play / pause", "On")
SPEEDS: tuple[str, ...] = ("0.1", "0.25", "0.5", "1", "2", "4", "8")


class TimeLine:
    """Where in the run one is: play, pause, scrub, loop.

    Args:
        start: First simulation time [s].
        end: Last simulation time [s].
    """

    def __init__(self, start: float, end: float) -> None:
        self.start, self.end = start, max(end, start)
        self.time = start
        self.playing = False
        self.loop = False
        self.speed = 1.0

    def seek(self, time: float) -> None:
        """Go to a time [s], or to the nearest there is."""
        self.time = min(max(time, self.start), self.end)

    def advance(self, wall: float) -> None:
        """Let wall time pass [s]."""
        if not self.playing:
            return
        time = self.time + wall * self.speed
        if time < self.end:
            self.time = time
        elif self.loop:
            length = self.end - self.start
            self.time = self.start + ((time - self.start) % length if length > 0 else 0.0)
        else:
            self.time = self.end
            self.playing = False


class TimeBar:
    """The controls of a time line.

    Args:
        server: Where they stand.
        line: What they rule.
        step: How far `Back` and `On` go [s].
    """

    def __init__(self, server: "viser.ViserServer", line: TimeLine, step: float = 0.1) -> None:
        self._line = line
        gui = server.gui
        span = max(line.end - line.start, 0.01)
        self._slider = gui.add_slider(
            "Time [s]", line.start, line.start + span, round(span / 2000, 3) or 0.001, line.start
        )
        buttons = gui.add_button_group("", BUTTONS)
        speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._loop = gui.add_checkbox("Loop", line.loop)
        self._loop.on_update(lambda _: setattr(line, "loop", self._loop.value))
        speed.on_update(lambda _: setattr(line, "speed", float(speed.value)))

        @self._slider.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is not None:
                line.seek(self._slider.value)

        @buttons.on_click
        def _(event: "viser.GuiEvent") -> None:
            match buttons.value:
                case "Start":
                    line.seek(line.start)
                case "Back":
                    line.seek(line.time - step)
                case "On":
                    line.seek(line.time + step)
                case _:
                    if not line.playing and line.time >= line.end:
                        line.seek(line.start)
                    line.playing = not line.playing

    def update(self) -> None:
        """Show where one is."""
        if abs(self._slider.value - self._line.time) > self._slider.step:
            self._slider.value = self._line.time
        if self._loop.value != self._line.loop:
            self._loop.value = self._line.loop

    def stretch(self) -> None:
        """Show another time line's bounds, after they were changed."""
        self._slider.min, self._slider.max = self._line.start, max(self._line.end, self._line.start + 0.01)
        self._slider.value = self._line.time


def play(line: TimeLine, refresh: Callable[[], None]) -> None:
    """Let time pass and refresh the picture, until interrupted."""
    last = monotonic()
    while True:
        begin = monotonic()
        line.advance(begin - last)
        last = begin
        refresh()
        sleep(max(0.0, 1 / FRAME_RATE_HZ - (monotonic() - begin)))
