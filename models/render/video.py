"""Writes pictures as an MP4 film, or as an animated GIF."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gl import RenderError

_FILM: dict[str, Any] = {"codec": "libx264", "quality": 8, "macro_block_size": 2}
_PALETTE = (
    "split[a][b];[a]palettegen=max_colors=128:stats_mode=full[p];"
    "[b][p]paletteuse=dither=none:diff_mode=rectangle"  # dots of a dither would change from frame to frame
)
_GIF: dict[str, Any] = {
    "codec": "gif",
    "quality": None,
    "macro_block_size": 2,
    "pix_fmt_out": "pal8",
    "output_params": ["-filter_complex", _PALETTE, "-loop", "0"],
}


def write_video(
    path: Path | str,
    frames: Iterable[NDArray[np.uint8]],
    rate_hz: float,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Write frames as H.264, or as a GIF of 128 colours, with the ffmpeg that imageio-ffmpeg brings.

    Args:
        path: the film, overwritten if it is there; `.gif` makes a GIF that repeats for ever.
        frames: each (height, width, 3) sRGB, all of one size, both sides even.
        rate_hz: frames per second.
        progress: called after each frame with the number written so far.

    Returns:
        The number of frames written.

    Raises:
        RenderError: no frame, an odd or changing size, no such folder, or imageio-ffmpeg is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise RenderError("Films need imageio-ffmpeg: pip install 'footfall[sim]'.") from error
    path = Path(path)
    if not path.parent.is_dir():
        raise RenderError(f"There is no folder {path.parent} to write {path.name} into.")
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise RenderError(f"{path} would be a film without a frame.")
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise RenderError(f"A film's width and height must be even, not {width} x {height} pixels.")
    options: dict[str, Any] = {"fps": rate_hz} | (_GIF if path.suffix.lower() == ".gif" else _FILM)
    writer = imageio_ffmpeg.write_frames(str(path), (width, height), **options)
    writer.send(None)
    count = 0
    try:
        for frame in chain([first], stream):
            if frame.shape != first.shape:
                raise RenderError(f"Frame {count} has shape {frame.shape}, the first one {first.shape}.")
            writer.send(np.ascontiguousarray(frame))
            count += 1
            if progress:
                progress(count)
    finally:
        writer.close()
    return count
