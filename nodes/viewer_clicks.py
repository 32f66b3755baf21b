"""What a click into the scene does: selects a person, or acts on a place."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .viewer_pick import pick_ground, pick_person
from .viewer_picture import Picture

if TYPE_CHECKING:
    import viser

OnPlace = Callable[[tuple[float, float], int | None], None]
"""Called with a place on the ground [m] and who was clicked on, if anybody."""


class Clicks:
    """Turns clicks into selections.

    Args:
        server: Where the clicks come from.
        picture: Gives the picture of now.
        select: Called with who was clicked on.
    """

    def __init__(
        self,
        server: "viser.ViserServer",
        picture: Callable[[], Picture],
        select: Callable[[int | None], None],
    ) -> None:
        self._picture = picture
        self._select = select
        self.on_place: OnPlace | None = None
        """Takes the next clicks instead of the selection, while it is set."""

        @server.scene.on_click()
        def _(event: "viser.SceneClickEvent") -> None:
            self.click(np.array(event.ray_origin), np.array(event.ray_direction))

    def click(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """One click: its ray's origin (3,) [m] and direction (3,)."""
        picture = self._picture()
        person = pick_person(picture, origin, direction)
        if self.on_place is None:
            if person is not None:
                self._select(person)
            return
        place = pick_ground(picture, origin, direction)
        if place is not None:
            self.on_place(place, person)
