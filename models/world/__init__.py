"""One MuJoCo world of many people."""

from .world import Mode, World, WorldError

__all__ = [
    "Mode",
    "World",
    "WorldError",
]
