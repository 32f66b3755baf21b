"""`footfall bench planner`: how long TRACE plans, and what its few steps cost in quality.

Plans are timed warm, for a waypoint and both avoidances, on a street corner made up for the purpose; never with
the help of a previous plan. Speed and quality are compared with the paper's sampler: 100 steps of DDPM, guided
through the network (eq 6), on crowds drawn anew from the seed of table 1, the same people for both.
"""

import argparse
import json
import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from ..models.trace.planner import TracePlanner

AGENTS = (1, 10, 50)
SPACING = 2.2  # m between people at the start
ROOM = 0.5  # m from blocks to people; twice that from block to block
LEAST_SECONDS = 1.0  # each number of people is timed for so long, and at least thrice


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument("--agents", type=int, nargs="+", default=list(AGENTS), help="people in the scene")
    parser.add_argument("--samples", type=int, default=10, help="futures a person (default %(default)s)")
    parser.add_argument(
        "--steps",
        type=int,
        default=None,
        help="denoising steps (default: as shipped, of a distilled network)",
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--weights", type=Path, default=None, help="file (default: as shipped)")
    parser.add_argument(
        "--scenes", type=int, default=3, help="of table 1, for the comparison; 0 leaves it out (default 3)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Measure, and print the figures."""
    figures = measure(args.agents, args.samples, args.threads, args.scenes, args.steps, args.weights)
    if args.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:<16} {value}")
    return 0


def measure(
    agents: list[int],
    samples: int = 10,
    threads: int = 2,
    scenes: int = 3,
    steps: int | None = None,
    weights: Path | None = None,
) -> dict[str, Any]:
    """Times of plans and the comparison with the paper's sampler.

    Args:
        agents: Numbers of people.
        samples: Futures a person.
        threads: Of the network.
        scenes: Of the comparison.
        steps: Denoising steps; None as shipped.
        weights: None as shipped.

    Returns:
        `plan_ms` (median wall time) and `plan_cpu_ms` (mean) by number of people; `memory_mb` (peak); with scenes
        also `speedup` (CPU time of the paper's sampler over ours), `quality_ratio` (waypoint error of ours over
        its), and `error`, `obstacle`, `agent` of both, as [ours, 100 steps].
    """
    import torch

    from ..models.trace.guidance import Guidance
    from ..models.trace.planner import FEW, WEIGHTS, Sampling, TracePlanner
    from ..models.trace.weights import load_model

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        ours = TracePlanner.load(weights, replace(FEW, steps=steps) if steps else None)
        ours.sampling = replace(ours.sampling, samples=samples)
        figures: dict[str, Any] = {"plan_ms": {}, "plan_cpu_ms": {}}
        for count in agents:
            wall, cpu = time_plans(ours, count)
            figures["plan_ms"][str(count)], figures["plan_cpu_ms"][str(count)] = round(wall, 1), round(cpu, 1)
        figures["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        if scenes:
            slow = Sampling(solver="ddpm", samples=samples, reduced=False)
            paper = TracePlanner(load_model(WEIGHTS)[0], slow, Guidance(mode="clean", polish=0))
            figures |= compare(ours, paper, scenes)
    finally:
        torch.set_num_threads(before)
    return figures | {"sampler": ours.sampling.name(ours.config), "samples": samples, "threads": threads}


def time_plans(planner: "TracePlanner", agents: int) -> tuple[float, float]:
    """Median wall time and mean CPU time [ms] of a plan."""
    people = street(agents)
    for _ in range(2):
        planner.plan(*people)
    walls: list[float] = []
    cpu = time.process_time()
    while len(walls) < 3 or sum(walls) < LEAST_SECONDS:
        begin = time.perf_counter()
        planner.plan(*people, seed=len(walls))
        walls.append(time.perf_counter() - begin)
    cpu = (time.process_time() - cpu) / len(walls)
    return 1e3 * sorted(walls)[len(walls) // 2], 1e3 * cpu


def street(agents: int, seed: int = 0) -> "tuple[np.ndarray, np.ndarray, Any, list[Any]]":
    """People on a grid who have walked straight on, blocks about them, and goals four seconds ahead.

    Between blocks, and from them to where people were, are and are to be, there is room for a person.
    """
    import numpy as np
    import torch

    from ..models.trace.evaluation import PASS
    from ..models.trace.objectives import Objective
    from ..models.trace.scene_map import SceneMaps

    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(agents)))
    here = SPACING * np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)[:agents]
    heading, speed = rng.uniform(-np.pi, np.pi, agents), rng.uniform(0.8, 1.5, agents)
    forward = np.stack([np.cos(heading), np.sin(heading)], -1) * speed[:, None]
    states = np.empty((agents, 31, 4))
    states[..., :2] = here[:, None] + forward[:, None] * (0.1 * np.arange(-30, 1))[:, None]
    states[..., 2], states[..., 3] = heading[:, None], speed[:, None]
    goal = here + 4.0 * forward + rng.normal(0.0, 0.8, (agents, 2))
    cells = int((SPACING * side + 12) / 0.1)
    blocked = np.zeros((cells, cells), bool)
    taken = np.concatenate([states[..., :2].reshape(-1, 2), goal])
    margin, blocks = round(2 * ROOM / 0.1), 0
    for _ in range(60):
        row, column = rng.integers(0, cells - 20, 2)
        corner = 0.1 * np.array([column, row]) - 6.0
        free = np.maximum(corner - taken, taken - corner - (1.2, 1.5)).max(1).min() > ROOM
        around = blocked[
            max(row - margin, 0) : row + 15 + margin, max(column - margin, 0) : column + 12 + margin
        ]
        if free and not around.any() and blocks < 6:
            blocked[row : row + 15, column : column + 12] = True
            blocks += 1
    wishes = [
        Objective("waypoint", {"goal": torch.from_numpy(goal), **PASS}),
        Objective("agent_avoid"),
        Objective("obstacle_avoid"),
    ]
    maps = SceneMaps.from_raster({"obstacle": blocked}, 0.1, (-6.0, -6.0))
    return states, np.full((agents, 2), 0.6), maps, wishes


def compare(ours: "TracePlanner", paper: "TracePlanner", scenes: int) -> dict[str, Any]:
    """The row `all` of table 1 on a few scenes, with either sampler; CPU times of one run."""
    from ..models.trace.crowd_file import pack_crowds
    from ..models.trace.evaluation import GUIDES, TrialScenes, evaluate
    from ..models.trace.orca_scenes import CrowdSpec, simulate_crowds

    spec = CrowdSpec(subset="maps")
    crowds = pack_crowds(spec, simulate_crowds(spec, 0, range(10 * scenes)), 0)
    trials = TrialScenes(crowds, ours.config, "test", scenes)
    fast, slow = (
        evaluate(planner, trials, GUIDES["all"], clock=time.process_time) for planner in (ours, paper)
    )
    return {
        "speedup": round(slow.seconds / fast.seconds, 1),
        "quality_ratio": round(fast.waypoint / max(slow.waypoint, 1e-6), 3),
        "error": [round(r.waypoint, 4) for r in (fast, slow)],
        "obstacle": [round(r.obstacle, 4) for r in (fast, slow)],
        "agent": [round(r.agent, 4) for r in (fast, slow)],
        "compared_scenes": len(trials),
    }
