"""Training the VAE, and training that begins with weights."""

import argparse

import pytest
import torch

from footfall.models.trace.crowd_file import pack_crowds
from footfall.models.trace.orca_scenes import CrowdSpec, simulate_crowds
from footfall.models.trace.vae import load_vae
from footfall.models.trace.weights import load_model
from footfall.tools import train_trace


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("orca") / "maps.npz"
    spec = CrowdSpec(substeps=1)
    pack_crowds(spec, simulate_crowds(spec, 0, range(10)), 0).save(path)
    return path


@pytest.fixture(autouse=True)
def keep_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def run(data, out, *more, steps=2):
    parser = argparse.ArgumentParser()
    train_trace.add_parser(parser.add_subparsers())
    shared = ["--batch", "8", "--check-every", "10", "--threads", "1", "--steps", str(steps), "--decay", "0"]
    args = parser.parse_args(["trace", "--data", str(data), "--out", str(out), *shared, *more])
    return args.run(args)


def test_the_vae_learns_and_is_read_back(data, tmp_path):
    assert run(data, tmp_path, "--model", "vae", "--rate", "1e-2", steps=40) == 0
    _, facts = load_vae(tmp_path / "model.safetensors")
    assert facts["step"] == 40  # within the warm-up of the learning rate
    rows = [line.split(",") for line in (tmp_path / "curve.csv").read_text().split()]
    assert float(rows[-1][4]) < 0.9 * float(rows[1][4])


def test_training_goes_on_from_given_weights(data, tmp_path, capsys):
    assert run(data, tmp_path / "first", steps=1) == 0
    given = tmp_path / "first" / "model.safetensors"
    assert run(data, tmp_path / "second", "--init", str(given), "--seed", "5", "--rate", "1e-9", steps=1) == 0
    (first, _), (second, facts) = (
        load_model(tmp_path / x / "model.safetensors") for x in ("first", "second")
    )
    near = [torch.allclose(v, second.state_dict()[k], atol=1e-6) for k, v in first.state_dict().items()]
    assert all(near) and facts["data"][-1]["name"] == "start"
    assert run(data, tmp_path / "third", "--init", str(given), "--config", "paper", steps=1) == 2
    assert "another configuration" in capsys.readouterr().err
    assert run(data, tmp_path / "third", "--init", str(given), "--model", "vae", steps=1) == 2
    assert "another model" in capsys.readouterr().err
