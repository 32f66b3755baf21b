"""Finds a way to draw without a display: EGL, else OSMesa."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import Any, Literal

GlBackend = Literal["egl", "osmesa"]

_PROBE = """
import os
os.environ["MUJOCO_GL"] = {backend!r}
import mujoco
from mujoco.{backend} import GLContext
context = GLContext(8, 8)
context.make_current()
mujoco.MjrContext(mujoco.MjSpec().compile(), mujoco.mjtFontScale.mjFONTSCALE_100).free()
context.free()
"""
_PROBE_TIMEOUT = 60.0  # s; the first software-rendered context of a cold machine is slow


class RenderError(RuntimeError):
    """Nothing can be drawn here."""


@functools.cache
def find_gl_backend() -> GlBackend:
    """Return the first backend that draws, tried in a process of its own since a failed try is hard to undo.

    MUJOCO_GL, where set to ``egl`` or ``osmesa``, decides alone.

    Raises:
        RenderError: neither works; says what to install.
    """
    wish = os.environ.get("MUJOCO_GL", "").lower()
    backends: list[GlBackend] = ["egl", "osmesa"]
    tried: list[GlBackend] = [backend for backend in backends if backend == wish] or backends
    for backend in tried:
        if _draws(backend):
            return backend
    raise RenderError(
        f"Cannot draw off screen with {' or '.join(tried)}. On Debian or Ubuntu, "
        "`apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri` provides EGL and "
        "`apt-get install libosmesa6` OSMesa; either will do."
    )


def create_context(width: int, height: int) -> Any:
    """Return MuJoCo's off-screen OpenGL context of that size, px, already current.

    Raises:
        RenderError: no backend draws.
    """
    backend = find_gl_backend()
    os.environ["MUJOCO_GL"] = backend  # read again when MuJoCo loads OpenGL's functions
    if backend == "egl":
        from mujoco.egl import GLContext
    else:
        from mujoco.osmesa import GLContext
    context = GLContext(width, height)
    context.make_current()
    return context


def _draws(backend: GlBackend) -> bool:
    environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE.format(backend=backend)],
            env=environment,
            capture_output=True,
            timeout=_PROBE_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0
