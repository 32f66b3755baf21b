"""`footfall motion`: make a library of motions, look into it, and film it.

footfall motion retarget --data FOLDER --out motions.npz
    footfall motion info motions.npz
    footfall motion film motions.npz cmu_07_01 --out walk.mp4
"""

import argparse
import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np

from ..models.body import describe, shape_for
from ..models.motion.augment import augment
from ..models.motion.catalogue import Entry, data_folder, read_catalogue
from ..models.motion.clip import Clip
from ..models.motion.library import MotionLibrary, body_states, load_clips
from ..models.motion.quality import measure
from ..models.motion.recording import MotionFormatError
from ..models.motion.retarget import retarget

_SKATE, _JUMP = 0.2, 40.0  # m/s and rad/s: clips beyond are left out


class MotionError(ValueError):
    """A clip that is not in the library, or a library without clips."""


def add_parser(subparsers) -> None:
    """Add `motion` to the command line."""
    parser = subparsers.add_parser("motion", help="motion libraries: retarget, info, film")
    verbs = parser.add_subparsers(required=True)

    verb = verbs.add_parser("retarget", help="carry recorded motions over to a body")
    verb.add_argument("--data", type=Path, help="folder of recordings (default $FOOTFALL_DATA)")
    verb.add_argument("--out", type=Path, default=Path("data/motions.npz"))
    verb.add_argument("--stature", type=float, default=1.75, help="m (default %(default)s)")
    verb.add_argument("--mass", type=float, default=75.0, help="kg (default %(default)s)")
    verb.add_argument("--actuation", choices=("lite", "full"), default="lite")
    verb.add_argument("--all", action="store_true", help="not only walking and running on level ground")
    verb.add_argument("--plain", action="store_true", help="no mirror images, no walks bent on to arcs")
    verb.set_defaults(run=run_retarget)

    verb = verbs.add_parser("info", help="speed, turning and quality of every clip")
    verb.add_argument("library", type=Path)
    verb.set_defaults(run=run_info)

    verb = verbs.add_parser("film", help="film clips side by side (.mp4), or draw them as strips (.png)")
    verb.add_argument("library", type=Path)
    verb.add_argument("clips", nargs="*", help="names (default: six across the library)")
    verb.add_argument("--out", type=Path, default=Path("motion.mp4"))
    verb.set_defaults(run=run_film)


def run(args: argparse.Namespace) -> int:
    """Dispatch; each verb sets its own `run`."""
    return args.run(args)


def run_retarget(args: argparse.Namespace) -> int:
    """Read, retarget, judge and augment all clips of a data folder."""
    body = describe(shape_for(args.stature, args.mass))
    entries = [e for e in read_catalogue(data_folder(args.data)) if e.locomotion or args.all]
    clips = []
    for entry in entries:
        clip = _try(entry, body, args.actuation)
        if clip is not None:
            clips.append(clip)
    if not clips:
        raise MotionError("none of the recordings could be used")
    whole = clips if args.plain else augment(clips, body)
    library = MotionLibrary(whole, [body])
    library.save(args.out)
    print(
        f"{args.out}: {len(clips)} recorded clips, {len(library)} with augmentation, "
        f"{library.duration / 60:.1f} min"
    )
    return 0


def _try(entry: Entry, body, actuation) -> Clip | None:
    try:
        clip = retarget(entry.read(), body, actuation)
    except MotionFormatError as error:
        print(f"left out: {error}", file=sys.stderr)
        return None
    clip.tags.update(description=entry.description)
    quality = measure(clip, body)
    if quality.skate_median > _SKATE or quality.joint_speed_max > _JUMP:
        print(
            f"left out: {entry.name} skates at {quality.skate_median:.2f} m/s or turns a joint at "
            f"{quality.joint_speed_max:.0f} rad/s",
            file=sys.stderr,
        )
        return None
    return Clip(entry.name, clip.rate_hz, clip.root, clip.joints, clip.contacts, clip.tags)


def run_info(args: argparse.Namespace) -> int:
    """Print one line a clip, then medians."""
    clips, bodies = load_clips(args.library)
    print(
        f"{'clip':<26} {'s':>5} {'m/s':>6} {'deg/s':>6} {'skate':>6} {'p95 m/s':>8} {'roll deg':>9} "
        f"{'sink mm':>8} {'hover mm':>9} {'limits %':>9} {'rad/s':>6}"
    )
    rows = []
    for clip in clips:
        quality = measure(clip, bodies[0])
        rows.append(astuple(quality))
        print(
            f"{clip.name:<26} {clip.duration:5.1f} {clip.speed:6.2f} {np.degrees(clip.turn_rate):6.1f} "
            f"{quality.skate_median:6.3f} {quality.skate_p95:8.3f} {quality.roll_p95_deg:9.1f} "
            f"{1e3 * quality.sink_max:8.1f} {1e3 * quality.hover_max:9.1f} {100 * quality.limit_share:9.2f} "
            f"{quality.joint_speed_max:6.1f}"
        )
    table = np.array(rows)
    if table.size:
        for name, figures in (("median", np.nanmedian(table, 0)), ("worst", np.nanmax(table, 0))):
            skate, p95, roll, sink, hover, limits, speed, _ = figures
            print(
                f"{name:<46} {skate:6.3f} {p95:8.3f} {roll:9.1f} {1e3 * sink:8.1f} {1e3 * hover:9.1f} "
                f"{100 * limits:9.2f} {speed:6.1f}"
            )
    return 0


def run_film(args: argparse.Namespace) -> int:
    """Film clips side by side, each around its own line, or draw them as strips."""
    from .motion_film import draw_strips, film

    clips, bodies = load_clips(args.library)
    known = {clip.name: clip for clip in clips}
    missing = [name for name in args.clips if name not in known]
    if missing:
        raise MotionError(
            f"there is no clip {missing[0]!r} in {args.library}; `footfall motion info` lists them"
        )
    chosen = [known[name] for name in args.clips] or clips[:: max(len(clips) // 6, 1)][:6]
    states = [body_states(clip, bodies[0]) for clip in chosen]
    draw = draw_strips if args.out.suffix == ".png" else film
    draw(args.out, states, bodies[0], chosen[0].rate_hz)
    print(f"{args.out}: {', '.join(clip.name for clip in chosen)}")
    return 0
