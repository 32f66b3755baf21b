import math

import numpy as np
import pytest
import torch

from footfall.models.trace import guidance_losses  # noqa: F401  registers the objectives
from footfall.models.trace.guidance_losses import learned_value
from footfall.models.trace.objectives import OBJECTIVES, Future, Objective, ObjectiveError, objective
from footfall.models.trace.scene_map import SceneMaps

DT = 0.1
NAN = float("nan")


def walkers(starts, velocities, samples=1, steps=50, **kwargs):
    """Futures of people at constant velocity."""
    start, velocity = torch.tensor(starts, dtype=torch.float32), torch.tensor(velocities, dtype=torch.float32)
    time = DT * torch.arange(1, steps + 1)
    positions = start[:, None] + velocity[:, None] * time[:, None]
    heading = torch.atan2(velocity[:, 1], velocity[:, 0])
    rest = torch.stack([heading, velocity.norm(dim=1)], 1)
    states = torch.cat([positions, rest[:, None].expand(-1, steps, -1)], -1)
    states = states[:, None].repeat(1, samples, 1, 1).requires_grad_()
    return Future(states, torch.cat([start, rest], 1), torch.full((len(start),), 0.4), **kwargs)


def wall(x=3.0):
    """A map that is solid beyond x."""
    axis = np.arange(-2, 12, 0.1)
    return SceneMaps.from_raster({"obstacle": np.meshgrid(axis, axis)[0] > x}, 0.1, (-2, -2))


def loss(future, name, **parameters):
    return Objective(name, parameters).loss(future)


def gradient(future, name, **parameters):
    (g,) = torch.autograd.grad(loss(future, name, **parameters).sum(), future.states)
    return g[..., :2]


def test_agent_avoid_is_the_overlap_of_the_discs():
    future = walkers([[0, 0], [0.5, 0]], [[1, 0], [1, 0]])
    expected = 50 * (1 - 0.5 / (0.4 + 0.4 + 0.2))
    assert torch.allclose(loss(future, "agent_avoid"), torch.full((2, 1), expected), atol=1e-3)
    assert loss(future, "agent_avoid", buffer=-0.3).abs().max() < 1e-4
    g = gradient(future, "agent_avoid")
    assert (g[0, ..., 0] > 0).all() and (g[1, ..., 0] < 0).all()  # downhill is apart


def test_agent_avoid_compares_equal_samples_only():
    future = walkers([[0, 0], [0.5, 0]], [[1, 0], [1, 0]], samples=2)
    with torch.no_grad():
        future.states[1, 1, :, 1] += 9
    assert loss(future, "agent_avoid")[:, 0].min() > 1 and loss(future, "agent_avoid")[:, 1].max() == 0


def test_a_weight_means_the_same_for_a_hundred_agents():
    pair, crowd = [[0, 0], [0.5, 0]], [[i * 10.0, j * 10.0] for i in range(7) for j in range(7)][2:]
    few = loss(walkers(pair, [[1, 0]] * 2), "agent_avoid")
    many = loss(walkers(pair + crowd, [[1, 0]] * (2 + len(crowd)), samples=3), "agent_avoid")
    assert torch.allclose(few, many[:2, :1])


def test_obstacle_avoid_is_the_depth_of_the_disc_along_its_way():
    future = walkers([[0, 0]], [[1.2, 0]], maps=wall())
    depth = torch.relu(0.4 - (2.95 - future.positions[0, 0, :, 0])).sum()
    assert loss(future, "obstacle_avoid").item() == pytest.approx(1.5 * depth.item(), rel=0.02)
    g = gradient(future, "obstacle_avoid")[0, 0]
    assert (g[30:, 0] > 0).all() and g[:20].abs().sum() == 0


