from dataclasses import replace

import pytest
import torch

from footfall.models.trace.blocks import TemporalNorm
from footfall.models.trace.config import COMPACT, CONFIGS, PAPER, TraceConfig
from footfall.models.trace.context import ego_context, scene_context, to_frame
from footfall.models.trace.network import Trace, crowd_field, nearest_neighbors
from footfall.models.trace.scene_map import SceneMaps
from footfall.models.trace.weights import WeightsError, load_model, save_model, save_tensors

pytestmark = pytest.mark.usefixtures("one_thread")


def maps(scenes=2):
    return SceneMaps(torch.randn(scenes, 1, 40, 40).cumsum(2) / 4, torch.full((scenes, 2), -4.0), 0.2)


def context(agents=3, neighbors=2, seed=0, turn=0.0):
    torch.manual_seed(seed)
    states, near = torch.randn(agents, 31, 4), torch.randn(agents, neighbors, 31, 4)
    known, around = (
        torch.ones(agents, 31, dtype=torch.bool),
        torch.ones(agents, neighbors, 31, dtype=torch.bool),
    )
    if turn:
        pose = torch.tensor([[0.0, 0.0, -turn]])
        for s in (states, near):
            s[..., :2] = to_frame(s[None, ..., :2], pose)[0]
            s[..., 2] += turn
    boxes = torch.full((agents, 2), 0.8), torch.full((agents, neighbors, 2), 0.8)
    return ego_context(
        (states, known, boxes[0]),
        (near, around, boxes[1]),
        None if turn else maps(),
        torch.arange(agents) % 2,
    )


def without_map(c):
    return replace(c, maps=None, map_known=torch.zeros(len(c), dtype=torch.bool))


def run(model, c, seed=1):
    torch.manual_seed(seed)
    noisy, k = torch.randn(len(c), model.config.horizon, 2), torch.arange(len(c)) * 30
    with torch.no_grad():
        return model(noisy, k, model.encode(c))


def test_paper_network_has_the_papers_size():
    model = Trace(PAPER).eval()
    assert sum(p.numel() for p in model.unet.parameters()) == pytest.approx(4.3e6, rel=0.02)
    c = context(2)
    with torch.no_grad():
        features = model.map_encoder.encode(c)
        assert features.grid is not None and features.grid.shape == (2, 32, 56, 56)
        assert model.map_encoder.query(features, torch.zeros(2, 52, 2)).shape == (2, 52, 32)
        encoding = model.encode(c)
        assert encoding.condition.shape == (2, 256)
        assert model(torch.randn(2, 52, 2), torch.tensor([3, 99]), encoding).shape == (2, 52, 2)


def test_paper_raster_looks_14_m_ahead_and_is_grey_where_unknown():
    encoder = Trace(PAPER).map_encoder
    field = SceneMaps(
        torch.linspace(-20, 20, 401).expand(1, 1, 401, 401).contiguous(), torch.full((1, 2), -20.0), 0.1
    )
    states = torch.zeros(2, 31, 4)
    c = ego_context(
        (states, torch.ones(2, 31, dtype=torch.bool), torch.ones(2, 2)),
        (torch.zeros(2, 0, 31, 4), torch.zeros(2, 0, 31, dtype=torch.bool), torch.zeros(2, 0, 2)),
        field,
        torch.zeros(2, dtype=torch.long),
        torch.tensor([True, False]),
    )
    raster = encoder.raster(c)
    assert raster.shape == (2, 2, 224, 224)
    assert (raster[1] == 0.5).all()
    behind = raster[0, 1].mean(1)  # the obstacle layer is solid at x < 0: the rows behind the agent
    assert behind.sum().item() == pytest.approx(12 * 14 / 3, abs=1)
    assert torch.equal(raster[0, 0], 1 - raster[0, 1])


def test_raster_ablation_draws_the_past_of_everybody():
    model = Trace(CONFIGS["compact_raster"]).eval()
    states = torch.zeros(1, 31, 4)
    states[..., 0] = 0.1 * torch.arange(-30, 1)
    other = torch.zeros(1, 1, 31, 4)
    other[..., 1] = 3.0
    present = torch.ones(1, 1, 31, dtype=torch.bool)
    present[..., :10] = False  # the neighbour came later
    size = torch.full((1, 2), 0.8)
    c = ego_context((states, torch.ones(1, 31, dtype=torch.bool), size), (other, present, size[:, None]))
    drawn = model.map_encoder.draw(c)[0, 1:]  # seven frames, half a second apart, the last one is now
    assert drawn.shape == (7, 56, 56)
    metre = 56 / (56 / 3)
    row, column = int(14 / 3 * metre), 28  # where the agent is now
    assert drawn[-1, row, column] == drawn[0, row - 9, column] == 1.0
    assert drawn[0, row, column] == 0.0
    assert drawn[-1, row, column + 9] == -1.0 and (drawn[0] >= 0).all()
    assert (drawn[-1] > 0).sum().item() == pytest.approx(torch.pi * (0.4 * metre) ** 2, abs=2)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=lambda c: c.name)
