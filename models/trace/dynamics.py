"""Unicycle dynamics: actions (acceleration, yaw rate) to states (x, y, heading, speed) and back.

Integration is semi-implicit: speed and heading are updated first, then the position moves along the new
heading,

    v' = v + a dt,   theta' = theta + w dt,   p' = p + v' (cos theta', sin theta') dt.

The inverse is then exact for any positions that a bounded unicycle can follow, which a mid-point rule is
not (its speeds ring). All sums over time are parallel (`cumsum`).
"""

from dataclasses import dataclass

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
    acceleration = actions[..., 0].clamp(*limits.acceleration)
    yaw_rate = actions[..., 1].clamp(-limits.yaw_rate, limits.yaw_rate)
    speed = state[..., 3:4] + torch.cumsum(acceleration, -1) * dt
    heading = state[..., 2:3] + torch.cumsum(yaw_rate, -1) * dt
    x = state[..., 0:1] + torch.cumsum(speed * torch.cos(heading), -1) * dt
    y = state[..., 1:2] + torch.cumsum(speed * torch.sin(heading), -1) * dt
    return torch.stack([x, y, heading, speed], -1)


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
