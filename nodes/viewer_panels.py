"""The viewer's panels: what is drawn, one person in detail, how the graph is doing."""

import html
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..messages.objectives import MinimumSpeed, ObstacleAvoidance, SocialDistance, TargetSpeed, Waypoint
from .viewer_picture import Picture
from .viewer_scene import Scene, Shown

if TYPE_CHECKING:
    import viser

LAYERS = {
    "people": "People",
    "disks": "Disks",
    "tracks": "Tracks (last 3 s)",
    "trails": "Ways of the whole run",
    "plans": "Plans",
    "samples": "Samples not chosen",
    "waypoints": "Waypoints",
    "groups": "Groups",
    "contacts": "Contacts",
    "obstacles": "Obstacles",
    "buildings": "Tall obstacles",
    "names": "Numbers",
}
"""Switches by attribute of `Shown`."""
NOBODY = "nobody"
LOG_LINES = 30
"""Log lines shown."""
QUIET_TOPICS = ("done", "diagnostics", "log", "parameters", "steps")
"""Topics of every node about itself, left out of the table of rates."""


class Panels:
    """Switches and read-outs beside the scene.

    Args:
        server: Where they stand.
        scenes: What the switches rule, one scene a run; the first is the one inspected.
    """

    def __init__(self, server: "viser.ViserServer", scenes: Sequence[Scene]) -> None:
        self._server = server
        self._scenes = scenes
        self.on_selected: Callable[[int | None], None] = lambda agent: None
        """Called when somebody is selected; from a thread of viser's."""
        self.stale = True
        """Whether everything must be drawn anew."""
        gui = server.gui
        self.tabs = gui.add_tab_group()
        with self.tabs.add_tab("Person"):
            self._choice = gui.add_dropdown("Who", [NOBODY], hint="or click on somebody in the scene")
            self._follow = gui.add_checkbox("Camera goes along", False)
            self._person = gui.add_html("")
        with self.tabs.add_tab("Graph"):
            self._nodes = gui.add_html("")
            self._topics = gui.add_html("")
            self._lines = gui.add_html("")
        with self.tabs.add_tab("Show"):
            for name, label in LAYERS.items():
                self._add_switch(name, label)
            gui.add_button("From above").on_click(lambda event: self._look_down(event.client))

        @self._choice.on_update
        def _(event: "viser.GuiEvent") -> None:
            if event.client is not None:
                choice = self._choice.value
                self.select(None if choice == NOBODY else int(choice[1:]))

    def _add_switch(self, name: str, label: str) -> None:
        box = self._server.gui.add_checkbox(label, getattr(Shown, name))

        @box.on_update
        def _(_: "viser.GuiEvent") -> None:
            for scene in self._scenes:
                setattr(scene.shown, name, box.value)
            self.stale = True

    def select(self, agent: int | None) -> None:
        """Inspect somebody, or nobody."""
        for scene in self._scenes:
            scene.selected = agent
        choice = NOBODY if agent is None else f"#{agent}"
        if choice in self._choice.options:
            self._choice.value = choice
        self.stale = True
        self.on_selected(agent)

    @property
    def selected(self) -> int | None:
        """Who is inspected."""
        return self._scenes[0].selected

    def update(self, picture: Picture, others: Sequence[Picture] = ()) -> None:
        """Bring the read-outs up to date; a few times a second is enough."""
        everybody = sorted({*picture.ids, *(agent for other in others for agent in other.ids)})
        options = [NOBODY, *(f"#{agent}" for agent in everybody)]
        if self.selected is not None and f"#{self.selected}" not in options:
            options.append(f"#{self.selected}")
        if tuple(options) != tuple(self._choice.options):
            self._choice.options = options
        chosen = NOBODY if self.selected is None else f"#{self.selected}"
        if self._choice.value != chosen:  # selected before anybody was there
            self._choice.value = chosen
        self._person.content = person_html(picture, self.selected)
        self._nodes.content = nodes_html(picture)
        self._topics.content = topics_html(picture)
        self._lines.content = lines_html(picture)

    def steer_camera(self, picture: Picture) -> None:
        """Take the cameras along with who is selected."""
        if not self._follow.value or self.selected is None:
            return
        where = dict(zip(*picture.places(), strict=True))
        if self.selected not in where:
            return
        target = picture.on_ground(where[self.selected], 1.0)
        for client in self._server.get_clients().values():
            moved = target - client.camera.look_at
            with client.atomic():
                client.camera.position = client.camera.position + moved
                client.camera.look_at = target

    def _look_down(self, client: "viser.ClientHandle | None") -> None:
        if client is None:
            return
        target = np.asarray(client.camera.look_at)
        distance = max(15.0, float(np.linalg.norm(client.camera.position - target)))
        with client.atomic():
            client.camera.position = target + np.array([0.0, -1e-3, distance])
            client.camera.look_at = target


