"""The trained walker as a control method: who comes, goes, or is put elsewhere; what cannot be loaded."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from footfall.messages.body import BodyStates
from footfall.messages.config import ConfigError
from footfall.messages.map import SemanticMap
from footfall.messages.plan import PLAN_STEPS, Plans
from footfall.messages.population import Population
from footfall.messages.topics import BODIES, BODY_STATES, MAP, PLANS
from footfall.models.body import describe, sample_shapes
from footfall.models.pacer.batch_world import Physics
from footfall.models.pacer.policy import ActorCritic
from footfall.models.pacer.walker_config import CONFIGS
from footfall.models.pacer.walker_env import WalkerEnv
from footfall.models.trace.weights import save_tensors
from footfall.nodes.controller import TICK, Config, Controller
from footfall.nodes.simulator import describe_bodies

SMALL = replace(
    CONFIGS["compact"], company=1, course=None, worlds=3, people=3, hidden=(8,), physics=Physics(threads=1)
)
OPEN = SemanticMap("open", [], np.zeros((0, 1, 1), np.uint8), 1.0, (0.0, 0.0))
SHAPES = sample_shapes(3, 4).astype(np.float32)


def save(path, config):
    env = WalkerEnv(config)
    model = ActorCritic(env.size, env.n_actions, config.hidden, 0.1)
    facts = {"config": asdict(config), "observations": env.size, "actions": env.n_actions}
    save_tensors(path, model.state_dict(), facts)
    return str(path)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save(tmp_path_factory.mktemp("walker") / "small.safetensors", SMALL)


def population():
    ids = np.arange(3, dtype=np.int32)
    people = Population(ids, np.full(3, -1, np.int32), SHAPES, np.zeros(3), np.zeros((3, 2)))
    return BODIES(describe_bodies(people, [describe(shape) for shape in SHAPES.astype(float)]))


def standing(ids, places):
    joints = np.zeros((len(ids), 24, 13), np.float32)
    joints[..., 3] = 1.0
    joints[..., :2] = np.array(places, np.float32)[:, None]
    joints[:, :, 2] = 0.9
    return BODY_STATES(BodyStates(np.array(ids, np.int32), joints))


def plan(ids):
    shape = (len(ids), 1, PLAN_STEPS)
    ahead = 0.1 * np.arange(1, PLAN_STEPS + 1, dtype=np.float32)
    positions = np.zeros((*shape, 2), np.float32)
    positions[..., 0] = ahead
    return PLANS(
        Plans(
            np.array(ids, np.int32),
            chosen=np.zeros(len(ids), np.int32),
            positions=positions,
            headings=np.zeros(shape, np.float32),
            speeds=np.ones(shape, np.float32),
            method="test",
        )
    )


def test_people_come_follow_plans_are_put_elsewhere_and_go(inbox_of, weights):
    node = Controller(Config(method="pacer", weights=weights))
    first = standing([0, 2], [(0, 0), (3, 0)])
    box = inbox_of(0.0, MAP(OPEN), population(), first, plan([0, 1, 2]))
    [action] = node.step(box)
    assert action.message.ids.tolist() == [0, 2]
    assert action.message.roots is None
    assert action.message.joint_targets.shape == (2, 69)
    assert np.isfinite(action.message.joint_targets).all() and action.message.joint_targets.any()
    [action] = node.step(inbox_of(TICK, standing([0, 1, 2], [(0, 0), (1, 5), (9, 9)]), inbox=box))
    assert sorted(action.message.ids.tolist()) == [0, 1, 2]
    [action] = node.step(inbox_of(2 * TICK, standing([1], [(1, 5)]), inbox=box))
    assert action.message.ids.tolist() == [1]
    [action] = node.step(inbox_of(3 * TICK, standing([], np.zeros((0, 2))), inbox=box))
    assert action.message.joint_targets.shape == (0, 69)


def test_the_same_messages_give_the_same_targets(inbox_of, weights):
    seen = []
    for _ in range(2):
        node = Controller(Config(method="pacer", weights=weights))
        box = inbox_of(0.0, MAP(OPEN), population(), standing([0, 2], [(0, 0), (3, 0)]), plan([0, 2]))
        node.step(box)
        [action] = node.step(inbox_of(TICK, standing([0, 2], [(0, 0), (3, 0)]), inbox=box))
        seen.append(action.message.joint_targets)
    np.testing.assert_array_equal(*seen)


def test_weights_that_cannot_be_used_are_named(tmp_path, weights):
    with pytest.raises(ConfigError, match=r"controller: config: weights: .*nowhere"):
        Controller(Config(method="pacer", weights=str(tmp_path / "nowhere.safetensors")))
    fast = replace(SMALL, physics=replace(SMALL.physics, substeps=2))
    with pytest.raises(ConfigError, match="60 steps a second; the graph makes 30"):
        Controller(Config(method="pacer", weights=save(tmp_path / "fast.safetensors", fast)))
