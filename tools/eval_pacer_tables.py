"""Tables of the walker's evaluation, beside the figures of the paper and of people."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..models.pacer.gait_measures import Steps
from .results import Cell, table, write_section

PAPER: dict[str, tuple[Cell, Cell, Cell]] = {
    "flat": (None, None, None),
    "random": (0.133, 0.680, 1.950),
    "obstacles": (0.307, 0.948, 2.278),
    "crowd": (0.127, 0.371, 2.320),
}
"""Fail rate, path error [m] and discriminator reward of Rempe et al. 2023, table 3, procedural paths."""

GROUNDS_9: dict[str, tuple[tuple[str, ...], str | None]] = {
    "others": (("crowd", "obstacles"), None),
    "their body": (("random",), "extreme"),
}
"""What people are not aware of, and the grounds and bodies on which that is tried.

Of others: the same weights, not trained anew. Of their body: a twin who was trained so, on bodies as different as can
be; for a walker without a twin the same weights.
"""


def tell_table(
    number: int,
    rollouts: int,
    samples: int,
    judged: Callable[[str, str, str | None], dict[str, Any]],
    as_json: bool,
    write: Path | None,
) -> None:
    """Table 3, all grounds, or what becomes of those who are not aware of others or of their body, as in table 9.

    Args:
        number: Of the table.
        rollouts: Of each row.
        samples: The walker was trained on.
        judged: Figures by ground, by what people are not aware of: a key of `GROUNDS_9`, or "" for nothing; and by
            bodies, None for those asked for.
        as_json: Print JSON rather than the table.
        write: Markdown file to put it into.
    """
    cases: list[tuple[str, str, str | None]] = [(ground, "", None) for ground in PAPER]
    if number == 9:
        cases = [
            (g, of, who) for what, (grounds, who) in GROUNDS_9.items() for g in grounds for of in ("", what)
        ]
    facts = [(*case, judged(*case)) for case in cases]
    if as_json:
        print(
            json.dumps([{"terrain": ground, "unaware_of": of} | figures for ground, of, _, figures in facts])
        )
    head = ["ground", "fail rate", "failed by", "path error [m]", "foot skate [m/s]", "disc. reward"]
    rows: list[list[Cell]] = []
    for ground, of, bodies, figures in facts:
        causes = ", ".join(f"{count} {cause}" for cause, count in figures["falls_by_cause"].items() if count)
        name = f"{ground}, bodies of 1.5 to 2 m" if bodies == "extreme" else ground
        name += f", unaware of {of}" if of else ""
        measures = [figures[key] for key in ("path_error_m", "foot_skate_mps", "disc_reward")]
        rows.append([name, figures["fail_rate"], causes, *measures, *(PAPER[ground] if number == 3 else ())])
    if number == 3:
        head += ["paper: fail rate", "path error [m]", "disc. reward"]
    how = f"`footfall eval pacer --table {number} --rollouts {rollouts}`, compact, {samples / 1e6:.1f} M samples"
    _tell(f"pacer-{number}", f"### PACER on procedural paths ({how})", table(head, rows), as_json, write)


def tell_steps(steps: list[Steps], as_json: bool, write: Path | None) -> None:
    """Steps by speed, beside people's."""
    if as_json:
        names = ("step_length", "usual_cadence", "usual_step_length")
        print(json.dumps([asdict(s) | {name: getattr(s, name) for name in names} for s in steps]))
    head = ["speed [m/s]", "cadence [1/s]", "people's", "step [m]", "people's"]
    rows: list[list[Cell]] = [
        [
            s.speed,
            s.cadence,
            s.usual_cadence,
            s.step_length,
            s.usual_step_length,
            s.asymmetry,
            s.skate,
            s.standing,
        ]
        for s in steps
    ]
    title = "### Steps on straight ways (`footfall eval pacer --gait`; people's: Sekiya et al. 1996)"
    text = table([*head, "left-right difference", "foot skate [m/s]", "on their feet"], rows)
    _tell("pacer-gait", title, text, as_json, write)


def _tell(name: str, title: str, text: str, as_json: bool, write: Path | None) -> None:
    if not as_json:
        print(text)
    if write:
        write_section(write, name, f"{title}\n\n{text}")
