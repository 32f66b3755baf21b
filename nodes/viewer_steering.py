"""The panel that steers a running scene."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..messages.link import Request, Steer
from ..messages.objectives import SocialDistance, TargetSpeed
from ..messages.steering import (
    BreakGroup,
    Command,
    DropObstacle,
    MakeGroup,
    Push,
    Remove,
    RemoveObstacle,
    SetDistance,
    SetSpeed,
    SetWaypoint,
    SetWeight,
    Spawn,
)
from .viewer_clicks import Clicks
from .viewer_panels import Panels
from .viewer_picture import Picture

if TYPE_CHECKING:
    import viser

SELECT = "select a person"
WAYPOINT = "send the selected there"
OBSTACLE = "drop an obstacle"
CLEAR = "remove an obstacle"
SPAWN = "let somebody in"
PUSH = "push a person"
ACTIONS: tuple[str, ...] = (SELECT, WAYPOINT, OBSTACLE, CLEAR, SPAWN, PUSH)
"""What a click does."""
RATES: tuple[str, ...] = ("0.25", "0.5", "1", "2", "as fast as it goes")
OBJECTIVES: tuple[str, ...] = (
    "Waypoint",
    "TargetSpeed",
    "MinimumSpeed",
    "SocialDistance",
    "ObstacleAvoidance",
    "Group",
)


class SteeringPanel:
    """Buttons and sliders that become commands.

    Args:
        server: Where they stand.
        send: Takes each command; called from threads of viser's.
    """

    def __init__(self, server: "viser.ViserServer", send: Callable[[Request | Steer], None]) -> None:
        self._send = send
        self._panels: Panels | None = None
        self._clicks: Clicks | None = None
        self._picture: Callable[[], Picture] = Picture
        gui = server.gui
        clock = gui.add_button_group("Clock", ("Pause", "Resume", "Step"))
        clock.on_click(lambda _: send(Request("control", "*", clock.value.lower())))
        rate = gui.add_dropdown("Speed", RATES, initial_value="1")
        rate.on_update(lambda event: self._set_rate(event, rate.value))
        self._action = gui.add_dropdown("A click", ACTIONS, initial_value=SELECT)
        self._action.on_update(lambda _: self._arm())
        with gui.add_folder("The selected person", expand_by_default=False):
            self._speed = gui.add_slider("Speed [m/s]", 0.0, 3.0, 0.05, 1.3)
            self._gap = gui.add_slider("Distance [m]", 0.0, 2.0, 0.05, 0.2)
            self._objective = gui.add_dropdown("Objective", OBJECTIVES, initial_value="Waypoint")
            self._weight = gui.add_slider("Its weight", 0.0, 10.0, 0.1, 1.0)
            self._force = gui.add_slider("Push [N]", 50, 1000, 50, 300)
            self._members = gui.add_text("Group with", "", hint="numbers, e.g. 3, 7")
            buttons = gui.add_button_group("", ("Group", "Ungroup", "Remove"))
        self._speed.on_update(
            lambda event: self._for_selected(event, lambda a: SetSpeed(a, self._speed.value))
        )
        self._gap.on_update(
            lambda event: self._for_selected(event, lambda a: SetDistance(a, self._gap.value))
        )
        self._weight.on_update(lambda event: self._for_selected(event, self._weight_command))
        buttons.on_click(lambda event: self._press(event, buttons.value))

    def connect(self, panels: Panels, clicks: Clicks, picture: Callable[[], Picture]) -> None:
        """Tell it who is selected, where clicks come from and what there is."""
        self._panels, self._clicks, self._picture = panels, clicks, picture

    def update(self, picture: Picture) -> None:
        """Show the selected person's own values."""
        agent = self._selected
        if agent is None:
            return
        for wish in picture.wishes(agent):
            if isinstance(wish, TargetSpeed):
                self._speed.value = float(np.clip(wish.speed, 0.0, 3.0))
            elif isinstance(wish, SocialDistance):
                self._gap.value = float(np.clip(wish.gap, 0.0, 2.0))

    @property
    def _selected(self) -> int | None:
        return None if self._panels is None else self._panels.selected

    def _set_rate(self, event: "viser.GuiEvent", text: str) -> None:
        if event.client is not None:
            value = None if text == RATES[-1] else float(text)
            self._send(Request("control", "*", "rate", value))

    def _for_selected(self, event: "viser.GuiEvent", command: Callable[[int], Command]) -> None:
        """Send a command about the selected person, if a browser asked for it."""
        agent = self._selected
        if event.client is not None and agent is not None:
            self._send(Steer(command(agent)))

    def _weight_command(self, agent: int) -> Command:
        return SetWeight(agent, self._objective.value, self._weight.value)  # type: ignore[arg-type]

    def _press(self, event: "viser.GuiEvent", button: str) -> None:
        if button == "Remove":
            self._for_selected(event, Remove)
        elif button == "Ungroup":
            self._for_selected(event, BreakGroup)
        else:
            others = [int(n) for n in self._members.value.replace(",", " ").split() if n.isdecimal()]
            if others:
                self._for_selected(event, lambda a: MakeGroup([a, *(n for n in others if n != a)], a))

    def _arm(self) -> None:
        """Let clicks do what is chosen."""
        if self._clicks is not None:
            self._clicks.on_place = None if self._action.value == SELECT else self.act

    def act(self, place: tuple[float, float], person: int | None) -> None:
        """Do what is chosen at a place on the ground [m], or to a person there."""
        picture, agent = self._picture(), self._selected
        match self._action.value:
            case action if action == WAYPOINT and agent is not None:
                self._send(Steer(SetWaypoint(agent, place)))
            case action if action == OBSTACLE:
                self._send(Steer(box_at(picture, place)))
            case action if action == CLEAR:
                if (name := obstacle_at(picture, place)) is not None:
                    self._send(Steer(RemoveObstacle(name)))
            case action if action == SPAWN:
                self._send(Steer(Spawn(place)))
            case action if action == PUSH and person is not None:
                self._send(Steer(push_from_behind(picture, person, float(self._force.value))))


def box_at(picture: Picture, place: tuple[float, float], size: float = 0.8) -> DropObstacle:
    """A box with its middle at a place, called as no other obstacle is."""
    names = {obstacle.name for obstacle in picture.place.obstacles} if picture.place else set()
    number = next(n for n in range(1, len(names) + 2) if f"dropped {n}" not in names)
    half = 0.5 * size
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    return DropObstacle(f"dropped {number}", [(place[0] + x, place[1] + y) for x, y in corners])


def obstacle_at(picture: Picture, place: tuple[float, float], reach: float = 1.0) -> str | None:
    """The obstacle whose middle is nearest to a place, or around it."""
    best, found = reach, None
    for obstacle in picture.place.obstacles if picture.place else ():
        outline = np.asarray(obstacle.polygon)
        away = float(np.linalg.norm(outline.mean(axis=0) - place))
        size = float(np.linalg.norm(outline - outline.mean(axis=0), axis=1).max())
        if away - size < best:
            best, found = away - size, obstacle.name
    return found


def push_from_behind(picture: Picture, agent: int, force: float) -> Push:
    """A push forwards, where somebody is heading."""
    heading = 0.0
    if picture.agents is not None and agent in picture.agents.ids:
        heading = float(picture.agents.now[int(np.flatnonzero(picture.agents.ids == agent)[0]), 2])
    return Push(agent, (force * float(np.cos(heading)), force * float(np.sin(heading)), 0.0))
