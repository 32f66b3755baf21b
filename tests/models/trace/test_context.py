import pytest
import torch

from footfall.models.trace.context import from_frame, scene_context, to_frame


def crowd(agents=4, frames=31):
    generator = torch.Generator().manual_seed(0)
    start = torch.rand(agents, 1, 2, generator=generator) * 8
    heading = torch.rand(agents, 1, generator=generator) * 6
    speed = 0.5 + torch.rand(agents, 1, generator=generator)
    time = 0.1 * torch.arange(frames)
    direction = torch.stack([heading.cos(), heading.sin()], -1)
    position = start + (speed * time)[..., None] * direction
    rows = [position, heading.expand(-1, frames)[..., None], speed.expand(-1, frames)[..., None]]
    return torch.cat(rows, -1), torch.full((agents, 2), 0.8)


def test_frames_are_inverse():
    points, pose = torch.randn(5, 7, 3, 2), torch.randn(5, 3)
    assert torch.allclose(from_frame(to_frame(points, pose), pose), points, atol=1e-5)


def test_frame_is_at_the_agent_and_looks_ahead():
    pose = torch.tensor([[1.0, 2.0, torch.pi / 2]])
    local = to_frame(torch.tensor([[[1.0, 2.0], [1.0, 5.0], [0.0, 2.0]]]), pose)
    assert torch.allclose(local, torch.tensor([[[0.0, 0.0], [3.0, 0.0], [0.0, 1.0]]]), atol=1e-6)


def test_straight_walker_sees_its_past_behind_it():
    states, size = crowd()
    context = scene_context(states, size)
    speed = states[:, -1, 3]
    assert torch.allclose(context.ego[:, 0, 0], -3.0 * speed, atol=1e-4)
    assert torch.allclose(context.ego[:, :, 1], torch.zeros(4, 31), atol=1e-4)
    assert torch.allclose(
        context.ego[:, -1, 2:], torch.tensor([1.0, 0.0, 0.0, 0.8, 0.8, 1.0]) + _at(speed), atol=1e-4
    )
    assert torch.equal(context.initial_state()[:, :3], torch.zeros(4, 3))


def _at(speed):
    row = torch.zeros(len(speed), 6)
    row[:, 2] = speed
    return row


def test_context_does_not_depend_on_the_world_frame():
    states, size = crowd()
    pose = torch.tensor([[3.0, -4.0, 1.1]])
    moved = states.clone()
    moved[..., :2] = to_frame(states[None, ..., :2], pose)[0]
    moved[..., 2] -= 1.1
    first, second = scene_context(states, size), scene_context(moved, size)
    assert torch.allclose(first.ego, second.ego, atol=1e-4)
    assert torch.allclose(first.neighbors, second.neighbors, atol=1e-4)


def test_neighbors_are_the_nearest_within_the_radius():
    states, size = crowd(3)
    states[..., :2] = torch.tensor([[0.0, 0.0], [2.0, 0.0], [5.0, 0.0]])[:, None]
    states[..., 2] = 0
    context = scene_context(states, size, max_neighbors=1)
    assert context.neighbors.shape == (3, 1, 31, 8)
    assert context.neighbors[:, 0, -1, 0].tolist() == [2.0, -2.0, -3.0]
    near = scene_context(states, size, radius=2.5)
    assert near.neighbors[:, :, -1, 7].sum(1).tolist() == [1.0, 1.0, 0.0]


def test_absent_frames_are_zero():
    states, size = crowd()
    present = torch.ones(4, 31, dtype=torch.bool)
    present[1, :12] = False
    states[1, :12] = torch.nan
    context = scene_context(states, size, present=present)
    assert torch.isfinite(context.ego).all() and torch.isfinite(context.neighbors).all()
    assert context.ego[1, :12].abs().sum() == 0 and context.ego[1, 12, 7] == 1


def test_dropping_keeps_the_ego_history():
    states, size = crowd()
    context = scene_context(states, size)
    free = context.unconditional()
    assert torch.equal(free.ego, context.ego)
    assert free.neighbors.abs().sum() == 0 and not free.map_known.any()
    some = context.drop(
        maps=torch.zeros(4, dtype=torch.bool), neighbors=torch.tensor([True, False, False, False])
    )
    assert some.neighbors[0].abs().sum() == 0 and torch.equal(some.neighbors[1:], context.neighbors[1:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s, z, p: (s[..., :3], z, p), "4 \\[x y heading speed\\]"),
        (lambda s, z, p: (s, z[:, :1], p), "size must be"),
        (lambda s, z, p: (s, z, p[:, 1:]), "present must be"),
        (lambda s, z, p: (s * torch.nan, z, p), "finite"),
        (lambda s, z, p: (s, z, p & (torch.arange(31) < 30)), "absent now"),
    ],
)
def test_bad_input_is_named(change, message):
    states, size = crowd()
    states, size, present = change(states, size, torch.ones(4, 31, dtype=torch.bool))
    with pytest.raises(ValueError, match=message):
        scene_context(states, size, present=present)
