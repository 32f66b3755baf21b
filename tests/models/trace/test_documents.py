"""The code in the README and in docs/trace.md works as printed."""

import re
from pathlib import Path

import numpy as np
import pytest

import footfall
from footfall.models.trace.objectives import OBJECTIVES, Objective
from footfall.models.trace.planner import Sampling, TracePlanner

pytestmark = pytest.mark.usefixtures("one_thread")

ROOT = Path(footfall.__file__).parent


def code(document: str, contains: str) -> str:
    """The Python block of a document that contains a text."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)
    (block,) = [block for block in blocks if contains in block]
    return block


def test_the_planner_as_a_library():
    names: dict = {}
    exec(compile(code("README.md", "TracePlanner.load()"), "README.md", "exec"), names)
    paths, goals = names["paths"], np.array(names["goals"]["goal"])
    assert paths.shape == (2, 50, 2)
    assert np.linalg.norm(paths - goals[:, None], axis=-1).min(1).max() < 0.7
    assert np.linalg.norm(paths[0] - paths[1], axis=-1).min() > 0.6 - 0.05  # they do not bump into each other
    cells = np.round(paths / 0.1).astype(int)
    assert not names["blocked"][cells[..., 1], cells[..., 0]].any()


def test_the_objective_of_ones_own():
    exec(compile(code("docs/trace.md", "stay_left"), "docs/trace.md", "exec"), {})
    try:
        people = np.zeros((1, 31, 4))
        people[:, :, 0], people[:, :, 3] = 0.12 * np.arange(-30, 1), 1.2
        planner = TracePlanner.load(sampling=Sampling(samples=3))
        ends = [
            planner.plan(people, np.full((1, 2), 0.6), None, [Objective("stay_left", {"y": 2.0}, weight)])
            for weight in (0.0, 1.0)
        ]
        left = [plan.positions[0, plan.chosen[0], -1, 1] for plan in ends]
        assert left[1] > max(1.0, left[0])
    finally:
        del OBJECTIVES["stay_left"]


def test_every_objective_is_in_the_table():
    document = (ROOT / "docs/trace.md").read_text()
    assert [name for name in OBJECTIVES if f"`{name}`" not in document] == []
