"""Settings of the motion tracker; named configurations, one an even trade for two CPU cores."""

from __future__ import annotations

from dataclasses import dataclass, field

from .batch_world import Physics
from .learning_config import PAPER_LEARNING, LearningConfig


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
class TrackerConfig(LearningConfig):
    """Environment, network and learning of the tracker."""

    worlds: int = 512
    physics: Physics = field(default_factory=Physics)
    rewards: RewardTerms = field(default_factory=RewardTerms)
    lookahead: tuple[int, ...] = (1, 6)
    """Frames ahead whose reference is observed."""
    action_scale: float = 0.4
    """rad of PD target per unit of action."""
    lead: float = 1.0
    """PD targets run ahead of the reference by this times its velocity times kd / kp of each hinge's drive: by 1, so
    that damping does not hold a moving joint back."""
    lost: float = 0.35
    """m: mean distance of tracked joints from the reference at which an episode fails."""
    episode: int = 240
    """Control steps after which an episode is cut and the next begun elsewhere."""
    masked: float = 0.0
    """Share of episodes in which only part of the body is told (PACER+, sec 3.2)."""
    noise: float = 0.18
    epochs: int = 3
    minibatch: int = 2048
    target_kl: float = 0.015
    narrow_start: int = 8
    """Clips to begin with: those nearest to a straight walk at 1.25 m/s."""
    widen_below: float = 0.2
    """Share of failing episodes below which more clips join."""


CONFIGS: dict[str, TrackerConfig] = {
    "compact": TrackerConfig(),
    "paper": TrackerConfig(
        worlds=2048,
        physics=Physics(actuation="full"),
        **PAPER_LEARNING,
    ),
}
"""``paper``: PACER's body, networks and PPO settings (app. B; its public configuration)."""
