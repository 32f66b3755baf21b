"""Where and when feet step: a stride clock that can stop, footholds on the coming path, arcs between them.

A foot that stands keeps its place in the world to the last digit; the root moves over it. The place of the
next landing is where the root will be when the hip passes over that foot, read off the present speed,
acceleration and turn; on stairs the foot is shifted so as to stand on one tread.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import norms
from .footholds import HALF_WIDTH, STEEPEST, HeightAt, settle, step_up
from .norms import smoothstep
from .state import State

Array = NDArray[np.float64]
_SIDES = np.array([1.0, -1.0])
_OFFSETS = np.array([0.0, 0.5])  # phase of the left and the right foot
_START_DISTANCE, _START_TURN = 0.07, 0.30  # m, rad: error of a standing foot that calls for a step
_SETTLE_DISTANCE, _SETTLE_TURN = 0.03, 0.12  # and the error below which stepping ends
_WALK_SPEED = 0.06  # m/s: slower counts as standing
_FEET_APART = 0.10  # m: least lateral distance of a foothold from the other foot
_LIFT = 0.04  # share of a swing at its ends in which the foot goes only up or down
HARDEST_LEAN = 2.5
"""m/s^2: accelerations beyond are not leaned into any further."""
_QUICK = 1.2  # share by which strides are shorter on ground that rises 1 m/m
_LATE = 0.1  # share of a swing at its end in which a foot on its way to a lower tread only sinks
_ABREAST = np.linspace(-0.2, 0.2, 9)  # m: where edges are looked for beside the root
_TILTED = 0.3  # rise over run that ground with an edge beside the root counts as, at most
_RISE_PER_STEP = 0.19  # m: a tall tread
_PATH = np.linspace(0.2, 0.9, 8)  # shares of a swing at which it must clear the ground


def foot_phases(s: State) -> Array:
    """Phase (n, 2), [0, 1), of the left and the right foot since each was due to land."""
    return (s["phase"][:, None] + _OFFSETS) % 1.0


def stride(s: State) -> tuple[Array, Array]:
    """Duration (n,) in s of the present stride and the share (n,) of it a foot stands."""
    leg = -s["thigh"][:, 0, 2] - s["shank"][:, 0, 2]
    duration = norms.stride_duration(s["speed"], leg)
    # Small steps about one place, and steps that turn, are quick ones: at most 75 degrees a stride.
    duration = np.minimum(duration, 1.2 + 0.7 * smoothstep(s["speed"] / 0.5))
    duration = np.minimum(duration, np.maximum(1.3 / np.maximum(np.abs(s["turn_rate"]), 0.1), 0.6))
    # Up and down steps are shorter, and on stairs climb one tread rather than two.
    climb = np.maximum(s["grade"] * s["speed"], 1e-3)
    duration = duration / (1.0 + _QUICK * s["grade"])
    duration = np.minimum(duration, np.maximum(2.0 * _RISE_PER_STEP / climb, 0.6))
    return duration, norms.stance_share(s["speed"], duration)


def stand(s: State, position: Array, heading: Array, speed: Array, height_at: HeightAt) -> None:
    """Put both feet of every row under a root that moves at ``speed``, as if it had walked there."""
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    s["position"], s["velocity"], s["speed"] = position, speed[:, None] * direction, speed
    s["acceleration"] = s["turn_rate"] = 0.0
    duration, support = stride(s)
    moving = speed > _WALK_SPEED
    s["held"] = ~moving
    s["vigour"] = np.where(moving, norms.vigour(speed), 0.0)
    s["phase"] = np.where(moving, s["phase"], support) % 1.0
    psi = foot_phases(s)
    s["planted"] = psi < support[:, None] + 1e-6 * s["held"][:, None]
    swing = np.clip((psi - support[:, None]) / (1.0 - support[:, None]), 0.0, 1.0)
    s["swing"] = np.where(s["planted"], 0.0, swing)

    stood = np.minimum(psi, support[:, None]) - norms.CROSSING * support[:, None]
    behind = np.where(moving, speed * duration, 0.0)[:, None] * stood
    goal = _goals(s, position[:, None] - behind[..., None] * direction[:, None], heading[:, None] + 0.0 * psi)
    s["goal"], s["shift"] = goal, 0.0
    feet = np.nonzero(np.ones(psi.shape, dtype=bool))
    s["place"] = s["left_from"] = s["target"] = settle(s, feet, height_at).reshape(*psi.shape, 6)
    s["landing"] = s["crouch"] = 0.0
    if not s["planted"].all():
        _aim(s, heading, psi, duration, support, height_at)
    s["roll"] = profile_roll(s)
    s["roll_off"] = norms.TOE_OFF_PITCH * s["vigour"][:, None]


def advance(
    s: State,
    position: Array,
    heading: Array,
    speed: Array,
    turn_rate: Array,
    dt: float,
    height_at: HeightAt,
) -> None:
    """Move the feet of every row on by ``dt`` s, given where the root is now and how fast it wants to go."""
    _track(s, position, speed, turn_rate, dt)
    _look_ahead(s, heading, dt, height_at)
    duration, support = stride(s)
    due = _advance_clock(s, heading, (speed > _WALK_SPEED) | (np.abs(turn_rate) > 0.2), duration, support, dt)
    psi = foot_phases(s)

    landed = ~s["planted"] & (psi < np.minimum(support, 0.25)[:, None])
    s["place"][landed] = s["target"][landed]
    s["planted"] |= landed
    s["planted"] &= ~due
    s["left_from"][due] = s["place"][due]
    toe_off = norms.TOE_OFF_PITCH * s["vigour"][:, None]
    s["roll_off"] = np.where(due, np.maximum(s["roll"], toe_off), s["roll_off"])
    s["swing"][due] = 0.0

    swinging = ~s["planted"]
    progress = np.clip((psi - support[:, None]) / (1.0 - support[:, None]), 0.0, 1.0)
    s["swing"] = np.where(swinging, np.maximum(s["swing"], progress), 0.0)
    wanted = np.where(s["held"], 0.0, np.maximum(norms.vigour(s["speed"]), 0.25))
    s["vigour"] += (wanted - s["vigour"]) * (1.0 - np.exp(-dt / 0.15))
    if swinging.any():
        _aim(s, heading, psi, duration, support, height_at)
        _swing(s, swinging, height_at)
    s["roll"] = profile_roll(s)


def _track(s: State, position: Array, speed: Array, turn_rate: Array, dt: float) -> None:
    """Smooth the root's motion: velocity from its places, the rest from the command."""
    quick, slow = 1.0 - np.exp(-dt / 0.08), 1.0 - np.exp(-dt / 0.25)
    before = np.linalg.norm(s["velocity"], axis=-1)
    s["velocity"] += quick * ((position - s["position"]) / dt - s["velocity"])
    gained = (np.linalg.norm(s["velocity"], axis=-1) - before) / dt
    s["acceleration"] += slow * (np.clip(gained, -4.0, 4.0) - s["acceleration"])
    s["turn_rate"] += quick * (turn_rate - s["turn_rate"])
    s["speed"] += quick * (speed - s["speed"])
    s["position"] = position
    s["time"] += dt