def test_avoiding_an_obstacle_leads_sideways_rather_than_backwards():
    ahead, beside = (
        gradient(walkers([[2.6, 0]], [v], steps=1, maps=wall()), "obstacle_avoid")[0, 0, 0]
        for v in ([1.0, 0.0], [0.0, 1.0])
    )
    assert ahead[0].item() == pytest.approx(0.3 * beside[0].item(), rel=0.1)  # the wall lies in x


def test_obstacle_points_pull_a_partly_embedded_body_out():
    future = walkers([[2.9, 0]], [[0.01, 0]], steps=3, maps=wall())
    assert loss(future, "obstacle_avoid_points").item() > 0
    assert (gradient(future, "obstacle_avoid_points")[..., 0] > 0).all()
    free = walkers([[0, 0]], [[0.1, 0]], maps=wall())
    assert loss(free, "obstacle_avoid_points").item() == 0
    assert loss(walkers([[0, 0]], [[0.1, 0]]), "obstacle_avoid_points").item() == 0  # no map


def test_obstacle_points_equal_the_paper_formula_for_a_corner():
    future = walkers([[2.6, 0]], [[0, 0]], steps=1, maps=wall())
    side = torch.linspace(-0.4, 0.4, 10)
    inside = side + 2.6 > 2.95
    nearest_free = side[~inside].max()
    per_row = (1 - (side[inside] - nearest_free) / math.hypot(0.8, 0.8)).sum()
    assert loss(future, "obstacle_avoid_points").item() == pytest.approx(10 * per_row.item(), rel=1e-4)


def test_waypoint_at_is_the_distance_at_that_time():
    future = walkers([[0, 0]], [[1, 0]])
    assert loss(future, "waypoint_at", goal=[3.0, 4.0], time=3.0).item() == pytest.approx(4.0)


def test_waypoint_equals_eq_12():
    future = walkers([[0, 0]], [[1, 0]])
    d = (future.positions[0, 0] - torch.tensor([2.0, 1.0])).norm(dim=1)
    share = torch.exp(-d) / torch.exp(-d).sum()
    assert loss(future, "waypoint", goal=[2.0, 1.0]).item() == pytest.approx((share * d**2).sum().item())
    sharp = loss(future, "waypoint", goal=[2.0, 1.0], temperature=0.01)
    assert sharp.item() == pytest.approx(1.0, abs=0.02)


def test_written_out_gradients_equal_recorded_ones():
    future = walkers([[0, 0], [0.5, 0.2], [0.3, -0.4]], [[1, 0], [1.1, 0], [0.9, 0.1]], samples=2)
    weights = torch.tensor([[1.0, 2.0], [0.5, 0.0], [3.0, 1.0]])

    def check(written, recorded):
        assert torch.allclose(written, recorded, rtol=1e-4)
        a, b = (
            torch.autograd.grad((weights * x).sum(), future.states, retain_graph=True)[0]
            for x in (written, recorded)
        )
        assert torch.allclose(a, b, rtol=1e-3, atol=1e-5)

    goal = torch.tensor([[2.0, 1.0], [1.0, -1.0], [3.0, 0.0]])
    distance = (future.positions - goal[:, None, None]).norm(dim=-1)
    share = torch.softmax(-distance / 0.5, -1)
    check(loss(future, "waypoint", goal=goal, temperature=0.5), (share * distance.square()).sum(-1))
    softness = 0.5 + 0.3 * distance.min(-1, keepdim=True).values.detach()
    share = torch.softmax(-distance / softness, -1)
    wide = loss(future, "waypoint", goal=goal, temperature=0.5, widening=0.3)
    check(wide, (share * distance.square()).sum(-1))
    apart = (future.positions[:, None] - future.positions[None]).square().sum(-1) + 1e-8
    overlap = torch.relu(1 - apart.sqrt() / 1.0) * (1 - torch.eye(3))[..., None, None]
    check(loss(future, "agent_avoid"), overlap.sum((1, 3)))


