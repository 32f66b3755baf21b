"""`footfall train pacer`: train the walker.

    footfall train pacer --config compact

Run it again with the same `--out` to go on where it stopped; settings may change on the way. Besides the files of
every policy's training (`tools/train_policy.py`) the folder holds `style.safetensors` (the discriminator, if there
is one) and a film of every milestone.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from ..models import ranks
from ..models.motion.library import MotionLibrary
from ..models.pacer.style import DemoWindows
from ..models.pacer.walker_config import CONFIGS, WalkerConfig
from ..models.pacer.walker_env import WalkerEnv
from ..models.pacer.walker_observation import WAYPOINTS
from ..models.pacer.walker_training import WalkerTraining
from ..models.pacer.walker_weights import grown
from ..models.render.gl import RenderError
from ..models.trace.weights import load_tensors
from .train_policy import PolicyRun, TrainingError, add_policy_arguments, configured, train

_DEMO_BODIES = 4  # of those who walk, on whom motion capture is shown to the discriminator


def add_parser(subparsers) -> None:
    """Add `train pacer` to the command line."""
    parser = subparsers.add_parser("pacer", help="the walker")
    parser.add_argument("--config", choices=sorted(CONFIGS), default="compact")
    parser.add_argument("--out", type=Path, default=None, help="folder (default runs/pacer_CONFIG)")
    parser.add_argument("--init", type=Path, help="a walker's model.safetensors to begin with")
    parser.add_argument("--discount", type=float, help="per control step")
    parser.add_argument("--push-force", type=float, help="N at most")
    parser.add_argument("--style", type=float, help="share of the style reward; needs --motions")
    parser.add_argument(
        "--motions", type=Path, default=Path("data/motions.npz"), help="motion capture library"
    )
    parser.add_argument(
        "--body-unaware", action="store_true", help="of a walker who takes everybody for average (table 9)"
    )
    parser.add_argument(
        "--film-every",
        type=float,
        default=5e6,
        help="control steps between films; 0 for none (default %(default)g)",
    )
    add_policy_arguments(parser, 60e6)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Train until `--samples`, Ctrl-C or SIGTERM; all leave a checkpoint."""
    return train(args, lambda: WalkerRun(args))


def _config(args: argparse.Namespace) -> WalkerConfig:
    config: WalkerConfig = configured(CONFIGS[args.config], args, "discount", "push_force")
    config = replace(config, body_aware=not args.body_unaware)
    if args.style is None:
        return config
    if not 0 <= args.style < 1:
        raise TrainingError("--style is a share, at least 0 and less than 1")
    return replace(config, style=replace(config.style, weight=args.style))


def _demos(args: argparse.Namespace, env: WalkerEnv) -> DemoWindows | None:
    """Motion capture on a few of the bodies that walk, if style counts."""
    if not env.config.style.weight > 0:
        return None
    bodies = env.world.bodies[:_DEMO_BODIES]
    library = MotionLibrary.load(args.motions, bodies)
    print(f"{len(library)} clips of motion capture on {len(bodies)} bodies", flush=True)
    return DemoWindows(library, env.world.hinges, env.config.style.window)


class WalkerRun(PolicyRun):
    """A run of the walker.

    Args:
        args: The command line.
    """

    def __init__(self, args: argparse.Namespace):
        config = _config(args)
        worlds = max(config.worlds // ranks.count(), 1)
        env = WalkerEnv(config, worlds, seed=args.seed + 1000 * ranks.number())
        training = WalkerTraining(env, config, _demos(args, env))
        if args.init:
            self._begin_with(args, training)
        super().__init__(args, args.out or Path("runs") / f"pacer_{args.config}", training, config)
        every = args.film_every or float("inf")
        self._next_film = (training.samples // every + 1) * every
        self.say(
            f"{len(env)} worlds of {len(env.world.bodies)} bodies, {ranks.count()} processes; "
            f"from sample {training.samples:,}"
        )

    def between(self) -> None:
        """Film six walkers at every milestone."""
        every, samples = self.args.film_every, self.training.samples
        if not every or samples < self._next_film:
            return
        self._next_film = (samples // every + 1) * every
        if ranks.number():
            return
        from .pacer_pictures import record

        path = self.folder / f"film_{samples / 1e6:.0f}M.mp4"
        try:
            record(self.training.model, self.config, seconds=8.0, seed=self.args.seed).draw(path)
        except RenderError as error:
            self.say(f"no films: {error}")
            self._next_film = float("inf")

    @staticmethod
    def _begin_with(args: argparse.Namespace, training: WalkerTraining) -> None:
        """Take over a walker's networks; what is new to see counts for nothing at first."""
        tensors, _ = load_tensors(args.init)
        model = training.model
        noise = model.log_std.clone()
        weights = grown(tensors, training.env.size, len(tensors["normalizer.mean"]) + WAYPOINTS.start)
        try:
            model.load_state_dict(weights)
        except RuntimeError as error:
            raise TrainingError(f"{args.init} does not fit --config {args.config}: {error}") from error
        model.log_std.copy_(noise)

    def told(self, means: dict[str, float]) -> str:
        """The figures of a line of the log."""
        return (
            f"{super().told(means)}  path {means['path_error']:.3f} m  skate {means['skate']:.3f}  "
            f"difficulty {means['difficulty']:.2f}  level {means['level']:.2f}"
        )