def person_html(picture: Picture, agent: int | None) -> str:
    """Everything known about one person."""
    if agent is None:
        return _note("Nobody is selected.")
    if agent not in picture.ids:
        return _note(f"#{agent} is not there now.")
    rows: list[tuple[str, str]] = []
    agents = picture.agents
    if agents is not None and agent in agents.ids:
        x, y, heading, speed = agents.now[int(np.flatnonzero(agents.ids == agent)[0]), :4].tolist()
        rows += [
            ("position", f"{x:.2f}, {y:.2f} m"),
            ("heading", f"{np.degrees(heading):.0f}°"),
            ("speed", f"{speed:.2f} m/s"),
        ]
    if picture.bodies is not None and agent in picture.bodies.ids:
        row = int(np.flatnonzero(picture.bodies.ids == agent)[0])
        rows.append(("body", f"{picture.bodies.statures[row]:.2f} m, {picture.bodies.masses[row]:.0f} kg"))
    if (group := picture.group_of(agent)) is not None:
        others = ", ".join(f"#{member}" for member in group.members if member != agent)
        rows.append(("group", f"{group.id}, led by #{group.leader}, with {others}"))
    rows += [(kind, text) for kind, text in _wishes(picture, agent)]
    rows += _plan_rows(picture, agent)
    rows += [(f"{node} method", html.escape(method)) for node, method in sorted(picture.methods.items())]
    return _table((), rows)


def _wishes(picture: Picture, agent: int) -> Iterable[tuple[str, str]]:
    for wish in picture.wishes(agent):
        match wish:
            case Waypoint():
                when = "" if wish.at is None else f" at {wish.at:.1f} s"
                text = f"{wish.position[0]:.2f}, {wish.position[1]:.2f} m{when}"
                yield "waypoint", f"{text} · {wish.weight:g}"
            case TargetSpeed() | MinimumSpeed():
                kind = "wanted speed" if isinstance(wish, TargetSpeed) else "least speed"
                yield kind, f"{wish.speed:.2f} m/s · {wish.weight:g}"
            case SocialDistance():
                yield "social distance", f"{wish.gap:.2f} m · {wish.weight:g}"
            case ObstacleAvoidance():
                yield "off obstacles", f"{wish.margin:.2f} m · {wish.weight:g}"


def _plan_rows(picture: Picture, agent: int) -> Iterable[tuple[str, str]]:
    plans, row = picture.plans, picture.plan_of(agent)
    if plans is None or row is None:
        return
    chosen = int(plans.chosen[row])
    yield "plan", f"sample {chosen + 1} of {plans.positions.shape[1]}, by {html.escape(plans.method)}"
    yield "plan age", f"{picture.plan_age():.2f} s"
    yield "planning time", f"{1000 * plans.planning_time:.0f} ms"
    if plans.losses is not None:
        for column, name in enumerate(plans.loss_names):
            losses = plans.losses[row, :, column]
            yield f"loss {html.escape(name)}", f"{losses[chosen]:.3g} (best {losses.min():.3g})"


def nodes_html(picture: Picture) -> str:
    """How every node is doing."""
    rows = []
    for node, reports in sorted(picture.reports.items()):
        report = reports[-1][1]
        rows.append(
            (
                html.escape(node),
                f"{100 * report.cpu:.0f} %",
                f"{report.memory / 1e6:.0f} MB",
                f"{1000 * report.step_time:.1f} ms",
                f"{1000 * report.step_time_max:.1f} ms",
                f"{report.errors}",
            )
        )
    return _table(("node", "CPU", "memory", "step", "longest", "errors"), rows) if rows else ""


def topics_html(picture: Picture) -> str:
    """How much of every topic is sent, and what of it got lost."""
    dropped: dict[tuple[str, str], int] = {}
    for reports in picture.reports.values():
        for wire in reports[-1][1].inputs:
            key = (wire.topic, wire.publisher)
            dropped[key] = dropped.get(key, 0) + wire.dropped + wire.rejected
    rows = []
    for node, reports in picture.reports.items():
        rates = picture.rates(node)
        for output in reports[-1][1].outputs:
            if output.topic in QUIET_TOPICS:
                continue
            rate = rates.get(output.topic)
            rows.append(
                (
                    html.escape(output.topic),
                    html.escape(node),
                    "" if rate is None else f"{rate:.1f} Hz",
                    f"{output.sent}",
                    f"{output.bytes / 1e6:.1f} MB",
                    f"{dropped.get((output.topic, node), 0)}",
                )
            )
    return _table(("topic", "from", "rate", "sent", "size", "lost"), sorted(rows)) if rows else ""


def lines_html(picture: Picture) -> str:
    """The newest log lines, newest first."""
    lines = list(picture.lines)[-LOG_LINES:][::-1]
    if not lines:
        return _note("No log lines yet.")
    rows = "".join(
        f'<div><b style="color:{_LEVEL_COLOURS.get(line.level, "inherit")}">{html.escape(line.node)}</b> '
        f"{html.escape(line.text.strip()[:400])}</div>"
        for line in lines
    )
    return f'<div style="{_FONT};max-height:16em;overflow:auto">{rows}</div>'


_LEVEL_COLOURS = {"WARNING": "#a86400", "ERROR": "#c01c28", "CRITICAL": "#c01c28"}
_FONT = "font-size:0.8em;line-height:1.35;padding:0 0.8em;font-variant-numeric:tabular-nums"


def _note(text: str) -> str:
    return f'<div style="{_FONT}">{text}</div>'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already; columns past the first are numbers where there is a head."""
    align = "right" if head else "left"
    titles = "".join(
        f'<th style="text-align:{align if i > 1 else "left"};font-weight:600">{title}</th>'
        for i, title in enumerate(head)
    )
    body = "".join(
        "<tr>"
        + "".join(
            f'<td style="text-align:{align if i > 1 else "left"};padding-right:0.6em">{cell}</td>'
            for i, cell in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    table = f'<table style="width:100%"><tr>{titles}</tr>{body}</table>'
    return f'<div style="{_FONT};overflow-x:auto">{table}</div>'