def test_widening_lets_who_stands_turn_for_a_goal_behind():
    future = walkers([[0, 0]], [[1, 0]])
    behind = {"goal": [-3.0, 0.0], "temperature": 0.05}
    late = []
    for widening in (0.0, 0.3):
        value = loss(future, "waypoint", widening=widening, **behind)
        (slope,) = torch.autograd.grad(value.sum(), future.states)
        late.append(slope[0, 0, 10:, :2].abs().sum())
    assert late[0] < 1e-3 < late[1]  # without it only the first states are moved


def test_of_what_is_settled_only_the_nearest_state_counts_near_the_goal():
    near = {"goal": [2.03, 0.0], "temperature": 0.05, "widening": 0.3}
    soft, hard = (walkers([[0, 0]], [[1, 0]], settled=settled) for settled in (False, True))
    assert loss(hard, "waypoint", **near).item() == pytest.approx(0.03**2, rel=0.05)
    assert loss(soft, "waypoint", **near).item() > 2 * 0.03**2
    paper = {"goal": [2.03, 0.0], "temperature": 0.05}  # without widening it is eq 12 and 13 to the end
    assert torch.equal(loss(hard, "waypoint", **paper), loss(soft, "waypoint", **paper))


def test_agents_without_a_goal_are_left_alone():
    future = walkers([[0, 0], [0, 5]], [[1, 0], [1, 0]])
    goals = torch.tensor([[2.0, 1.0], [NAN, NAN]])
    for name in ("waypoint", "global_waypoint"):
        assert loss(future, name, goal=goals)[:, 0].tolist()[1] == 0
        assert torch.isfinite(gradient(future, name, goal=goals)).all()


def test_global_waypoint_at_equals_eq_14_to_16():
    future = walkers([[0, 0]], [[1, 0]])
    target = 9 * 1.25 * (1 - 0.7)
    assert loss(future, "global_waypoint_at", goal=[12.0, 0.0], time=9.0).item() == pytest.approx(7 - target)
    assert loss(future, "global_waypoint_at", goal=[7.0, 0.0], time=9.0).item() == 0
    assert loss(future, "global_waypoint_at", goal=[3.0, 4.0], time=3.0).item() == pytest.approx(4.0)


def test_global_waypoint_equals_eq_17_to_20():
    future = walkers([[0, 0]], [[0.5, 0]])
    wanted = 0.7 * 50 * 0.1 * 1.25
    assert loss(future, "global_waypoint", goal=[20.0, 0.0]).item() == pytest.approx(wanted - 2.5, rel=1e-4)
    near = {"goal": [3.0, 0.0]}
    assert torch.equal(loss(future, "global_waypoint", **near), loss(future, "waypoint", **near))


def test_everybody_may_have_a_pace_and_an_urgency_of_their_own():
    future = walkers([[0, 0], [0, 5], [0, 9]], [[0.5, 0]] * 3, samples=2)
    goals = torch.tensor([[20.0, 0], [20, 5], [20, 9]])
    own = {"speed": torch.tensor([1.0, 1.5, NAN]), "urgency": torch.tensor([0.7, 0.9, 0.7])}
    behind = loss(future, "global_waypoint", goal=goals, **own)
    assert torch.allclose(behind.T, torch.tensor([0.7 * 5 - 2.5, 0.9 * 7.5 - 2.5, 0.0]), atol=1e-4)
    late = loss(future, "global_waypoint_at", goal=goals, time=10.0, **own)
    assert torch.allclose(late.T, torch.tensor([17.5 - 3.0, 17.5 - 1.5, 0.0]), atol=1e-4)


def test_social_group_keeps_distance_and_spares_the_leader():
    future = walkers([[0, 0], [0, 2], [9, 9]], [[1, 0], [1, 0], [1, 0]])
    group = torch.tensor([4, 4, -1])
    values = loss(future, "social_group", group=group, distance=1.5)
    assert values[:, 0].tolist() == pytest.approx([0, 50 * 0.25, 0], rel=1e-3)
    g = gradient(future, "social_group", group=group, distance=1.5)
    assert g[0].abs().sum() == 0 and g[2].abs().sum() == 0 and (g[1, ..., 1] > 0).all()


