"""Many worlds whose people walk along random paths: reset, step, reward (PACER, sec 3.2 and app. B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..body import BODY_INDEX, JOINT_GAINS, Body, describe, sample_shapes
from ..body.skeleton import GAIN_REFERENCE_MASS
from ..gait import flat_ground
from ..scene.layers import signed_distance
from .batch_world import EVERYONE, BatchWorld, BatchWorldError
from .courses import Course, make_course
from .gait_reference import GaitReference
from .local_map import draw_local_maps
from .manners import Manners
from .mathops import heading
from .paths import Paths, sample_paths, with_stops
from .starts import Starts
from .style import StyleHistory, feature_count, style_features
from .surface import seen_heights
from .walker_config import WalkerConfig
from .walker_observation import FEET, Mirror, Motion, People, clearance, driven_hinges, observe, touching
from .walker_rewards import fallen, reward_errors, slip_speed, weigh

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_JITTER = (0.02, 0.05)  # rad and rad/s: spread of initial joint angles and velocities
_STOPS = 0.2  # share of paths with a stop on the way
_STAYS = 0.3  # share of those at rest who stay there
_PUSH = 0.2  # s
_TOUCH, _TOUCH_WALL = 0.4, 0.22  # m between two pelvises, or to an obstacle: less is a collision
_CHEST = 1 + BODY_INDEX["Chest"]


@dataclass(frozen=True)
class WalkerStep:
    """What one control step brought, for N worlds."""

    observations: Floats
    """(N, size) to act on next; after the reset where an episode ended."""
    rewards: Floats
    """(N,) in [0, 1], without style."""
    failed: NDArray[np.bool_]
    """(N,) fell or left the path: the episode ends and no reward follows."""
    cut: NDArray[np.bool_]
    """(N,) the episode was cut while reward would have gone on."""
    cut_observations: Floats
    """(number of cut worlds, size): what was seen at the end of those."""
    windows: Floats
    """(N, window * F) what a discriminator sees; (N, 0) without one."""
    whole: NDArray[np.bool_]
    """(N,) whose window is whole."""
    terms: dict[str, float]
    """Mean of each reward term, between 0 and 1, and of plain measures."""


class WalkerEnv:
    """N worlds of one walker each; worlds whose episode ends begin another at once.

    An action (N, A) shifts the PD targets away from the gait's next pose; it answers the observation, and is
    a mirror image where that is one. Obstacles and others are seen and not felt: who comes too near fails.

    Args:
        config: settings.
        worlds: N; that of the settings when left out.
        bodies: who walks; drawn from the population when left out.
        seed: of all random choices.
        course: what to walk on; laid by the settings when left out.

    Raises:
        BatchWorldError: the worlds cannot be shared out evenly among companies.
    """

    def __init__(
        self,
        config: WalkerConfig,
        worlds: int | None = None,
        bodies: Sequence[Body] | None = None,
        seed: int = 0,
        course: Course | None = None,
    ):
        self.config = config
        count = worlds or config.worlds
        if count % config.company:
            raise BatchWorldError(f"{count} worlds cannot be shared out to companies of {config.company}.")
        if bodies is None:
            bodies = [describe(shape) for shape in sample_shapes(min(config.people, count), seed)]
        if course is None and config.course:
            course = make_course(config.course, seed=seed)
        self.course = course
        """What there is to walk on; None is level ground."""
        terrain = self.course.terrain if self.course and self.course.uneven else None
        obstacles = self.course.obstacles if self.course else ()
        self.world = BatchWorld(bodies, count, config.physics, terrain)
        self.people = People.of([bodies[i] for i in self.world.body_index])
        self.period = config.physics.control_period
        self.height_at = terrain.height_at if terrain else flat_ground
        self._seen_heights = seen_heights(self.height_at, obstacles)
        self._outlines = [np.asarray(obstacle.polygon, dtype=float) for obstacle in obstacles]
        self.company = np.arange(count) // config.company
        """(N,) who is near whom: worlds of one number show people to each other."""
        manners = Manners(int(self.company[-1]) + 1, obstacles) if config.manners else None
        everybody = [bodies[i] for i in self.world.body_index]
        self.reference = GaitReference(
            everybody, self.period, self.height_at, config.limits, manners, config.body_aware
        )
        self.driven = driven_hinges(self.world.hinges, config.arms)
        self.n_actions = len(self.driven)
        self.rng = np.random.default_rng(seed)
        self.paths = Paths(np.zeros((count, config.paths.vertices, 2)), config.paths.duration)
        self.mirror = Mirror(self.world.hinges, self.driven, config.map.cells if config.map else 0)
        self.mirrored = np.zeros(count, dtype=bool)
        """(N,) whose last observation, and so whose next action, is a mirror image."""
        self.difficulty = 1.0
        """From 0, easy paths and no pushes, to 1, those of the settings."""
        self.starts = Starts(self.course, self._outlines, count, config.company, self.rng)
        self.age = np.zeros(count, dtype=np.intp)
        """(N,) control steps since each episode began."""
        gains = JOINT_GAINS[self.world.hinges]
        scale = (self.people.mass / GAIN_REFERENCE_MASS)[:, None]
        self._kp, self._kd, self._cap = (gains[:, i] * scale for i in range(3))
        self._before = np.zeros((count, self.n_actions))
        self._points = np.zeros((count, 2, 5, 3))
        self.clear = np.ones((count, 2, 5))
        """(N, 2, 5) m: clearances of the sole points."""
        self._push_left = np.zeros(count, dtype=np.intp)
        self.slip = np.zeros(count)
        """(N,) m/s: mean speed of sole points that touched during the last step."""
        window = config.style.window if config.style.weight > 0 else 0
        self._history = StyleHistory(count, feature_count(len(self.world.hinges)), window)
        self._begin(np.arange(count))
        self.settle(np.arange(count))
        self.size = self.observe().shape[1]
        """How many numbers an observation has."""

    def __len__(self) -> int:
        return len(self.world)

    @property
    def times(self) -> Array:
        """(N,) s since each episode began."""
        return np.asarray(self.age * self.period, dtype=np.float64)

    @property
    def offsets(self) -> Array:
        """(N,) m: distance of each pelvis from where the path is now."""
        gap = self.motion.positions[:, 0, :2] - self.paths.at(self.times)
        return np.sqrt(np.square(gap).sum(1))

    def reset(self) -> Floats:
        """Begin an episode in every world; spread their ages so that they do not all end together."""
        everyone = np.arange(len(self))
        self._begin(everyone)
        self.settle(everyone)
        return self.observe()

    def begin(
        self, ids: NDArray[np.intp], paths: Paths, speeds: Array, headings: Array, phases: Array
    ) -> None:
        """Put people (n,) at the beginnings of paths, walking at speeds (n,), or at rest where that is 0."""
        self.paths.replace(ids, paths)
        self.age[ids] = 0
        starts = paths.vertices[:, 0]
        root, joints, twist, rates = self.reference.place(ids, starts, headings, speeds, phases)
        joints = joints + self.rng.normal(0.0, _JITTER[0], joints.shape)
        rates = rates + self.rng.normal(0.0, _JITTER[1], rates.shape)
        self.world.reset(ids, root, joints, twist, rates)
        self._before[ids] = 0.0
        self._push_left[ids] = 0
        self.world.forces[ids] = 0.0

    def observe(self) -> Floats:
        """Observations (N, size) of the present state, in a mirror where the right foot leads."""
        follower, times = self.reference.follower, self.times
        waypoints = follower.told(self.paths.at(times), self.paths.waypoints(times))
        seen = observe(
            self.motion,
            self.people,
            self.reference,
            waypoints,
            self.clear,
            self.world.hinges,
            self.config.body_aware,
            self._maps(),
        )
        self.mirrored = self.reference.steps["phase"] >= 0.5
        seen[self.mirrored] = self.mirror.observations(seen[self.mirrored])
        return seen

    def _maps(self) -> Floats | None:
        """What is seen of the surroundings (N, cells, cells, 3)."""
        settings, motion = self.config.map, self.motion
        if settings is None:
            return None
        way = heading(motion.quaternions[:, 0])
        pelvis = motion.positions[:, 0, :2]
        return draw_local_maps(
            pelvis, way, motion.velocity[:, :2], self._seen_heights, settings, self.company
        )

    def unmirrored(self, actions: Floats) -> Floats:
        """Actions (N, A) as the bodies take them, of actions that answer the last observations."""
        actions = np.array(actions)
        actions[self.mirrored] = self.mirror.actions(actions[self.mirrored])
        return actions

    def targets(self, actions: Floats) -> Array:
        """PD targets (N, H), rad, of actions (N, A) as the bodies take them."""
        hinges, config = self.world.hinges, self.config
        pose = self.reference.targets(hinges, config.lead)
        pose[:, self.driven] += config.action_scale * actions
        return pose

    def advance(self, actions: Floats) -> Array:
        """Let one control step pass, no reward, no reset; returns the mechanical power (N,), W/kg."""
        targets = self.targets(actions)
        self._push()
        self.world.step(targets)
        self.age += 1
        self.motion = self._read()
        points = self.motion.sole_points(self.people.soles)
        clear = clearance(points, self.height_at)
        self.slip = slip_speed(points, self._points, clear, self.clear, self.period)
        self._points, self.clear = points, clear
        rates = self.motion.rates
        torque = np.clip(self._kp * (targets - self.motion.joints), -self._cap, self._cap) - self._kd * rates
        return np.abs(torque * rates).sum(1) / self.people.mass

    def lead(self) -> None:
        """Move the references on, so that they are one step ahead of the people again."""
        positions = self.motion.positions
        aims = self.paths.at(self.times + self.reference.preview)
        self.reference.advance(aims, positions[:, 0, :2], positions[:, FEET], touching(self.clear))

    def fallen(self) -> NDArray[np.bool_]:
        """Whether people (N,) have fallen."""
        return fallen(self.motion, self.people, self.height_at)

    def step(self, actions: Floats) -> WalkerStep:
        """Let one control step pass, judge it, and begin anew where an episode ended."""
        actions = self.unmirrored(actions)
        power = self.advance(actions)
        targets = self.reference.follower.near(self.paths.at(self.times))
        spin_gap = self.motion.spin.copy()
        spin_gap[:, 2] -= self.reference.follower.turn_rate
        errors = reward_errors(
            self.motion,
            spin_gap,
            self.reference,
            targets,
            self.world.hinges,
            self.clear,
            self.slip,
            power,
            (actions - self._before).astype(float),
        )
        self._before = np.array(actions, dtype=float)
        rewards, terms = weigh(errors, self.config.rewards)
        fell = self.fallen() | ~np.isfinite(rewards)
        offsets = self.offsets
        strayed = ~fell & ~(offsets < self.config.lost)
        bumped = ~(fell | strayed) & ((self.nearest() < _TOUCH) | (self._free() < _TOUCH_WALL))
        failed = fell | strayed | bumped
        cut = ~failed & (self.age >= self.config.episode)
        self.lead()
        observations = self.observe()
        cut_observations = observations[cut]
        ended = np.flatnonzero(failed | cut)
        if self.config.style.weight > 0:
            self._history.push(style_features(self.motion))
        windows, whole = self._history.windows, self._history.whole
        self._history.forget(ended)
        means = {f"term_{name}": float(np.nan_to_num(term).mean()) for name, term in terms.items()}
        means |= {
            "path_error": float(np.nan_to_num(offsets).mean()),
            "skate": float(np.nan_to_num(self.slip).mean()),
            "power": float(np.nan_to_num(power).mean()),
            "fell": float(fell.sum()),
            "strayed": float(strayed.sum()),
            "bumped": float(bumped.sum()),
        }
        if len(ended):
            self.starts.remember(ended, fell[ended])
            self._begin(ended)
            self.settle(ended)
            observations[ended] = self.observe()[ended]
        rewards = np.nan_to_num(rewards).astype(np.float32)
        return WalkerStep(observations, rewards, failed, cut, cut_observations, windows, whole, means)

    def _begin(self, ids: NDArray[np.intp]) -> None:
        """Draw paths for people (n,) and put them there."""
        rng, n, config = self.rng, len(ids), self.config
        headings = rng.uniform(-np.pi, np.pi, n)
        settings = config.easy_paths.towards(config.paths, self.difficulty)
        starts = self.starts.draw(ids, self.world.positions[:, 0, :2])
        paths = sample_paths(starts, headings, rng, settings)
        speeds = paths.first_speeds
        resting = rng.random(n) < config.standing
        stops = ~resting & (rng.random(n) < _STOPS)
        begins = np.where(resting, -10.0, np.where(stops, rng.uniform(0.5, 8.0, n), 1e3))
        pauses = np.where(resting & (rng.random(n) < _STAYS), 1e3, rng.uniform(0.2, 3.0, n))
        ends = np.where(resting, pauses, begins + 0.8 + pauses)
        paths = with_stops(paths, begins, ends)
        headings = headings + np.where(resting, rng.uniform(-1.0, 1.0, n), rng.normal(0.0, 0.1, n))
        self.begin(ids, paths, np.where(resting, 0.0, speeds), headings, rng.random(n))

    def nearest(self) -> Array:
        """Distance (N,), m, to the nearest of one's company; infinite for those who are alone."""
        size = self.config.company
        if size == 1:
            return np.full(len(self), np.inf)
        places = self.motion.positions[:, 0, :2].reshape(-1, size, 2)
        gap = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
        return (gap + np.where(np.eye(size, dtype=bool), np.inf, 0.0)).min(-1).reshape(-1)

    def _read(self) -> Motion:
        world = self.world
        return Motion(
            world.positions,
            world.quaternions,
            world.qvel[:, :3],
            world.pelvis_spin(EVERYONE),
            world.joints,
            world.joint_velocities,
        )

    def _free(self) -> Array:
        """Distance (N,), m, of people from obstacles."""
        return signed_distance(self._outlines, self.motion.positions[:, 0, :2])

    def settle(self, ids: NDArray[np.intp]) -> None:
        """Read the motion, and forget where soles were before people (n,) were put somewhere."""
        self.motion = self._read()
        points = self.motion.sole_points(self.people.soles)
        self._points[ids] = points[ids]
        self.clear[ids] = clearance(points[ids], self.height_at)

    def _push(self) -> None:
        """Begin and end random pushes."""
        self._push_left -= 1
        self.world.forces[self._push_left == 0] = 0.0
        config, rng = self.config, self.rng
        if not config.push_interval:
            return
        new = np.flatnonzero(
            (rng.random(len(self)) < self.period / config.push_interval) & (self._push_left < 0)
        )
        if len(new):
            angle = rng.uniform(-np.pi, np.pi, len(new))
            self.push(new, self.difficulty * config.push_force * rng.random(len(new)), angle, _PUSH)

    def push(self, ids: NDArray[np.intp], force: Array, angle: Array, duration: float) -> None:
        """Push the chests of people (n,) with forces (n,), N, towards angles (n,), rad, world, for so long, s."""
        self.world.forces[ids] = 0.0
        self.world.forces[ids, _CHEST, 0] = force * np.cos(angle)
        self.world.forces[ids, _CHEST, 1] = force * np.sin(angle)
        self._push_left[ids] = round(duration / self.period) + 1  # the step in which it ends is not pushed
