"""What a motion tracker does with a clip, step by step, as takes to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ..models.motion.library import MotionLibrary
from ..models.pacer.config import TrackerConfig
from ..models.pacer.policy import ActorCritic
from ..models.pacer.tracker_env import TrackerEnv
from ..models.pacer.tracker_observation import sole_heights, standing
from .motion_take import Take


def roll_out(
    model: ActorCritic, config: TrackerConfig, library: MotionLibrary, clips: Sequence[int]
) -> list[Take]:
    """Let a tracker follow clips from their first frames to their ends, without noise.

    A take ends early where the person has fallen. Each has the clip as its reference, both foot contacts, every
    term of the reward (1 is perfect) and their weighted sum `reward`.

    Args:
        model: the tracker.
        config: settings it was trained with.
        library: the clips.
        clips: indices of those to follow.
    """
    env = TrackerEnv(replace(config, masked=0.0), library, 1)  # alone, so that means over worlds are its own
    world, person = env.world, library.bodies[0]
    soles = np.array([body.sole for body in library.bodies])
    alone = np.zeros(1, dtype=np.intp)
    takes = []
    for clip in clips:
        env.place(alone, np.array([clip]), alone)
        states, references, feet, wanted = [], [], [], []
        terms: dict[str, list[float]] = {}
        for step in range(int(library.lengths[clip])):
            if step:
                env.advance(model.act(torch.from_numpy(env.observe())).numpy())
            frame = int(env.reference.frame[0])
            states.append(np.concatenate([world.positions[0], world.quaternions[0]], axis=-1))
            references.append(library.states[0, frame])
            feet.append(standing(sole_heights(world, alone, soles))[0])
            wanted.append(library.contacts[frame])
            total, means = env.rewards(env.errors())
            for name, value in {"reward": float(total[0]), **means}.items():
                terms.setdefault(name, []).append(value)
            if env.fallen()[0]:
                break
        takes.append(
            Take(
                library.clips[clip].name,
                library.rate_hz,
                person.shape,
                np.array(states, dtype=np.float32),
                np.array(references, dtype=np.float32),
                contacts=np.array(feet),
                reference_contacts=np.array(wanted),
                terms={name: np.array(values, dtype=np.float32) for name, values in terms.items()},
            )
        )
    return takes
