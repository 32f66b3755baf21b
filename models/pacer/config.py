"""Settings of the motion tracker; named configurations, one an even trade for two CPU cores."""

from __future__ import annotations

from dataclasses import dataclass, field

from .batch_world import Physics


@dataclass(frozen=True)
class RewardTerms:
    """Weight and sharpness of each term of the tracking reward, which is at most the weights' sum, 1.

    A term is ``weight * exp(-sharpness * error)``; errors are means over what is tracked, of squares in SI
    units. After DeepMimic (Peng et al. 2018) and PACER+ (eq 3).
    """

    places: tuple[float, float] = (0.30, 60.0)
    """Joint positions from the pelvis, heading frame, m^2."""
    joints: tuple[float, float] = (0.25, 30.0)
    """Hinge angles, rad^2."""
    root: tuple[float, float] = (0.25, 12.0)
    """The pelvis' position, m^2, and (x 0.3) its rotation, rad^2."""
    root_velocity: tuple[float, float] = (0.10, 1.0)
    """The pelvis' velocity, m^2/s^2, and (x 0.1) angular velocity, rad^2/s^2."""
    joint_velocities: tuple[float, float] = (0.05, 0.5)
    """rad^2/s^2."""
    contacts: tuple[float, float] = (0.05, 3.0)
    """Share of heels and balls that stand when they should not or hang when they should stand."""


@dataclass(frozen=True)
class TrackerConfig:
    """Environment, network and learning of the tracker."""

    worlds: int = 512
    physics: Physics = field(default_factory=Physics)
    rewards: RewardTerms = field(default_factory=RewardTerms)
    lookahead: tuple[int, ...] = (1, 6)
    """Frames ahead whose reference is observed."""
    action_scale: float = 0.4
    """rad of PD target per unit of action."""
    lead: float = 0.1
    """s: PD targets run ahead of the reference by this times its velocity. It is the actuators' kd / kp, so
    that their damping does not hold a moving joint back."""
    lost: float = 0.35
    """m: mean distance of tracked joints from the reference at which an episode fails."""
    episode: int = 240
    """Control steps after which an episode is cut and the next begun elsewhere."""
    masked: float = 0.0
    """Share of episodes in which only part of the body is told (PACER+, sec 3.2)."""
    hidden: tuple[int, ...] = (512, 256)
    noise: float = 0.18
    """Standard deviation of actions while training."""
    horizon: int = 16
    """Steps of each world per update."""
    epochs: int = 3
    minibatch: int = 2048
    discount: float = 0.97
    trace_decay: float = 0.95
    """Lambda of generalised advantage estimation (Schulman et al. 2016)."""
    clip: float = 0.2
    bfloat16: bool = True
    """Whether learning multiplies matrices in bfloat16."""
    target_kl: float = 0.015
    """Divergence per update that the learning rate is held to."""
    rate: float = 3e-4
    rate_bounds: tuple[float, float] = (2e-5, 1e-3)
    narrow_start: int = 8
    """Clips to begin with: those nearest to a straight walk at 1.25 m/s."""
    widen_below: float = 0.2
    """Share of failing episodes below which more clips join."""
    seed: int = 0


CONFIGS: dict[str, TrackerConfig] = {
    "compact": TrackerConfig(),
    "paper": TrackerConfig(
        worlds=2048,
        physics=Physics(actuation="full"),
        hidden=(2048, 1024),
        noise=0.055,
        horizon=32,
        epochs=6,
        minibatch=16384,
        discount=0.99,
        bfloat16=False,
        rate=2e-5,
        rate_bounds=(2e-5, 2e-5),
    ),
}
"""``paper``: PACER's body, networks and PPO settings (app. B; its public configuration)."""