def _look_ahead(s: State, heading: Array, dt: float, height_at: HeightAt) -> None:
    """Update the steepness of the way from just behind the root to a step ahead of it, and over edges beside it."""
    here = s["position"] + s["offset"]
    xy = here + np.array([-0.1, 0.7])[:, None, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    height = height_at(xy.reshape(-1, 2)).reshape(2, -1)
    slope = (height[1] - height[0]) / 0.8
    s["climb"] += (slope - s["climb"]) * (1.0 - np.exp(-dt / 0.15))
    xy = here + _ABREAST[:, None, None] * np.stack([-np.sin(heading), np.cos(heading)], -1)
    rises = np.abs(np.diff(height_at(xy.reshape(-1, 2)).reshape(len(_ABREAST), -1), axis=0))
    tilt = np.where(rises > STEEPEST * (_ABREAST[1] - _ABREAST[0]), rises, 0.0).sum(0) / np.ptp(_ABREAST)
    change = np.maximum(np.abs(slope), np.minimum(tilt, _TILTED)) - s["grade"]
    s["grade"] += change * (1.0 - np.exp(-dt / np.where(change > 0.0, 0.15, 0.8)))


def _advance_clock(
    s: State, heading: Array, moving: NDArray[np.bool_], duration: Array, support: Array, dt: float
) -> NDArray[np.bool_]:
    """Advance the phase, or hold it while no step is called for; return the feet (n, 2) that lift now."""
    home = _goals(
        s, np.repeat(s["position"][:, None], 2, axis=1), heading[:, None] + np.zeros(2), standing=True
    )
    error = home - s["goal"]
    distance, turn = np.hypot(error[..., 0], error[..., 1]), np.abs(wrap(error[..., 2]))
    held = s["held"][:, None]
    unease = np.maximum(
        distance / np.where(held, _START_DISTANCE, _SETTLE_DISTANCE),
        turn / np.where(held, _START_TURN, _SETTLE_TURN),
    )
    go = moving | (s["speed"] > 2.0 * _WALK_SPEED) | (unease > 1.0).any(1)

    # A foot that trails farther than it should in a steady walk hurries the stride.
    usual = (1.0 - norms.CROSSING) * support * duration * s["speed"]
    back = s["position"][:, None] - s["place"][..., :2]
    trailing = (
        np.sum(back * s["velocity"][:, None], -1)
        / np.maximum(np.linalg.norm(s["velocity"], axis=-1), 1e-6)[:, None]
    )
    late = np.where(s["planted"], trailing, 0.0).max(1) - np.maximum(1.05 * usual, 0.3) - 0.03
    phase = s["phase"] + dt / duration * (1.0 + 2.0 * smoothstep(late / 0.15))
    psi = (phase[:, None] + _OFFSETS) % 1.0
    due = s["planted"] & (psi >= support[:, None])
    first = np.argmax(due, axis=1)
    # The foot that is worse off starts; on a turn the inner one.
    unease = unease + 0.1 * (wrap(error[..., 2]) * _SIDES > 0.0)
    swap = s["held"] & go & (np.argmax(unease, axis=1) != first) & (s["vigour"] < 0.1)
    hold = due.any(1) & s["planted"].all(1) & ~go
    phase = np.where(hold, support - _OFFSETS[first], phase + 0.5 * swap)
    s["phase"] = phase % 1.0
    s["held"] = hold
    psi = foot_phases(s)
    return s["planted"] & (psi >= support[:, None]) & ~hold[:, None]


def _goals(s: State, root: Array, heading: Array, standing: bool = False) -> Array:
    """Places (n, 2, 3), x y yaw, of feet that carry a root at (n, 2, 2), heading (n, 2)."""
    neutral = s["hip"] + s["thigh"] + s["shank"]
    narrow = 1.0 if standing else 1.0 - 0.38 * smoothstep(s["speed"] / 0.6)[:, None]
    ahead, left = neutral[..., 0], neutral[..., 1] * narrow
    cos, sin = np.cos(heading), np.sin(heading)
    x = root[..., 0] + cos * ahead - sin * left
    y = root[..., 1] + sin * ahead + cos * left
    return np.stack([x, y, heading + norms.TOE_OUT * _SIDES], axis=-1)


def _aim(s: State, heading: Array, psi: Array, duration: Array, support: Array, height_at: HeightAt) -> None:
    """Set the next foothold of each foot that is in the air."""
    t = (1.0 - psi + norms.CROSSING * support[:, None]) * duration[:, None]
    v = np.linalg.norm(s["velocity"], axis=-1)[:, None]
    a = s["acceleration"][:, None]
    stop = np.minimum(t, v / np.maximum(-a, 1e-3))  # do not predict walking backwards
    burst = np.minimum(t, 0.35)  # nor an endless spurt
    distance = np.where(a < 0.0, v * stop + 0.5 * a * stop**2, v * t + a * burst * (t - 0.5 * burst))
    turn = np.clip(s["turn_rate"][:, None] * t, -1.2, 1.2)
    course = np.arctan2(s["velocity"][:, 1], s["velocity"][:, 0])[:, None] + 0.5 * turn
    distance = distance * np.sinc(0.5 * turn / np.pi)
    root = s["position"][:, None] + distance[..., None] * np.stack([np.cos(course), np.sin(course)], -1)
    goal = _goals(s, root, heading[:, None] + turn)
    # Feet carry a leaning body where its weight and its turning push: at the zero moment point.
    aside = (s["pelvis_height"] / norms.GRAVITY * centripetal(s))[:, None]
    goal[..., 0] += np.sin(heading[:, None] + turn) * aside
    goal[..., 1] -= np.cos(heading[:, None] + turn) * aside

    # Never step onto or across the other foot.
    yaw = heading[:, None] + turn
    other = s["place"][:, ::-1]
    left = np.cos(yaw) * (goal[..., 1] - other[..., 1]) - np.sin(yaw) * (goal[..., 0] - other[..., 0])
    out = _SIDES * np.maximum(_FEET_APART - _SIDES * left, 0.0) * s["planted"][:, ::-1]
    goal[..., 0] -= np.sin(yaw) * out
    goal[..., 1] += np.cos(yaw) * out

    air = np.nonzero(~s["planted"])
    s["goal"][air] = goal[air]
    s["target"][air] = settle(s, air, height_at)
    rise = step_up(s["left_from"][:, ::-1], s["target"])
    level = np.clip(1.0 - np.abs(rise) / 0.12, 0.0, 1.0)
    strike = norms.HEEL_STRIKE_PITCH * s["vigour"][:, None] * (1.0 - 0.7 * norms.running(s["speed"]))[:, None]
    landing = strike * level + 0.2 * smoothstep((-rise - 0.06) / 0.1)  # downstairs the ball lands first
    s["landing"][air] = landing[air]


def centripetal(s: State) -> Array:
    """Acceleration (n,), m/s^2, to the left that keeps walkers on the present bend."""
    return np.clip(s["speed"] * s["turn_rate"], -HARDEST_LEAN, HARDEST_LEAN)


def _swing(s: State, swinging: NDArray[np.bool_], height_at: HeightAt) -> None:
    """Set the places of the feet in the air: an arc from the last toe-off to the next foothold."""
    agent, foot = np.nonzero(swinging)
    start, end = s["left_from"][agent, foot], s["target"][agent, foot]
    change = end - start
    change[:, 3] = wrap(change[:, 3])
    u = s["swing"][agent, foot][:, None]
    early = np.clip(step_up(start, end)[:, None] / 0.15, -1.0, 1.0)  # up: climb early; down: sink late

    def forward(u: Array) -> Array:
        return smoothstep((u - _LIFT) / (1.0 - 2.0 * _LIFT - _LATE * np.maximum(-early, 0.0)))

    def base(u: Array) -> Array:
        up, down = smoothstep(u * (1.0 + 0.5 * early)), 1.0 - smoothstep((1.0 - u) * (1.0 - 0.25 * early))
        return start[:, 2:3] + change[:, 2:3] * np.where(early > 0.0, up, down)

    # The least arc height that clears the ground under heel, ball and tip all along the way.
    share = forward(_PATH[None])  # (k, 5)
    along = start[:, None, :2] + share[..., None] * change[:, None, :2] + s["offset"][agent][:, None]
    yaw = start[:, 3:4] + share * change[:, 3:4]
    reach = np.stack([s["heel"][agent, foot, 0], s["toe"][agent, foot, 0], s["tip"][agent, foot, 0]], -1)
    toward = np.stack([np.cos(yaw), np.sin(yaw)], -1)
    points = along[:, :, None] + reach[:, None, :, None] * toward[:, :, None]  # (k, 8, 3, 2)
    # Feet that have weight must clear what is under all their width; others may graze it.
    half = np.where(s["reach"][agent] > 0.0, 0.0, HALF_WIDTH)[:, None, None]
    aside = (half * np.stack([-toward[..., 1], toward[..., 0]], -1))[:, :, None]
    points = np.stack([points - aside, points + aside])
    slope = np.tan(start[:, 4:5] + share * change[:, 4:5])
    ground = height_at(points.reshape(-1, 2)).reshape(points.shape[:-1]).max(0)
    ground = (ground + slope[..., None] * reach[:, None]).max(-1)  # above the plane of the sole
    vigour = s["vigour"][agent]
    clearance = 0.05 - 0.02 * np.minimum(vigour, 1.0) + 0.07 * norms.running(s["speed"][agent])
    excess = (ground - base(_PATH[None])) / _bump(_PATH)
    height = clearance + np.clip(excess.max(-1), 0.0, 0.2)

    place = start + forward(u) * change
    place[:, 2] = (base(u) + height[:, None] * _bump(u))[:, 0]
    s["place"][agent, foot] = place


def _bump(u: Array) -> Array:
    """Arc over [0, 1] of height 1, flat-topped, steep where the foot leaves and meets the ground."""
    return 1.0 - (2.0 * u - 1.0) ** 4


def profile_roll(s: State) -> Array:
    """Pitch (n, 2) of the feet in rad, heel up positive, by the clock: heel, flat, ball, swing."""
    support = stride(s)[1][:, None]
    psi = foot_phases(s)
    full = norms.TOE_OFF_PITCH * s["vigour"][:, None]
    span = (1.0 - norms.HEEL_OFF) * support
    since = np.clip((psi - norms.HEEL_OFF * support) / span, 0.0, 1.0)
    stance = s["landing"] * (1.0 - smoothstep(psi / norms.FLAT_PHASE)) + full * since**2 * (1.6 - 0.6 * since)
    # In the air a cubic takes over with the pitch rate of toe-off.
    u = s["swing"]
    rate = 1.4 * full * (1.0 - support) / span
    swing = s["roll_off"] + (s["landing"] - s["roll_off"]) * smoothstep(u) + rate * u * (1.0 - u) ** 2
    return np.where(s["planted"], stance, swing)


def wrap(angle: Array) -> Array:
    """Angle in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
