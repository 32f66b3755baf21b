"""`footfall bench crowd`: how fast physical crowds walk on this machine, by how many there are.

A field without obstacles; everybody is there from the first tick and walks straight on. The graph is that of any
launch, in lockstep: simulator in physics mode, controller `pacer`, and a planner that costs next to nothing.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..messages.config import ConfigError
from .launched import set_words
from .results import table, write_section

SPACE = 3.0
"""Ground for each person at entry [m^2]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument(
        "--people", type=int, nargs="+", default=[1, 10, 30, 100], help="how many (default %(default)s)"
    )
    parser.add_argument(
        "--duration", type=float, default=15.0, help="simulated seconds (default %(default)g)"
    )
    parser.add_argument("--controller", default="pacer", help="or gait, which is kinematic (default pacer)")
    parser.add_argument("--weights", type=Path, help="a walker's file (default: the shipped one)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")


def run(args: argparse.Namespace) -> int:
    """Measure one crowd after the other."""
    if min(args.people) < 1 or not args.duration > 0:
        raise ConfigError("--people must be at least 1 and --duration above 0")
    rows = [measure(count, args) for count in args.people]
    text = table(["people", "real-time factor", "falls"], [list(row.values()) for row in rows])
    if args.json:
        keys = ("real_time_factor", "falls")
        print(json.dumps({key: {str(row["people"]): row[key] for row in rows} for key in keys}))
    else:
        print(text)
    if args.write:
        how = (
            f"`footfall bench crowd --controller {args.controller}`, {args.duration:g} s simulated, lockstep"
        )
        write_section(args.write, f"crowd-{args.controller}", f"### Crowds in physics ({how})\n\n{text}")
    return 0


def measure(count: int, args: argparse.Namespace) -> dict[str, Any]:
    """Launch one crowd and read off what it cost.

    Raises:
        ConfigError: the graph fails.
    """
    mode = "kinematic" if args.controller == "gait" else "physics"
    settings = [f"controller={args.controller}", "planner=constant_velocity", f"mode={mode}"]
    if args.weights:
        settings.append(f"controller.weights={args.weights.resolve()}")
    with tempfile.TemporaryDirectory(prefix="ffcrowd-") as folder:
        scene = field(count, args.duration, Path(folder) / "field")
        graph = Path(folder) / "crowd.yaml"
        graph.write_text(
            json.dumps({"include": [{"file": "pedestrians.yaml", "args": {"scene": str(scene)}}]})
        )
        words = [
            "launch",
            str(graph),
            "--mode",
            "lockstep",
            "--duration",
            f"{args.duration:g}",
            "--json",
            "--quiet",
        ]
        words += set_words(settings)
        done = subprocess.run(
            [sys.executable, "-m", "footfall.tools.cli", *words], capture_output=True, text=True
        )
        if done.returncode:
            raise ConfigError(f"{count} people: the graph fails: {done.stderr[-500:].strip()}")
        summary = json.loads(done.stdout.splitlines()[-1])
    return {
        "people": count,
        "real_time_factor": summary["real_time_factor"],
        "falls": summary["falls"],
    }


def field(count: int, duration: float, folder: Path) -> Path:
    """A scene: level ground on which so many people walk ahead side by side for so long [s]."""
    from ..models.scene import Scene, save_scene
    from ..models.scene.file import Flow, RandomPopulation

    deep = 12.0
    width, far = max(6.0, SPACE * count / deep), deep + 2.5 * duration
    cells = (round(width + 4), round(far + 10))
    spawn = np.array([[1.0, 2.0], [1.0 + deep, 2.0], [1.0 + deep, 2.0 + width], [1.0, 2.0 + width]])
    scene = Scene(
        name="field",
        description="Level ground.",
        resolution=1.0,
        origin=(0.0, 0.0),
        layers={"walkable": np.ones(cells, bool)},
        obstacles=(),
        terrain=None,
        areas={"here": spawn, "there": spawn + np.array([far - deep, 0.0])},
        population=RandomPopulation(
            count, (Flow("here", "there"),), enter_over=0.0, spacing=1.0, body_seed=1
        ),
        events=(),
    )
    return save_scene(scene, folder)
