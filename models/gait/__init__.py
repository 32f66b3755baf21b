"""A kinematic walk for crowds: footsteps, poses, closed-form legs."""

from .gait import Command, Gait, GaitError, flat_ground

__all__ = [
    "Command",
    "Gait",
    "GaitError",
    "flat_ground",
]