def test_prediction_does_not_depend_on_the_world_frame(config):
    model = Trace(config).eval()
    assert torch.allclose(run(model, without_map(context())), run(model, context(turn=0.7)), atol=2e-4)


def test_agents_do_not_leak_into_each_other():
    model = Trace(COMPACT).eval()
    c = context(4)
    whole = run(model, c)
    changed = replace(c, ego=c.ego.clone(), neighbors=c.neighbors.clone())
    changed.ego[2] += 1
    changed.neighbors[2] += 1
    other = run(model, changed)
    assert torch.allclose(whole[[0, 1, 3]], other[[0, 1, 3]], atol=1e-5)
    assert (whole[2] - other[2]).abs().max() > 1e-4


def test_neighbor_order_and_padding_do_not_matter():
    model = Trace(COMPACT).eval()
    c = context(3, 3)
    padded = torch.cat([c.neighbors.flip(1), torch.zeros(3, 2, 31, 8)], 1)
    assert torch.allclose(run(model, c), run(model, replace(c, neighbors=padded)), atol=1e-5)
    alone = run(model, replace(c, neighbors=c.neighbors[:, :0]))
    assert torch.allclose(alone, run(model, replace(c, neighbors=torch.zeros_like(c.neighbors))), atol=1e-5)


def test_a_dropped_map_is_an_unknown_map():
    model = Trace(COMPACT).eval()
    c = context()
    dropped = c.drop(maps=torch.ones(3, dtype=torch.bool), neighbors=torch.zeros(3, dtype=torch.bool))
    assert torch.allclose(run(model, dropped), run(model, without_map(c)), atol=1e-6)
    assert (run(model, c) - run(model, dropped)).abs().max() > 1e-4


def test_repeated_encoding_equals_repeated_agents():
    model = Trace(COMPACT).eval()
    c = context(2)
    noisy = torch.randn(2, 1, 52, 2).expand(-1, 3, -1, -1).flatten(0, 1)
    with torch.no_grad():
        many = model(noisy, torch.full((6,), 40), model.encode(c).repeat(3)).unflatten(0, (2, 3))
    assert torch.allclose(many[:, 0], many[:, 2], atol=1e-5)


@pytest.mark.parametrize("config", [COMPACT, PAPER], ids=lambda c: c.name)
def test_everything_learns(config):
    model = Trace(config).train()
    c = context(2)
    model(torch.randn(2, 52, 2), torch.tensor([10, 60]), model.encode(c)).square().sum().backward()
    still = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert not [n for n in still if "bias" not in n]


def test_people_of_a_scene_see_each_others_noisy_futures():
    torch.manual_seed(3)
    states = torch.randn(3, 31, 4)
    whole = scene_context(states, torch.full((3, 2), 0.8))
    assert whole.rows is not None and whole.rows.tolist()[0] != [0, 1]
    model = Trace(COMPACT).eval()
    samples, noisy = 2, torch.randn(6, 52, 2)
    with torch.no_grad():
        together = model(noisy, torch.full((6,), 30), model.encode(whole).repeat(samples))
        # by hand: row 3 is sample 1 of agent 1; its neighbours' sample 1 are rows 2 j + 1
        alone = model.encode(replace(whole, rows=None)).repeat(samples)
        others = torch.zeros(6, 2, 52, 2)
        others[3] = noisy[2 * whole.rows[1] + 1]
        by_hand = model(noisy, torch.full((6,), 30), alone, others)
        straight = model(noisy, torch.full((6,), 30), alone)
    assert torch.allclose(together[3], by_hand[3], atol=1e-5)
    assert (together[3] - straight[3]).abs().max() > 1e-4


def test_without_actions_neighbours_keep_their_velocity():
    model = Trace(COMPACT).eval()
    c = context(2)
    still = (-model.trajectory_mean[4:] / model.trajectory_std[4:]).expand(2, 2, 52, 2)
    noisy, k = torch.randn(2, 52, 2), torch.tensor([20, 70])
    with torch.no_grad():
        encoding = model.encode(c)
        assert torch.allclose(model(noisy, k, encoding), model(noisy, k, encoding, still), atol=1e-4)


def test_nearly_clean_actions_pass_through_an_untrained_network():
    model = Trace(COMPACT).eval()
    encoding, noisy = model.encode(context(2)), torch.randn(2, 52, 2)
    with torch.no_grad():
        clean = model(noisy, torch.tensor([0, 99]), encoding)
    assert (clean[0] - noisy[0]).abs().max() < 0.2
    assert (clean[1] - noisy[1]).abs().max() > 0.5


