"""Closed loop with planners whose plans are known beforehand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from footfall.models.crowd.planning import Futures
from footfall.models.trace.closed_loop import (
    ARRIVED,
    PERTURBATION,
    TASKS,
    recorded,
    walk_all,
)
from footfall.models.trace.config import COMPACT
from footfall.models.trace.crowd_file import CrowdFileError
from footfall.models.trace.network import Trace
from footfall.models.trace.planner import Sampling, TracePlanner
from footfall.models.trace.recordings import Recording, pack_recordings
from footfall.models.trace.rollouts import rollouts, walk

SPEED = 1.2
WALL = np.array([[20.0, 5], [24, 5], [24, 8], [20, 8]])


def track(y, start=0.0, stop=20.4, speed=SPEED, x=0.0):
    t = np.arange(start, stop, 0.4)
    return np.column_stack([t, x + speed * t, np.full_like(t, y)])


def street(**changes):
    """A pair, one on the other side who walks back, one who leaves, one who comes later."""
    tracks = [
        track(0.0),
        track(1.0),
        track(3.0, speed=-SPEED, x=12),
        track(9.0, stop=8.4),
        track(12.0, start=6.0),
    ]
    facts = {"name": "street", "tracks": tracks, "intervals": [(0.0, 20.0, "test")], "obstacles": [WALL]}
    return pack_recordings("street", [Recording(**{**facts, **changes})], 0.25, {})


class StraightOn:
    """Plans that go on as people go now, and a memory of what was asked and seen."""

    config = COMPACT

    def __init__(self):
        self.calls = []

    def plan(
        self, states, size, maps=None, objectives=(), present=None, previous=None, elapsed=0, seed=0, ids=()
    ):
        assert maps is not None and present is not None and bool(present[:, -1].all())
        asked = {"states": states, "objectives": objectives, "seed": seed, "ids": ids}
        self.calls.append(SimpleNamespace(**asked, previous=previous, elapsed=elapsed))
        now, time = states[:, -1].numpy(), 0.1 * np.arange(1, 51)
        forward = np.stack([np.cos(now[:, 2]), np.sin(now[:, 2])], -1) * now[:, 3:]
        positions = now[:, None, :2] + time[:, None] * forward[:, None]

        def every(column):
            return np.repeat(now[:, None, None, column], 50, 2)

        rows = np.zeros(len(now), int)
        return Futures(positions[:, None], every(2), every(3), rows)


@pytest.fixture
def rollout():
    (rollout,) = rollouts(street(), COMPACT)
    return rollout


def test_who_stays_walks_and_the_others_are_replayed(rollout):
    assert rollout.walkers == 3 and len(rollout.states) == 5
    planner = StraightOn()
    path = walk(planner, rollout, lambda people, path: [])
    truth = rollout.observed[:3, 30:131].numpy()
    assert path.shape == (3, 101, 4) and np.allclose(path[..., :2], truth, atol=0.02)
    assert [len(call.states) for call in planner.calls] == [4, 4, 4, 5, 5, 5, 4, 4, 4, 4]
    leaving = planner.calls[2].states[3, -1]  # at 5 s
    assert torch.allclose(leaving, torch.tensor([6.0, 9.0, 0.0, SPEED]), atol=0.02)
    assert len({call.seed for call in planner.calls}) == 10


def test_a_plan_begins_with_the_one_before(rollout):
    planner = StraightOn()
    walk(planner, rollout, lambda people, path: [])
    assert planner.calls[0].previous is None and planner.calls[3].ids == [0, 1, 2, 3, 4]
    assert planner.calls[6].ids == [0, 1, 2, 4]  # who left
    for call in planner.calls[1:]:
        assert call.elapsed == 10 and isinstance(call.previous, Futures)


def test_history_is_what_was_walked(rollout):
    class Left(StraightOn):
        def plan(self, *args, **kwargs):
            plan = super().plan(*args, **kwargs)
            plan.positions[..., 1] += 0.1 * np.arange(1, 51)
            return plan

    planner = Left()
    walk(planner, rollout, lambda people, path: [])
    fifth = planner.calls[4].states[0]
    assert torch.allclose(fifth[-11:, 1], torch.linspace(3.0, 4.0, 11), atol=0.02)  # 0.1 m a step to the left
    assert torch.equal(
        rollout.states[0, :31, 1], planner.calls[0].states[0, :, 1]
    )  # the recording is untouched


def test_straight_on_reaches_the_waypoint_and_nobody_hurries(rollout):
    report = walk_all(StraightOn(), [rollout], "waypoint").report()
    truth = recorded([rollout], "waypoint").report()
    assert report.error < 0.05 and truth.error == 0.0
    assert report.longitudinal < 0.02 and report.lateral < 0.02 and report.emd_speed < 0.06
    assert report.obstacle == truth.obstacle == 0.0 and report.agent == 0.0


def test_obstacles_and_people_count():
    (rollout,) = rollouts(street(obstacles=[WALL - (9.0, 4.0)]), COMPACT)  # now at x 11-15, y 1-4
    report = walk_all(StraightOn(), [rollout], "none").report()
    pair_inside = (4.0 + 2 * 0.25) / (SPEED * 0.1) / 101  # beside the wall's edge at y = 1
    assert report.obstacle == pytest.approx((pair_inside + 0.0) / 3, abs=0.06)
    (close,) = rollouts(street(tracks=[track(0.0), track(0.4), track(5.0)]), COMPACT)
    assert walk_all(StraightOn(), [close], "none").report().agent == pytest.approx(2 / 3)


def test_waypoints_are_asked_for_until_they_are_passed(rollout):
    planner = StraightOn()
    walk_all(planner, [rollout], "waypoint")
    goals = [call.objectives[0].parameters["goal"] for call in planner.calls]
    assert np.allclose(goals[0][:3], rollout.observed[:3, 120]) and goals[0][3:].isnan().all()
    assert not goals[-2][:3].isnan().any() and goals[-1][:3].isnan().all()
    assert ARRIVED < 0.37


def test_urgent_waypoints_ask_for_the_whole_preferred_speed(rollout):
    draw = lambda task: TASKS[task](rollout, np.random.default_rng(0)).wishes(5, np.zeros((3, 1, 2)) - 99)[0]  # noqa: E731
    urgent, calm = draw("urgent").parameters, draw("waypoint").parameters
    assert (urgent.pop("urgency"), calm.pop("urgency")) == (1.0, 0.7)
    assert torch.equal(urgent.pop("goal").nan_to_num(), calm.pop("goal").nan_to_num()) and urgent == calm


def test_perturbed_waypoints_are_two_metres_off_and_always_the_same(rollout):
    draw = lambda number: TASKS["perturbed"](rollout, np.random.default_rng(number))  # noqa: E731
    off = [
        draw(n).wishes(5, np.zeros((3, 1, 2)) - 99)[0].parameters["goal"][:3].numpy() - rollout.goals
        for n in range(200)
    ]
    assert np.std(off) == pytest.approx(PERTURBATION, rel=0.1) and abs(np.mean(off)) < 0.3
    assert np.array_equal(
        off[0], draw(0).wishes(5, np.zeros((3, 1, 2)) - 99)[0].parameters["goal"][:3].numpy() - rollout.goals
    )


def test_groups_are_near_and_go_the_same_way(rollout):
    groups = rollout.groups
    assert groups[0] == groups[1] >= 0 and groups[2] == -1  # beside them, but the other way
    report = walk_all(StraightOn(), [rollout], "groups").report()
    assert report.error == pytest.approx(0.5, abs=0.02)  # they keep 1 m, not 1.5 m
    planner = StraightOn()
    walk_all(planner, [rollout], "groups")
    assert planner.calls[0].objectives[0].parameters["group"].tolist() == [groups[0], groups[1], -1, -1]


def test_a_real_planner_walks():
    torch.manual_seed(0)
    trace = Trace(replace(COMPACT, widths=(16, 32), context_width=32)).eval()
    trace.trajectory_std[4:] = 0.3
    planner = TracePlanner(trace, Sampling(steps=2, samples=2, reduced=False))
    (rollout,) = rollouts(street(), COMPACT)
    wished = TASKS["waypoint"](rollout, np.random.default_rng(0)).wishes
    path = walk(planner, rollout, wished, seed=3)
    assert torch.isfinite(path).all() and torch.equal(path, walk(planner, rollout, wished, seed=3))
    assert torch.allclose(path[:, 0], rollout.states[:3, 30])
    step = (path[:, 1:, :2] - path[:, :-1, :2]).norm(dim=-1)
    assert torch.allclose(step, path[:, 1:, 3].abs() * 0.1, atol=1e-3)  # positions and speeds agree


def test_short_scenes_are_refused():
    crowds = street()
    short = replace(crowds, positions=crowds.positions[:, :, :120])
    with pytest.raises(CrowdFileError, match="131 frames"):
        rollouts(short, COMPACT)
