"""The bench of the window, on a small crowd and for a short time: every figure is there and can be."""

import json

import pytest

from footfall.messages.config import ConfigError
from footfall.tools.bench_viewer import measure
from footfall.tools.cli import main

pytestmark = pytest.mark.slow


def test_figures_of_a_small_crowd(capsys):
    arguments = ["--scene", "crossing", "--people", "3", "--turns", "1", "--turn", "3", "--clicks", "1"]
    assert main(["bench", "viewer", *arguments, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["real_time_factor_with"] > 0 and figures["real_time_factor_without"] > 0
    assert figures["ratio"] == pytest.approx(
        figures["real_time_factor_with"] / figures["real_time_factor_without"]
    )
    assert 0 < figures["updates_per_s"] <= 33 and 0 < figures["viewer_cores"] < 2
    assert figures["megabytes_per_s"] > 0
    assert figures["clicks"] == 1 and 0 < figures["click_to_plan_median_s"] < 60


def test_a_graph_that_does_not_start_says_why():
    with pytest.raises(ConfigError, match=r"does not start: .*crossin"):
        measure("crossin", "orca", 2, 1, 1.0, 0)