def test_cohesion_mixes_in_random_members():
    future = walkers([[0, 0], [0, 1.5], [0, 6]], [[1, 0]] * 3, samples=40)
    group = torch.zeros(3)
    loose = loss(future, "social_group", group=group, cohesion=0.0)[1]
    tight = loss(future, "social_group", group=group, cohesion=1.0)[1]
    assert loose.max() < 1e-6
    assert tight.mean().item() == pytest.approx(0.5 * 50 * 9, rel=0.1)  # half of the time the one 4.5 m away


def test_target_speed():
    future = walkers([[0, 0], [0, 5]], [[1, 0], [1, 0]])
    assert loss(future, "target_speed", speed=torch.tensor([1.5, NAN]))[:, 0].tolist() == [12.5, 0.0]


def test_minimum_and_maximum_speed_are_squared_shortfall_and_excess():
    future = walkers([[0, 0], [0, 5]], [[1, 0], [2, 0]])
    assert loss(future, "minimum_speed", speed=1.5)[:, 0].tolist() == [12.5, 0.0]
    assert loss(future, "maximum_speed", speed=1.5)[:, 0].tolist() == [0.0, 12.5]


def test_follow_is_the_mean_distance_beyond_the_slack():
    future = walkers([[0, 0], [0, 5]], [[1, 0], [1, 0]])
    way = future.positions[:, 0].detach() + torch.tensor([0.0, 2.0])
    slack = torch.zeros(2, 50)
    slack[1] = 2.5
    assert loss(future, "follow", way=way, slack=slack)[:, 0].tolist() == pytest.approx([2.0, 0.0], abs=1e-4)
    way[0] = NAN
    assert loss(future, "follow", way=way, slack=0.5)[:, 0].tolist() == pytest.approx([0.0, 1.5], abs=1e-4)


def test_of_who_has_no_number_of_their_own_nothing_is_asked():
    future = walkers([[0, 0], [3, 0]], [[1, 0], [1, 0]], samples=4)
    goals, nan = [[2.0, 2.0], [2.0, 2.0]], float("nan")
    timed = loss(future, "waypoint_at", goal=goals, time=[nan, 2.0])
    apart = loss(future, "social_group", group=[0, 0], distance=[1.0, nan])
    assert timed[0].eq(0).all() and timed[1].gt(0).all() and apart.eq(0).all()
    way = torch.zeros(2, 50, 2)
    followed = loss(future, "follow", way=way, slack=[100.0, 0.5])
    assert followed[0].eq(0).all() and torch.equal(followed[1], loss(future, "follow", way=way, slack=0.5)[1])


def test_everybody_may_keep_another_distance():
    future = walkers([[0, 0], [1.2, 0], [0, 9]], [[1, 0]] * 3)
    assert loss(future, "agent_avoid", buffer=torch.tensor([0.2, 0.2, 5.0])).max() == 0
    values = loss(future, "agent_avoid", buffer=torch.tensor([0.2, 1.8, 0.2]))
    assert values[:2, 0].tolist() == pytest.approx([50 * (1 - 1.2 / 1.8)] * 2, rel=1e-3)
    near = walkers([[2, 0], [2, 5]], [[0, 0], [0, 0]], maps=wall())
    depths = loss(near, "obstacle_avoid", buffer=torch.tensor([1.0, 0.0]))[:, 0]
    assert depths[0] > 0.3 * 20 and depths[1] == 0  # who stands counts 0.3 m/s


