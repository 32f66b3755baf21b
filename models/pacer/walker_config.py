"""Settings of the walker; named configurations."""

from __future__ import annotations

from dataclasses import dataclass, field

from .batch_world import Physics
from .courses import CourseSettings
from .learning_config import PAPER_LEARNING, LearningConfig
from .local_map import COMPACT_MAP, MapSettings
from .path_follower import FollowerLimits
from .paths import PathSettings


@dataclass(frozen=True)
class WalkerRewards:
    """Weight and sharpness of each term of the reward, ``weight * exp(-sharpness * error)``; SI units."""

    path: tuple[float, float] = (0.20, 8.0)
    """Squared distance from the path, m^2 (PACER, app. B.2, where the sharpness is 2)."""
    place: tuple[float, float] = (0.10, 20.0)
    """Squared distance of the pelvis from the gait's, m^2."""
    upright: tuple[float, float] = (0.10, 8.0)
    """Squared angle between the pelvis and the gait's, rad^2."""
    joints: tuple[float, float] = (0.15, 20.0)
    """Mean squared distance of the hinges from the gait's, rad^2."""
    velocity: tuple[float, float] = (0.10, 2.0)
    """Squared difference of the pelvis' velocity from the gait's, m^2/s^2, and (x 0.1) its spin, rad^2/s^2."""
    contacts: tuple[float, float] = (0.05, 3.0)
    """Share of heels and balls that stand when they should not or hang when they should stand."""
    skate: tuple[float, float] = (0.20, 8.0)
    """Mean speed of sole points that touch the ground, m/s."""
    effort: tuple[float, float] = (0.05, 0.12)
    """Mechanical power of the drives per body mass, W/kg (PACER's energy penalty, app. B.2)."""
    calm: tuple[float, float] = (0.05, 2.0)
    """Mean squared change of the action per step."""


@dataclass(frozen=True)
class StyleConfig:
    """The adversarial motion prior (AMP, Peng et al. 2021; PACER, app. B)."""

    weight: float = 0.0
    """Share of the style reward in the whole; 0 leaves the discriminator out."""
    window: int = 10
    """Steps it sees."""
    hidden: tuple[int, ...] = (256, 128)
    rate: float = 1e-4
    gradient_penalty: float = 5.0
    """On motion capture."""
    logit_cost: float = 0.01
    """Of the last layer's squared weights."""
    weight_decay: float = 1e-4
    batch: int = 512
    """Windows of each kind per step, of all processes: motion capture, new, remembered."""
    steps: int = 2
    """Descent steps per update."""
    memory: int = 50_000
    """Windows of the walker that are remembered."""


@dataclass(frozen=True)
class WalkerConfig(LearningConfig):
    """Environment, networks and learning of the walker."""

    worlds: int = 256
    people: int = 32
    """Different bodies among the worlds."""
    physics: Physics = field(default_factory=Physics)
    rewards: WalkerRewards = field(default_factory=WalkerRewards)
    style: StyleConfig = field(default_factory=StyleConfig)
    paths: PathSettings = field(
        default_factory=lambda: PathSettings(duration=16.0, vertices=161, speed_range=(0.0, 2.2))
    )
    course: CourseSettings | None = None
    """Ground to walk on; None is level and empty."""
    map: MapSettings | None = None
    """What is seen of the surroundings; None is nothing."""
    limits: FollowerLimits = field(default_factory=FollowerLimits)
    easy_paths: PathSettings = field(
        default_factory=lambda: PathSettings(
            duration=16.0,
            vertices=161,
            turn_rate=0.4,
            sharp_turn=0.0,
            acceleration=0.4,
            speed_range=(0.9, 1.5),
        )
    )
    """Paths to begin with; they widen to `paths` as fewer episodes fail."""
    first_difficulty: float = 0.0
    """How far from `easy_paths`, 0, to `paths`, 1, training begins."""
    widen_below: float = 0.15
    """Failures per s below which paths get harder and pushes stronger."""
    widening: float = 0.02
    """By how much of the whole, per update."""
    standing: float = 0.25
    """Share of episodes that begin at rest."""
    company: int = 1
    """People who begin near each other, see each other and give way; they do not touch, but fail if they would."""
    manners: bool = True
    """Whether followers go round obstacles and others."""
    body_aware: bool = True
    """Whether gait and policy know the body, or take everybody for average (PACER, table 9)."""
    action_scale: float = 0.4
    """rad of PD target per unit of action."""
    arms: bool = False
    """Whether actions move the arms, too; otherwise they swing as the gait says."""
    lead: float = 0.1
    """s: PD targets run ahead of the gait by this times its rates: the legs' kd / kp, and what control lags behind."""
    lost: float = 2.0
    """m from the path at which an episode fails in training; PACER has 4 m, and learns slower for it."""
    episode: int = 300
    """Control steps: 10 s."""
    push_interval: float = 4.0
    """s between pushes, on average; 0 for none."""
    push_force: float = 200.0
    """N at most, sideways or along, for 0.2 s on the chest."""


_LEVEL_COURSE = CourseSettings(levels=2, columns=4, tile=10.0, kinds=("flat", "obstacles"))
_SMALL_COURSE = CourseSettings(levels=8, columns=9, tile=10.0, border=18.0, cell=0.05)

CONFIGS: dict[str, WalkerConfig] = {
    "compact": WalkerConfig(course=_LEVEL_COURSE, company=4, noise=0.12),
    "compact_terrain": WalkerConfig(
        course=_SMALL_COURSE,
        map=COMPACT_MAP,
        company=4,
        noise=0.12,
        horizon=64,
        minibatch=4096,
        discount=0.98,
        first_difficulty=0.5,
        push_interval=8.0,
        widen_below=0.045,
        widening=0.004,
        lost=4.0,
    ),
    "paper": WalkerConfig(
        worlds=2048,
        people=473,
        physics=Physics(actuation="full"),
        style=StyleConfig(weight=0.5, hidden=(2048, 1024), gradient_penalty=5.0, batch=4096, memory=200_000),
        arms=True,
        paths=PathSettings(duration=16.0, vertices=161),
        course=CourseSettings(columns=20, border=50.0),
        map=MapSettings(),
        company=8,
        lost=4.0,
        **PAPER_LEARNING,
    ),
}
"""``compact``: level ground, half of it with obstacles.
``compact_terrain``: goes on from ``compact`` on slopes and stairs; as falls are rare by then, it looks at four times
as many samples before it changes anything, and farther ahead.
``paper``: PACER's body, networks, numbers of bodies and PPO settings (app. B)."""
