import argparse
import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
import torch

from footfall.models.trace.crowd_file import pack_crowds
from footfall.models.trace.orca_scenes import CrowdSpec, simulate_crowds
from footfall.models.trace.planner import DISTILLED
from footfall.models.trace.weights import load_model, load_tensors
from footfall.tools import train_distil, train_trace


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("orca")
    for subset in ("maps", "interact"):
        spec = replace(CrowdSpec(substeps=1), subset=subset)
        pack_crowds(spec, simulate_crowds(spec, 0, range(10)), 0).save(folder / f"{subset}.npz")
    return [str(folder / f"{subset}.npz") for subset in ("maps", "interact")]


def arguments(data, out, steps):
    shared = [
        "trace",
        "--data",
        *data,
        "--out",
        str(out),
        "--batch",
        "8",
        "--check-every",
        "2",
        "--full-precision",
    ]
    return [*shared, "--threads", "1", "--decay", "0", "--steps", str(steps)]


def run(data, out, steps, *more):
    parser = argparse.ArgumentParser()
    train_trace.add_parser(parser.add_subparsers())
    args = parser.parse_args([*arguments(data, out, steps), *more])
    return args.run(args)


@pytest.fixture(autouse=True)
def keep_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def curve(folder):
    with (folder / "curve.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def weights(folder):
    return load_tensors(folder / "state.safetensors")[0]


def test_resuming_is_the_same_as_going_on(data, tmp_path):
    assert run(data, tmp_path / "whole", 6) == 0
    assert run(data, tmp_path / "parts", 3) == 0
    assert run(data, tmp_path / "parts", 6) == 0
    whole, parts = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert whole.keys() == parts.keys()
    assert all(torch.allclose(whole[k], parts[k], atol=1e-6) for k in whole)


def test_weights_in_half_precision_are_those_of_the_run_rounded(data, tmp_path):
    assert run(data, tmp_path / "whole", 2) == run(data, tmp_path / "half", 2, "--half") == 0
    whole, half = (load_tensors(tmp_path / name / "model.safetensors")[0] for name in ("whole", "half"))
    assert whole["joint.0.weight"].dtype == torch.float32 and half["joint.0.weight"].dtype == torch.float16
    assert torch.equal(half["joint.0.weight"], whole["joint.0.weight"].half())
    states = weights(tmp_path / "whole"), weights(tmp_path / "half")
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_a_run_leaves_weights_curve_and_picture(data, tmp_path):
    assert run(data, tmp_path, 4) == 0
    _, facts = load_model(tmp_path / "model.safetensors")
    assert facts["step"] == 4 and facts["samples"] == 32
    assert [d["name"] for d in facts["data"]] == ["orca-maps", "orca-interact"]
    rows = curve(tmp_path)
    assert [r["step"] for r in rows] == ["2", "4"] and float(rows[0]["orca-maps"]) > 0
    assert (tmp_path / "curve.png").stat().st_size > 1000


def test_training_learns(data, tmp_path):
    assert run(data, tmp_path, 56, "--batch", "16", "--rate", "1e-3") == 0
    rows = curve(tmp_path)
    assert float(rows[-1]["orca-interact"]) < 0.8 * float(rows[0]["orca-interact"])


def test_missing_data_is_explained(tmp_path, capsys):
    assert run([str(tmp_path / "none.npz")], tmp_path, 1) == 2
    assert "footfall data orca" in capsys.readouterr().err


def process(command, data, out, steps):
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", *command, *arguments(data, out, steps)]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


@pytest.mark.slow
def test_ctrl_c_leaves_a_checkpoint(data, tmp_path):
    run_ = process(["footfall.tools.train_trace"], data, tmp_path, 100000)
    deadline = time.monotonic() + 120
    while not (tmp_path / "curve.csv").is_file() and time.monotonic() < deadline:
        time.sleep(0.2)
    run_.send_signal(signal.SIGINT)
    output, _ = run_.communicate(timeout=60)
    assert run_.returncode == 0, output
    assert "stopped at step" in output and "Traceback" not in output
    assert load_model(tmp_path / "model.safetensors")[1]["step"] >= 2


@pytest.mark.slow
def test_two_processes_train_one_model(data, tmp_path):
    launcher = [
        "torch.distributed.run",
        "--standalone",
        "--nproc-per-node",
        "2",
        "-m",
        "footfall.tools.train_trace",
    ]
    run_ = process(launcher, data, tmp_path, 4)
    output, _ = run_.communicate(timeout=240)
    assert run_.returncode == 0, output
    _, facts = load_model(tmp_path / "model.safetensors")
    assert facts["step"] == 4 and facts["batch"] == 16 and facts["samples"] == 64


def test_weights_to_begin_with_bring_what_they_have_behind_them(data, tmp_path, capsys):
    first, second = tmp_path / "first", tmp_path / "second"
    assert run(data, first, 2) == 0
    begin = ["--init", str(first / "model.safetensors"), "--touch", "20", "--calm", "2"]
    assert run(data, second, 1, *begin) == 0
    assert run(data, second, 3, *begin) == 0  # resumed, not begun again
    tensors, facts = load_tensors(second / "model.safetensors")
    assert facts["step"] == 5 and facts["samples"] == 5 * 8 and (facts["touch"], facts["calm"]) == (20, 2)
    assert [source["name"] for source in facts["data"]] == ["orca-maps", "orca-interact", "start"]
    again, old = tensors["trajectory_mean"], load_tensors(first / "model.safetensors")[0]["trajectory_mean"]
    assert torch.equal(again, old)
    assert run(data, tmp_path / "third", 1, "--config", "compact_global", *begin[:2]) == 2
    assert "another configuration than --config compact_global" in capsys.readouterr().err


def distil(data, out, steps, *more):
    parser = argparse.ArgumentParser()
    train_distil.add_parser(parser.add_subparsers())
    args = parser.parse_args(["distil", *arguments(data, out, steps)[1:], "--reuse", "2", *more])
    return args.run(args)


def test_a_student_resumes_as_if_it_had_gone_on_and_knows_its_steps(data, tmp_path):
    steps = ["--timesteps", "99", "60", "20", "--touch", "1", "--rate", "0.05"]  # a 500th at first
    assert distil(data, tmp_path / "whole", 4, *steps) == 0
    assert distil(data, tmp_path / "parts", 3, *steps) == 0
    assert distil(data, tmp_path / "parts", 4, *steps) == 0
    whole, parts = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert all(torch.allclose(whole[k], parts[k], atol=1e-5) for k in whole)
    file = tmp_path / "whole" / "model.safetensors"
    model, facts = load_model(file)
    assert model.config.name == "compact_distilled" and model.config.timesteps == (99, 60, 20)
    assert facts["context_weight"] == 0.5 and facts["step"] == 66804
    assert load_tensors(file)[0]["joint.0.weight"].dtype == torch.float16
    more = ["--init", str(file), "--timesteps", "99", "50"]
    assert distil(data, tmp_path / "more", 1, *more) == 0  # a student begins with another


def test_a_student_cannot_teach_and_steps_must_fall(data, tmp_path, capsys):
    for steps in (["20", "60"], ["120", "60"], ["60", "0"], ["60"]):
        assert distil(data, tmp_path, 1, "--timesteps", *steps) == 2
        assert "two or more step indices that fall, from 99 to 1" in capsys.readouterr().err
    assert distil(data, tmp_path, 1, "--teacher", str(DISTILLED)) == 2
    assert "is distilled itself" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--rate", "inf"),
        ("--touch", "nan"),
        ("--calm", "-1"),
        ("--check-every", "0"),
        ("--save-minutes", "nan"),
    ],
)
def test_numbers_that_no_training_can_have_are_refused(data, tmp_path, capsys, option, value):
    assert run(data, tmp_path / "run", 1, option, value) == 2
    assert option in capsys.readouterr().err and not (tmp_path / "run").exists()


def test_training_that_diverges_says_so_and_keeps_what_was_saved(data, tmp_path):
    assert run(data, tmp_path / "run", 1) == 0
    before = (tmp_path / "run" / "model.safetensors").read_bytes()
    with pytest.raises(train_trace.TrainingError, match="the loss of step"):
        run(data, tmp_path / "run", 20, "--rate", "1e30")
    assert (tmp_path / "run" / "model.safetensors").read_bytes() == before
