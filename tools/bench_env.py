"""`footfall bench env`: control steps per second of the tracker's worlds, beside bare MuJoCo.

Both run the same model in as many worlds on as many threads, in turns, so that whatever else the machine does
weighs on both alike. Bare means `mujoco.batch.Batch.step` alone; the environment adds targets, rewards,
ends of episodes, resets and observations.
"""

import argparse
import json
import time
from dataclasses import replace


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the bench's arguments."""
    parser.add_argument("--worlds", type=int, default=256, help="simulated at once (default %(default)s)")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=10, help="turns of each (default %(default)s)")
    parser.add_argument("--actuation", choices=("lite", "full"), default="lite")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Measure, and print the figures."""
    figures = measure(args.worlds, args.threads, args.rounds, args.actuation)
    if args.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:<24} {value:,.3g}" if isinstance(value, float) else f"{name:<24} {value}")
    return 0


def measure(worlds: int, threads: int, rounds: int, actuation: str = "lite", steps: int = 6) -> dict:
    """Control steps per second of both, and their ratio.

    Args:
        worlds: simulated at once.
        threads: of the physics.
        rounds: turns of each.
        actuation: which hinges exist.
        steps: control steps in a turn.
    """
    import numpy as np

    from ..models.body import describe, shape_for
    from ..models.motion.library import MotionLibrary
    from ..models.motion.walk_cycle import walk_cycle
    from ..models.pacer.config import CONFIGS
    from ..models.pacer.tracker_env import TrackerEnv

    body = describe(shape_for(1.75, 75.0))
    library = MotionLibrary([walk_cycle(body, speed) for speed in (1.0, 1.3, 1.6)], [body])
    config = CONFIGS["compact"]
    config = replace(config, physics=replace(config.physics, threads=threads, actuation=actuation))
    env = TrackerEnv(config, library, worlds)
    env.reset()
    actions = np.zeros((worlds, env.n_actions), dtype=np.float32)
    spent = {"environment": 0.0, "bare": 0.0}
    for _ in range(rounds):
        begun = time.perf_counter()
        for _ in range(steps):
            env.step(actions)
        spent["environment"] += time.perf_counter() - begun
        state = env.world.qpos.copy(), env.world.qvel.copy()
        targets = env.targets(actions)
        begun = time.perf_counter()
        for _ in range(steps):
            env.world.step_bare(targets)
        spent["bare"] += time.perf_counter() - begun
        env.world.qpos[:], env.world.qvel[:] = state
    total = rounds * steps * worlds
    return {
        "worlds": worlds,
        "threads": threads,
        "actuation": actuation,
        "observation_size": env.observation.size,
        "steps_per_s": total / spent["environment"],
        "bare_steps_per_s": total / spent["bare"],
        "ratio_to_bare": spent["bare"] / spent["environment"],
    }
