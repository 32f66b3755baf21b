"""Strikes, symmetry and usual steps, where they can be told by hand."""

import numpy as np
import pytest

from footfall.models.pacer.gait_measures import Steps, _asymmetry, _strikes


def test_a_strike_is_a_foot_that_comes_down_and_stays():
    stands = np.zeros((100, 2), dtype=bool)
    stands[10:40, 0] = stands[60:90, 0] = True
    stands[11, 0] = False  # chatter, 0.1 s
    stands[35:65, 1] = True
    left, right = _strikes(stands, 0.05)
    assert left == pytest.approx([0.5, 3.0])
    assert right == pytest.approx([1.75])


def test_a_limp_is_measured():
    left = np.arange(0.0, 10.0, 1.0)
    assert _asymmetry(left, left + 0.5) == pytest.approx(0.0, abs=1e-9)
    assert _asymmetry(left, left + 0.6) == pytest.approx(0.4)
    assert np.isnan(_asymmetry(left[:2], left[:2] + 0.5))


def test_usual_steps_keep_the_walk_ratio():
    steps = Steps(1.3, speed=1.3, cadence=1.9, asymmetry=0.0, skate=0.0, standing=1.0)
    assert steps.usual_step_length / (60 * steps.usual_cadence) == pytest.approx(0.0065)
    assert steps.step_length == pytest.approx(1.3 / 1.9)
