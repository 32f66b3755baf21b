"""Walkers in one world: how well they keep to random paths among obstacles and each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..body import Body, describe, sample_shapes
from ..gait import flat_ground
from ..scene import Obstacle
from ..scene.layers import signed_distance
from ..world import World
from .courses import scatter_obstacles
from .gait_reference import GaitReference
from .paths import Paths, sample_paths
from .policy import ActorCritic
from .style import Discriminator
from .walker import Walker
from .walker_config import WalkerConfig
from .walker_evaluation import LOST, PEOPLE_SEED, Measurement, Rollouts, evaluation_paths
from .walker_observation import Motion
from .walker_rewards import fallen

Array = NDArray[np.float64]

Setting = Literal["obstacles", "crowd"]

SIDE: dict[str, float] = {"obstacles": 40.0, "crowd": 20.0}
"""m: side of the square in which people begin."""
BOXES = 64
"""Obstacles in their square: one on 25 m^2."""
_APART, _FROM_BOXES = 1.2, 0.8  # m at the beginning
_HIT = 50.0  # N between people, or with an obstacle (PACER, app. B)


def roll_out_together(
    model: ActorCritic,
    config: WalkerConfig,
    rollouts: int,
    setting: Setting,
    *,
    people: int = 30,
    duration: float = 10.0,
    discriminator: Discriminator | None = None,
    seed: int = 0,
) -> Rollouts:
    """Walk random paths that know nothing of what is in their way, `people` at a time, without noise.

    A rollout fails by a fall, by touching another person or an obstacle with more than 50 N, or 4 m from the
    path; whoever fails is taken out.

    Args:
        model: the walker.
        config: its settings.
        rollouts: R, rounded up to whole worlds.
        setting: level ground with boxes, or with many people in a small square.
        people: in each world.
        duration: of each rollout, s.
        discriminator: what judges style, if anything.
        seed: of places and paths.
    """
    worlds = -(-rollouts // people)
    bodies = [describe(shape) for shape in sample_shapes(people, PEOPLE_SEED)]
    results = [
        _one_world(model, config, setting, bodies, duration, discriminator, seed + 7919 * k)
        for k in range(worlds)
    ]
    return Rollouts.joined(results)


def _one_world(
    model: ActorCritic,
    config: WalkerConfig,
    setting: Setting,
    bodies: list[Body],
    duration: float,
    discriminator: Discriminator | None,
    seed: int,
) -> Rollouts:
    rng = np.random.default_rng(seed)
    count, period = len(bodies), config.physics.control_period
    boxes = scatter_obstacles((0.0, 0.0), SIDE[setting], BOXES, rng) if setting == "obstacles" else []
    starts, headings = _places(count, SIDE[setting], boxes, rng), rng.uniform(-np.pi, np.pi, count)
    paths = sample_paths(starts, headings, rng, evaluation_paths(duration))
    world = World(
        bodies,
        boxes,
        mode="physics",
        actuation=config.physics.actuation,
        timestep=config.physics.timestep,
    )
    walker = Walker(model, config)
    walker.ground(flat_ground, boxes)
    _enter(world, walker, bodies, paths, headings)
    measurement = Measurement(
        bodies, walker.hinges, round(duration / period), period, flat_ground, discriminator
    )
    alive = np.ones(count, dtype=bool)
    motion = Motion.of_states(world.joint_states(np.arange(count)), walker.hinges)
    measurement.begin(motion)
    for k in range(measurement.steps):
        ids = np.flatnonzero(alive)
        if not len(ids):
            break
        now = np.full(len(ids), k * period)
        ways = Paths(paths.vertices[ids], paths.duration)
        states = world.joint_states(ids)
        world.set_targets(ids, walker.step(states, ways, now))
        world.advance(period)
        after = Motion.of_states(world.joint_states(ids), walker.hinges)
        offsets = np.linalg.norm(after.positions[:, 0, :2] - ways.at(now + period), axis=1)
        fell = fallen(after, measurement.people.take(ids), flat_ground)
        hit = _hits(world, count)[ids]
        failed = fell | hit | ~(offsets < LOST)
        measurement.add(k, after, ids, ~failed, offsets, fell, hit & ~fell)
        for agent in ids[failed]:
            world.leave(int(agent))
        walker.leave(ids[failed].tolist())
        alive[ids[failed]] = False
    return measurement.result(~alive)


def _enter(world: World, walker: Walker, bodies: list[Body], paths: Paths, headings: Array) -> None:
    """Put everybody in mid-stride at the beginning of their path."""
    count = len(bodies)
    speeds = paths.first_speeds
    everyone = np.arange(count)
    gait = GaitReference(bodies, walker.period)
    poses = gait.place(everyone, paths.vertices[:, 0], headings, speeds, np.where(everyone % 2, 0.5, 0.0))
    for agent, (root, joints, twist, rates) in enumerate(zip(*poses, strict=True)):
        world.enter(agent, root, joints, twist, rates)
    walker.enter(everyone.tolist(), bodies, world.joint_states(everyone))


def _places(count: int, side: float, boxes: list[Obstacle], rng: np.random.Generator) -> Array:
    """Places (count, 2), m, apart from each other and from boxes."""
    outlines = [np.asarray(box.polygon, dtype=float) for box in boxes]
    found: list[Array] = []
    while len(found) < count:
        spots = rng.uniform(-0.5, 0.5, (64, 2)) * side
        for spot in spots[signed_distance(outlines, spots) > _FROM_BOXES]:
            if len(found) < count and all(np.hypot(*(spot - other)) > _APART for other in found):
                found.append(spot)
    return np.array(found)


def _hits(world: World, count: int) -> NDArray[np.bool_]:
    """Who (N,) touches somebody or something hard."""
    contacts = world.contacts()
    contacts = contacts.select((contacts.force > _HIT) & ((contacts.other >= 0) | (contacts.other_part >= 0)))
    hit = np.zeros(count, dtype=bool)
    hit[contacts.agent] = True
    hit[contacts.other[contacts.other >= 0]] = True
    return hit


def unaware(config: WalkerConfig, of: str = "others") -> WalkerConfig:
    """The same walker, not aware of something (PACER, table 9).

    Args:
        config: settings.
        of: `others`, who looks at nobody and nothing but the path; or `their body`, who takes themselves for average.
    """
    return replace(config, manners=False) if of == "others" else replace(config, body_aware=False)
