"""Which sample everybody takes: filtering, mixtures of samples, and who would come to harm."""

import pytest
import torch

from footfall.models.trace.choice import choose_samples, harm, judge, reconsider, regroup
from footfall.models.trace.objectives import Future, Objective


def test_filtering_is_per_agent_or_per_scene():
    alone, joint = Objective("waypoint", {"goal": [0.0, 0.0]}), Objective("agent_avoid")
    loss = torch.tensor([[3.0, 1.0, 2.0], [0.0, 5.0, 1.0]])
    assert choose_samples({"waypoint": loss}, [alone]).tolist() == [1, 0]
    none = torch.zeros(2, 3)
    both = {"waypoint": loss, "agent_avoid": none}
    assert choose_samples(both, [alone, joint]).tolist() == [0, 0]  # sums 3, 6, 3: the first
    weighted = [alone, Objective("agent_avoid", weight=2.0)]
    crash = {"waypoint": loss, "agent_avoid": torch.tensor([[1.0, 0.0, 0.0]] * 2)}
    assert choose_samples(crash, weighted).tolist() == [2, 2]


def standing(*samples):
    """People who stand where each sample (A, 2) says."""
    where = torch.tensor(samples).transpose(0, 1)  # (A, M, 2)
    states = torch.nn.functional.pad(where, (0, 2))[:, :, None].repeat(1, 1, 50, 1)
    return Future(states, states[:, 0, 0], torch.full((len(where),), 0.4))


def test_harm_is_what_overlaps_without_the_room_and_soon():
    wishes = [Objective("agent_avoid", {"buffer": 0.5}), Objective("waypoint", {"goal": torch.zeros(2)})]
    close, touching = [[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.6, 0.0]]
    future = standing(close, touching)
    now, later = harm(wishes, future)[0].tolist(), future.states.clone()
    assert now == pytest.approx([0.0, (50 + 9 * 15) * 0.25])  # a quarter of the two radii
    later[:, :, :25] += torch.tensor([[0.0], [5.0]])[..., None, None]
    apart_at_first = Future(later, future.now, future.radius)
    assert harm(wishes, apart_at_first)[1].tolist() == pytest.approx([0.0, 25 * 0.25])
    off = [Objective("agent_avoid", {"buffer": 0.5}, weight=0.0)]
    assert harm(off, future).sum() == 0  # nobody asked


def test_who_would_come_to_harm_takes_another_sample_than_the_others():
    first = [[0.0, 0.0], [0.5, 0.0], [9.0, 0.0]]  # the second is in the first
    second = [[0.0, 0.0], [0.0, 3.0], [0.5, 0.0]]  # the third is
    future, wishes = standing(first, second), [Objective("agent_avoid", {"buffer": 0.0})]
    losses = {"agent_avoid": wishes[0].loss(future)}
    chosen = choose_samples(losses, wishes)
    again = reconsider(chosen, losses, wishes, future)
    states = future.states[torch.arange(3), again][:, None]
    assert harm(wishes, future)[:, chosen[0]].sum() > 0
    assert harm(wishes, Future(states, future.now, future.radius)).sum() == 0


def test_who_has_a_far_better_sample_takes_it_unless_others_pay_for_it():
    first = [[4.0, 0.0], [0.0, 9.0], [9.0, 3.0]]  # the best of the scene
    second = [[0.0, 0.0], [0.0, 0.3], [9.0, 0.0]]  # at their goals, the first two in each other
    future = standing(first, second)
    goals = torch.tensor([[0.0, 0.0], [0.0, 0.3], [9.0, 0.0]])
    wishes = [Objective("agent_avoid", {"buffer": 0.0}), Objective("waypoint", {"goal": goals})]
    losses = judge(wishes, future)
    assert regroup(torch.tensor([0, 0, 0]), losses, wishes, future).tolist() == [0, 1, 1]  # 81 m^2 before 16
    content = torch.tensor([1, 1, 1])  # nobody is better off alone
    assert regroup(content, losses, wishes, future).tolist() == [1, 1, 1]
    alone = wishes[1:]
    assert regroup(torch.tensor([0, 0, 0]), losses, alone, future).tolist() == [1, 1, 1]