def test_crowd_field_of_one_neighbor():
    positions, crowd = torch.zeros(1, 2, 2), torch.tensor([[[[0.5, 0.0, 1.0], [9.0, 9.0, 1.0]]]])
    field = crowd_field(positions, crowd)
    weight = torch.exp(torch.tensor(-0.5))
    assert torch.allclose(field[0, 0, :3], torch.stack([weight, weight, torch.tensor(0.0)]))
    assert field[0, 1].abs().max() < 1e-3
    assert crowd_field(positions, crowd * torch.tensor([1.0, 1.0, 0.0])).abs().max() == 0


def test_nearest_neighbors_come_in_order_and_the_absent_and_far_not_at_all():
    here = torch.tensor([[[1.0, 1.0]]])
    far, near, absent = [1.0, 2.5, 1.0], [1.0 - 0.3, 1.4, 1.0], [1.0, 1.1, 0.0]
    crowd = torch.tensor([[[far], [near], [absent]]])
    found = nearest_neighbors(here, crowd, 2)[0, 0]
    assert torch.allclose(found, torch.tensor([-0.6 * 1.5, 0.8 * 1.5, 1.5, 0.0, 0.5, 0.5]))
    assert torch.allclose(nearest_neighbors(here, crowd, 4)[0, 0, 6:], torch.zeros(6))
    assert nearest_neighbors(here, crowd[:, :0], 2).abs().max() == 0
    assert nearest_neighbors(here + 9.0, crowd, 2).abs().max() == 0


def test_weights_return_as_they_were(tmp_path):
    model = Trace(COMPACT)
    model.trajectory_mean.add_(2)
    save_model(tmp_path / "a.safetensors", model, {"step": 7})
    again, facts = load_model(tmp_path / "a.safetensors")
    assert facts["step"] == 7 and again.config == COMPACT
    assert all(
        torch.equal(a, b)
        for a, b in zip(model.state_dict().values(), again.state_dict().values(), strict=True)
    )


def test_broken_weights_are_explained(tmp_path):
    with pytest.raises(WeightsError, match="no weights at"):
        load_model(tmp_path / "none.safetensors")
    (tmp_path / "text.safetensors").write_text("hello, this is no tensor file")
    with pytest.raises(WeightsError, match="holds no TRACE weights"):
        load_model(tmp_path / "text.safetensors")
    save_tensors(tmp_path / "other.safetensors", {"x": torch.zeros(1)}, {"config": COMPACT.to_dict()})
    with pytest.raises(WeightsError, match="does not fit"):
        load_model(tmp_path / "other.safetensors")


def test_config_survives_json_and_names_unknown_fields():
    assert TraceConfig.from_dict(PAPER.to_dict()) == PAPER
    with pytest.raises(ValueError, match="no field 'colour'"):
        TraceConfig.from_dict({"colour": 1})


def test_normalising_in_bfloat16_is_as_exact_as_bfloat16():
    torch.manual_seed(0)
    for channels, rows in ((64, 7), (64, 230), (128, 7)):
        norm = TemporalNorm(8, channels).requires_grad_(False)
        norm.weight.normal_()
        norm.bias.normal_()
        x = torch.randn(rows, channels, 1, 13).bfloat16().to(memory_format=torch.channels_last)
        exact = torch.nn.functional.group_norm(x.double(), 8, norm.weight.double(), norm.bias.double())
        assert torch.equal(norm(x.float()), torch.nn.GroupNorm.forward(norm, x.float()))
        norm.bfloat16()
        torch.testing.assert_close(norm(x).double(), exact, rtol=2e-2, atol=2e-2)


def test_map_and_neighbours_are_looked_up_along_the_last_estimate():
    torch.manual_seed(4)
    model = Trace(COMPACT).eval()
    c = scene_context(torch.randn(3, 31, 4), torch.full((3, 2), 0.8))
    first, second, going = torch.randn(3, 3, 52, 2)
    k = torch.full((3,), 70)
    with torch.no_grad():
        encoding = model.encode(c)
        unaware = model(first, k, encoding)
        assert torch.equal(model(first, k, encoding, estimate=None), unaware)
        aware = model(first, k, encoding, estimate=going)
        assert (aware - unaware).abs().max() > 1e-3
        spy = Spy()
        model.unet = spy  # pyright: ignore  what the network reads: 6 of the noisy trajectory, then what is seen of the rest
        model(first, k, encoding, estimate=going)
        model(second, k, encoding, estimate=going)
    one, other = spy.seen
    assert not torch.equal(one[..., :6], other[..., :6]) and torch.equal(one[..., 6:], other[..., 6:])
    assert (one[..., -1] == 1).all()


class Spy(torch.nn.Module):
    """Keeps what it is given."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.seen: list[torch.Tensor] = []

    def forward(self, x, condition):
        self.seen.append(x)
        return x[..., :2]