def test_the_leader_may_be_named_and_groups_differ_in_distance():
    future = walkers([[0, 0], [0, 2], [9, 9], [9, 12]], [[1, 0]] * 4)
    group, leader = torch.tensor([0, 0, 1, 1]), torch.tensor([False, True, True, False])
    wanted = torch.tensor([1.0, 1.0, 3.0, 3.0])
    values = loss(future, "social_group", group=group, distance=wanted, leader=leader)[:, 0]
    assert values.tolist() == pytest.approx([50.0, 0, 0, 0], rel=1e-3, abs=1e-3)
    assert gradient(future, "social_group", group=group, leader=leader)[1].abs().sum() == 0


def test_one_point_for_all_even_if_there_are_two():
    future = walkers([[0, 0], [0, 5]], [[1, 0], [1, 0]])
    both = loss(future, "waypoint_at", goal=[3.0, 4.0], time=3.0)
    each = loss(future, "waypoint_at", goal=[[3.0, 4.0]] * 2, time=torch.tensor([3.0, 3.0]))
    assert torch.equal(both, each)
    with pytest.raises(ObjectiveError, match=r"'waypoint': a parameter has the shape \(3, 2\).* 2 agents"):
        loss(future, "waypoint", goal=[[3.0, 4.0]] * 3)


def test_learned_value():
    future = walkers([[0, 0]], [[1, 0]])
    value = learned_value(lambda future: future.states[..., -1, 0])
    assert value(future).item() == pytest.approx(math.exp(-5.0))


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("agent_avoid", {}),
        ("obstacle_avoid", {}),
        ("waypoint_at", {"goal": [1.0, 1.0], "time": 2.0}),
        ("waypoint", {"goal": [1.0, 1.0]}),
        ("global_waypoint", {"goal": [30.0, 1.0]}),
        ("social_group", {"group": torch.zeros(3), "cohesion": 0.5}),
        ("target_speed", {"speed": 2.0}),
    ],
)
def test_gradients_equal_finite_differences(name, parameters):
    future = walkers(
        [[0.1, 0.2], [0.8, 0.3], [1.03, 1.4]], [[1, 0.1], [0.9, 0.2], [1.1, -0.3]], steps=40, maps=wall(2.0)
    )
    g = torch.autograd.grad(loss(future, name, **parameters).sum(), future.states)[0]
    direction = torch.randn(future.states.shape, generator=torch.Generator().manual_seed(0))
    if name == "social_group":
        direction[0] = 0  # the leader's own influence is cut on purpose
    if name == "obstacle_avoid":  # so are that of the speed and most of that along the motion
        heading = future.states[..., 2].detach()
        across = torch.stack([-heading.sin(), heading.cos()], -1)
        direction[..., :2] = (direction[..., :2] * across).sum(-1, keepdim=True) * across
        direction[..., 3] = 0
    eps = 2e-3

    def at(sign):
        moved = (future.states + sign * eps * direction).detach()
        return (
            loss(Future(moved, future.now, future.radius, maps=future.maps), name, **parameters)
            .double()
            .sum()
        )

    numeric = (at(1) - at(-1)) / (2 * eps)
    assert (g * direction).sum().item() == pytest.approx(numeric.item(), rel=0.03, abs=0.05)


def test_unknown_names_and_parameters_are_explained():
    with pytest.raises(ObjectiveError, match="did you mean 'waypoint'"):
        Objective("waypiont")
    with pytest.raises(ObjectiveError, match=r"'agent_avoid'.*margin"):
        loss(walkers([[0, 0]], [[1, 0]]), "agent_avoid", margin=3)
    with pytest.raises(ObjectiveError, match="negative"):
        Objective("agent_avoid", weight=-1.0)


def test_a_user_adds_an_objective():
    @objective("stay_left")
    def stay_left(future, y=0.0):
        return torch.relu(y - future.positions[..., 1]).sum(-1)

    try:
        assert loss(walkers([[0, 0]], [[1, 0]]), "stay_left", y=0.5).item() == pytest.approx(25.0)
    finally:
        del OBJECTIVES["stay_left"]
