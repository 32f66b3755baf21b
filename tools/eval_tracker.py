"""`footfall eval tracker`: how well a tracker follows the clips of a library, in figures and as a film."""

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from ..models.motion.library import MotionLibrary, load_clips
from ..models.pacer.body_masks import MASKS
from ..models.pacer.tracker_env import TrackerEnv
from ..models.pacer.tracker_evaluation import Evaluation, evaluate
from ..models.pacer.weights import TRACKER, load_tracker
from .results import Cell, table, write_section

_RUN = 2.2  # m/s: slower clips are walks


class EvaluationError(ValueError):
    """A clip that is not in the library."""


def add_parser(subparsers) -> None:
    """Add `eval tracker` to the command line."""
    parser = subparsers.add_parser("tracker", help="the motion tracker")
    parser.add_argument("--model", type=Path, default=TRACKER)
    parser.add_argument("--motions", type=Path, default=Path("data/motions.npz"))
    parser.add_argument("--mask", choices=sorted(MASKS), default="whole", help="what the tracker is told")
    parser.add_argument("--augmented", action="store_true", help="mirror images and bent walks, too")
    parser.add_argument(
        "--only", metavar="BEGINNING", default="", help="clips whose names begin so, e.g. cmu_"
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="put a table into this Markdown file")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--film",
        type=Path,
        help="simulated people beside their references, as a film (.mp4) or strips (.png)",
    )
    parser.add_argument(
        "--rollout",
        type=Path,
        metavar="LOG",
        help="the same as a log for `footfall view`: curves, reward terms",
    )
    parser.add_argument("--clips", nargs="+", help="clips to show (default: six across the library)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print a line a clip and the summary, and film."""
    torch.set_num_threads(2)
    model, config, facts = load_tracker(args.model)
    clips, bodies = load_clips(args.motions)
    chosen = [clip for clip in clips if args.augmented or "parent" not in clip.tags]
    chosen = [clip for clip in chosen if clip.name.startswith(args.only)]
    if not chosen:
        raise EvaluationError(f"no clip in {args.motions} has a name that begins with {args.only!r}")
    library = MotionLibrary(chosen, bodies)
    result = evaluate(model, library, config, mask=MASKS[args.mask])
    figures = result.summary() | {"clips": len(library), "samples": int(facts.get("samples", 0))}
    if args.json:
        print(json.dumps(figures))
    else:
        for i, clip in enumerate(library.clips):
            print(
                f"{clip.name:<28} {clip.speed:5.2f} m/s  {result.seconds[i]:5.1f} of {clip.duration:5.1f} s  "
                f"{1e3 * result.relative_error[i]:5.0f} mm  {_end(result, i)}"
            )
        for name, value in figures.items():
            print(f"{name}: {value:.4g}")
    if args.write:
        write_section(args.write, f"tracker-{args.mask}", _table(library, result, args, figures["samples"]))
    if args.film or args.rollout:
        names = [clip.name for clip in library.clips]
        wanted = args.clips or names[:: max(len(names) // 6, 1)][:6]
        for name in wanted:
            if name not in names:
                raise EvaluationError(f"there is no clip {name!r} in {args.motions}")
        chosen_clips = np.array([names.index(name) for name in wanted])
        if args.film:
            _film(args.film, model, config, library, chosen_clips)
        if args.rollout:
            from .rollout_log import write_rollout
            from .tracker_rollout import roll_out

            write_rollout(
                args.rollout, roll_out(model, config, library, chosen_clips.tolist()), overwrite=True
            )
    return 0


def _end(result: Evaluation, clip: int) -> str:
    """What became of who followed a clip."""
    return "" if result.tracked[clip] else "fell" if result.fell[clip] else "lost"


def _table(library: MotionLibrary, result: Evaluation, args: argparse.Namespace, samples: float) -> str:
    """How clips were followed, by their speed."""
    rows: list[list[Cell]] = []
    for name, low, high in (("all", 0.0, np.inf), ("walks", 0.0, _RUN), ("runs", _RUN, np.inf)):
        part = (library.speeds >= low) & (library.speeds < high)
        if part.any():
            figures = result.take(part).summary()
            rows.append([name, int(part.sum()), *figures.values()])
    names = [
        "share followed to the end",
        "without a fall",
        "joint error [mm]",
        "in the world [mm]",
        "s followed",
    ]
    how = f"`footfall eval tracker --only {args.only}`" if args.only else "`footfall eval tracker`"
    title = (
        f"### Recorded motions followed in physics ({how}, told: {args.mask}; {samples / 1e6:.1f} M samples)"
    )
    goal = "A clip counts as followed while its joints are less than 0.5 m from the reference, on average."
    return f"{title}\n\n{goal}\n\n{table(['clips', 'number', *names], rows)}"


def _film(path: Path, model, config, library: MotionLibrary, clips: np.ndarray) -> None:
    """Film simulated people, each with their reference on the next lane."""
    from .motion_film import draw_strips, film

    env = TrackerEnv(config, library, len(clips))
    ids = np.arange(len(clips))
    env.place(ids, clips, np.zeros(len(clips), dtype=np.intp))
    frames = []
    for _ in range(int(library.lengths[clips].max()) - 1):
        frames.append(np.concatenate([env.world.positions, env.world.quaternions], axis=-1))
        env.advance(model.act(torch.from_numpy(env.observe())).numpy())
        env.hold_at_end()
    simulated = np.array(frames, dtype=np.float32)  # (T, n, 24, 7)
    states = []
    for i, clip in enumerate(clips):
        length = int(library.lengths[clip])
        start = int(library.starts[clip])
        states += [simulated[: length - 1, i], library.states[0, start : start + length - 1, :, :7]]
    draw = draw_strips if path.suffix == ".png" else film
    draw(path, states, library.bodies[0], library.rate_hz)
