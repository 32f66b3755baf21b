"""Unicycle dynamics: actions (acceleration, yaw rate) to states (x, y, heading, speed) and back.

Integration is semi-implicit: speed and heading are updated first, then the position moves along the new
heading,

    v' = v + a dt,   theta' = theta + w dt,   p' = p + v' (cos theta', sin theta') dt.

The inverse is then exact for any positions that a bounded unicycle can follow, which a mid-point rule is
not (its speeds ring). All sums over time are parallel (`cumsum`).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True)
class UnicycleLimits:
    """Bounds of the actions: acceleration [m/s^2] and yaw rate [rad/s] of a person.

    People turn on the spot: at 4 rad/s the unicycle could not follow simulated crowds (the histogram of their
    accelerations moved by 0.009 m/s^2, as far as a good model is from the data), at 8 rad/s it can (0.002).
    """

    acceleration: tuple[float, float] = (-10.0, 8.0)
    yaw_rate: float = 8.0


LIMITS = UnicycleLimits()


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi)."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def rollout(state: Tensor, actions: Tensor, dt: float, limits: UnicycleLimits = LIMITS) -> Tensor:
    """States that follow from bounded actions.

    Args:
        state: (..., 4) current x, y [m], heading [rad], speed [m/s], any frame.
        actions: (..., T, 2) acceleration [m/s^2] and yaw rate [rad/s]; clipped to the limits.
        dt: Step [s].
        limits: Bounds of the actions.

    Returns:
        (..., T, 4) states after each action, in the frame of `state`.
    """
    return _Rollout.apply(state, actions, dt, limits)


class _Rollout(torch.autograd.Function):
    """The rollout with its gradient written out: guidance takes it hundreds of times a plan."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, actions: Tensor, dt: float, limits: UnicycleLimits) -> Tensor:
        low, high, step = _constants(limits, dt, actions.dtype, actions.device)
        bounded = actions.clamp(low, high)
        rates = torch.cumsum(bounded, -2) * step + state[..., [3, 2]].unsqueeze(-2)
        speed, heading = rates.unbind(-1)
        cos, sin = heading.cos(), heading.sin()
        moved = torch.stack([speed * cos, speed * sin], -1)
        positions = torch.cumsum(moved, -2) * step + state[..., :2].unsqueeze(-2)
        ctx.save_for_backward(actions, speed, cos, sin)
        ctx.constants, ctx.state_shape = (low, high, step), state.shape
        return torch.cat([positions, rates.flip(-1)], -1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        actions, speed, cos, sin = ctx.saved_tensors
        (grad,) = grads
        ahead = _sum_ahead(grad[..., :2])  # what all later positions make of a displacement
        x, y = ahead.unbind(-1)
        low, high, step = ctx.constants
        by_speed = grad[..., 3] + (cos * x + sin * y) * step
        by_heading = grad[..., 2] + (cos * y - sin * x) * speed * step
        by_rates = _sum_ahead(torch.stack([by_speed, by_heading], -1))
        by_actions = by_rates * step * ((actions >= low) & (actions <= high))
        by_state = None
        if ctx.needs_input_grad[0]:
            by_state = torch.cat([ahead, by_rates.flip(-1)], -1)[..., 0, :].sum_to_size(ctx.state_shape)
        return by_state, by_actions, None, None


@lru_cache(maxsize=8)
def _constants(
    limits: UnicycleLimits, dt: float, kind: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor, Tensor]:
    """Lower and upper bounds (2,) of actions, and the step: a number would be made a tensor at every use."""
    low, high = limits.acceleration
    bounds = [[low, -limits.yaw_rate], [high, limits.yaw_rate]]
    lowest, highest = torch.tensor(bounds, dtype=kind, device=device)
    return lowest, highest, torch.tensor(dt, dtype=kind, device=device)


def _sum_ahead(x: Tensor) -> Tensor:
    """Sums (..., T, 2) over the present and all later times."""
    total = torch.cumsum(x, -2)
    return x - total + total[..., -1:, :]


def headings_along(positions: Tensor, dt: float, initial: Tensor | None = None, slow: float = 0.1) -> Tensor:
    """Heading of a walking person from positions: the direction of motion, held while slower than `slow`.

    Args:
        positions: (..., T, 2) [m].
        dt: Step [s].
        initial: (...,) heading before the first step [rad]; by default the first direction walked.
        slow: Speed below which the direction of motion is noise [m/s].

    Returns:
        (..., T) headings [rad], continuous in time (not wrapped); the first equals `initial` where that is
        given.
    """
    step = positions[..., 1:, :] - positions[..., :-1, :]  # (..., T-1, 2)
    direction = torch.atan2(step[..., 1], step[..., 0])
    moving = step.norm(dim=-1) >= slow * dt
    frames = torch.arange(1, positions.shape[-2], device=positions.device)
    last = torch.cummax(
        torch.where(moving, frames, torch.zeros_like(frames)), -1
    ).values  # 0: has not moved yet
    first = torch.where(moving.any(-1), moving.to(torch.int8).argmax(-1), 0)
    start = direction.gather(-1, first[..., None])[..., 0] if initial is None else initial
    held = direction.gather(-1, (last - 1).clamp(min=0))
    held = torch.where(last > 0, held, start[..., None])
    heading = torch.cat([start[..., None], held], -1)
    turns = wrap_angle(heading[..., 1:] - heading[..., :-1])
    return torch.cat([start[..., None], start[..., None] + torch.cumsum(turns, -1)], -1)


def fit_actions(
    state: Tensor, positions: Tensor, dt: float, limits: UnicycleLimits = LIMITS, slow: float = 0.1
) -> Tensor:
    """Inverse dynamics: the bounded actions that follow observed positions.

    Each step aims from where the unicycle *is* to the next observed position, so that whatever the limits
    cut off is caught up later instead of adding up. Unbounded parts are reproduced exactly.

    Args:
        state: (..., 4) current x, y, heading, speed.
        positions: (..., T, 2) observed future positions, same frame [m].
        dt: Step [s].
        limits: Bounds of the actions.
        slow: Below this speed the heading is held [m/s].

    Returns:
        (..., T, 2) acceleration [m/s^2] and yaw rate [rad/s].
    """
    here, heading, speed = state[..., :2], state[..., 2], state[..., 3]
    actions = []
    for target in positions.unbind(-2):
        step = target - here
        turn = wrap_angle(torch.atan2(step[..., 1], step[..., 0]) - heading) / dt
        turn = torch.where(step.norm(dim=-1) < slow * dt, torch.zeros_like(turn), turn)
        turn = turn.clamp(-limits.yaw_rate, limits.yaw_rate)
        heading = heading + turn * dt
        forward = torch.stack([torch.cos(heading), torch.sin(heading)], -1)
        acceleration = (((step * forward).sum(-1) / dt - speed) / dt).clamp(*limits.acceleration)
        speed = speed + acceleration * dt
        here = here + speed[..., None] * forward * dt
        actions.append(torch.stack([acceleration, turn], -1))
    return torch.stack(actions, -2)
