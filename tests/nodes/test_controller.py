"""Following plans: where they join, where they end, how fast a body turns."""

import numpy as np
import pytest

from footfall.messages.body import Bodies, BodyStates
from footfall.messages.map import SemanticMap
from footfall.messages.plan import Plans
from footfall.messages.topics import BODIES, BODY_STATES, MAP, PLANS
from footfall.nodes.controller import TICK, Config, Controller
from footfall.nodes.controller_gait import Follower


def straight(speed: float, start: float = 0.0, count: int = 50):
    times = 0.1 * np.arange(1, count + 1)
    return np.column_stack([start + speed * times, np.zeros(count)]), np.zeros(count)


def walk(follower: Follower, seconds: float) -> np.ndarray:
    places = []
    for _ in range(round(seconds * 30)):
        follower.advance(follower.time + TICK, 3.0)
        places.append(follower.position)
    return np.array(places)


def test_a_follower_is_where_the_plan_says():
    follower = Follower(0.0, np.zeros(2), 0.0, 1.4)
    follower.take(0.0, *straight(1.4))
    places = walk(follower, 3.0)
    assert places[:, 0] == pytest.approx(1.4 * TICK * np.arange(1, 91), abs=1e-9)
    assert follower.speed == pytest.approx(1.4)


def test_replanning_on_the_way_changes_nothing_when_the_plans_agree():
    follower = Follower(0.0, np.zeros(2), 0.0, 1.0)
    follower.take(0.0, *straight(1.0))
    first = walk(follower, 1.0)
    follower.take(1.0, *straight(1.0, start=1.0))
    second = walk(follower, 1.0)
    assert np.diff(np.vstack([first, second])[:, 0]) == pytest.approx(TICK)


def test_a_late_plan_is_joined_without_a_jump():
    follower = Follower(0.0, np.zeros(2), 0.0, 1.0)
    walk(follower, 0.5)
    follower.take(0.2, *straight(1.0))
    steps = np.linalg.norm(np.diff(walk(follower, 1.0), axis=0), axis=1)
    assert steps.max() < 0.2


def test_without_a_plan_and_after_its_end_the_follower_stands():
    follower = Follower(0.0, np.zeros(2), 0.5, 0.0)
    walk(follower, 1.0)
    assert follower.position == pytest.approx([0, 0])
    follower.take(1.0, *straight(1.0, count=5))
    walk(follower, 3.0)
    assert follower.position == pytest.approx([0.5, 0])
    assert follower.speed == 0.0


@pytest.mark.parametrize("heading", [3.0, -3.0])
def test_a_body_turns_the_short_way_no_faster_than_it_can(heading):
    follower = Follower(0.0, np.zeros(2), np.sign(heading) * 2.0, 0.0)
    follower.take(0.0, np.zeros((50, 2)), np.full(50, -heading))
    turned = []
    for _ in range(30):
        before = follower.heading
        follower.advance(follower.time + TICK, 3.0)
        turned.append(follower.heading - before)
    assert np.abs(turned).max() <= 3.0 * TICK + 1e-9
    assert np.sign(turned[0]) == np.sign(heading)


def test_ticks_that_were_missed_are_caught_up(inbox_of):
    ids = np.zeros(1, np.int32)
    person = Bodies(
        ids,
        shapes=np.zeros((1, 10), np.float32),
        masses=np.full(1, 70, np.float32),
        statures=np.full(1, 1.7, np.float32),
        radii=np.full(1, 0.25, np.float32),
        offsets=np.zeros((1, 24, 3), np.float32),
    )
    joints = np.zeros((1, 24, 13), np.float32)
    joints[..., 3] = 1.0
    there = BODY_STATES(BodyStates(ids, joints))
    places, headings = straight(1.2)
    plan = Plans(
        ids,
        chosen=np.zeros(1, np.int32),
        positions=places[None, None].astype(np.float32),
        headings=headings[None, None].astype(np.float32),
        speeds=np.full((1, 1, 50), 1.2, np.float32),
        method="test",
    )
    place = SemanticMap("open", [], np.zeros((0, 1, 1), np.uint8), 1.0, (0.0, 0.0))
    node = Controller(Config())
    box = inbox_of(0.0, MAP(place), BODIES(person), there, PLANS(plan))
    for tick in (0, 1, 2, 15, 16, 60, 61):  # a busy machine
        [action] = node.step(inbox_of(tick * TICK, there, inbox=box) if tick else box)
    assert action.message.roots[0, 0] == pytest.approx(1.2 * 62 * TICK, abs=0.05)
