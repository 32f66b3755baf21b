"""The pace of a distilled network's crowd, which learning path by path leaves a little low.

Errors of single paths weigh alike whoever makes them, and an hour of training moves the mean speed of a crowd by
some millimetres a second either way, which is more than few and many steps differ in otherwise. One number, a
constant in all accelerations that are predicted, sets it to that of all 100 steps.
"""

from collections.abc import Callable
from copy import deepcopy
from typing import cast

import torch
from torch import Tensor

from .evaluation import Progress, TrialScenes, plan_each, unwatched
from .network import Trace
from .planner import TracePlanner

_TRIAL = 2e-3  # m/s^2, with which its effect is measured

PlannerOf = Callable[[Trace], TracePlanner]


def hastened(trace: Trace, by: float) -> Trace:
    """A copy that predicts accelerations higher by so much [m/s^2]."""
    copy = deepcopy(trace)
    bias = cast(Tensor, copy.unet.head[-1].bias)  # of `fold` frames, two actions each
    with torch.no_grad():
        bias[0::2] += by / copy.trajectory_std[4]
    return copy


def mean_speed(
    planner: TracePlanner,
    scenes: TrialScenes,
    workers: int = 1,
    progress: Progress = unwatched,
) -> float:
    """Of all futures of everybody in these scenes, without objectives [m/s]."""
    total, count = 0.0, 0
    for done, (_, plan) in enumerate(plan_each(planner, scenes, workers=workers), 1):
        total, count = total + float(plan.speeds.sum()), count + plan.speeds.size
        progress(done, len(scenes))
    return total / count


def kept_pace(
    trace: Trace, planner_of: PlannerOf, wanted: float, scenes: TrialScenes, workers: int = 1
) -> tuple[Trace, dict[str, float]]:
    """The network with the pace that is wanted, by a secant step.

    Args:
        trace: Distilled.
        planner_of: Its planner.
        wanted: `mean_speed` of all steps in the same scenes [m/s].
        scenes: Without the ones that judge it.
        workers: Scenes planned at a time.

    Returns:
        The network, and what was found: `before` and `after` [m/s] and `acceleration` [m/s^2].

    Raises:
        ValueError: When the pace does not follow accelerations.
    """

    def speed(by: float) -> float:
        return mean_speed(planner_of(hastened(trace, by)), scenes, workers)

    before = speed(0.0)
    gain = (speed(_TRIAL) - before) / _TRIAL
    if not gain > 0:
        raise ValueError(f"the crowd walks {before:.4f} m/s, and no faster with higher accelerations")
    by = (wanted - before) / gain
    return hastened(trace, by), {"before": before, "after": speed(by), "wanted": wanted, "acceleration": by}
