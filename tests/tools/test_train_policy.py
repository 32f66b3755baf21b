"""Two processes train one policy: half of the worlds each, one checkpoint."""

import os
import subprocess
import sys

import pytest

from footfall.models.pacer.walker_weights import load_walker
from footfall.models.trace.weights import load_tensors

pytestmark = pytest.mark.slow


def train(out, samples, processes):
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    options = ["--worlds", "16", "--threads", "1", "--out", str(out), "--samples", str(samples)]
    options += ["--horizon", "8", "--minibatch", "64"]
    return subprocess.run(
        [sys.executable, *launcher, "-m", "footfall.tools.cli", "train", "pacer", *options],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def test_two_processes_share_the_worlds_and_the_weights(tmp_path):
    done = train(tmp_path, 512, 2)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("from sample 0") == 1 and "8 worlds" in done.stdout
    _, facts = load_tensors(tmp_path / "state.safetensors")
    assert facts["processes"] == 2 and facts["samples"] == 512 and facts["updates"] == 4
    assert facts["config"]["minibatch"] == 64
    model, _, _ = load_walker(tmp_path / "model.safetensors")
    assert all(parameter.isfinite().all() for parameter in model.parameters())
    assert float(model.normalizer.count) > 2 * 16  # both processes' observations
    done = train(tmp_path, 768, 2)
    assert done.returncode == 0 and "from sample 512" in done.stdout, done.stderr
