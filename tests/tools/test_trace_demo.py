"""The demonstration: groups find together, waypoints are met, the picture is a picture."""

import numpy as np
import pytest
import torch

from footfall.models.trace.planner import Sampling, TracePlanner
from footfall.tools.trace_demo import draw, groups

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def planner():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield TracePlanner.load(sampling=Sampling(samples=6))
    torch.set_num_threads(threads)


def test_groups_come_together(planner):
    walked, group = groups(planner)
    for number in (0, 1):
        members = walked[group == number]
        apart = np.linalg.norm(members[:, None] - members, axis=-1) + 99 * np.eye(3)[..., None]
        assert apart[..., -1].min(1).max() < 2.0 < apart[..., 0].min(1).max()


def test_waypoints_are_met_and_drawn(planner, tmp_path):
    missed = draw(tmp_path / "new" / "demo.png", planner)
    assert missed.shape == (3,) and missed.max() < 1.0
    assert (tmp_path / "new" / "demo.png").read_bytes().startswith(b"\x89PNG")
