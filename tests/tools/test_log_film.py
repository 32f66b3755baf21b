"""Films of logs: what is drawn over the people."""

import numpy as np
import pytest

from footfall.messages.body import BodyStates
from footfall.messages.map import HeightField
from footfall.messages.objectives import AgentObjectives, Objectives, Waypoint
from footfall.messages.plan import Plans
from footfall.nodes.viewer_people import colour_of
from footfall.tools.log_film import PLAN_STRIDE, Overlay, strokes_of


def plans_of(*ids: int) -> Plans:
    """Two samples each: the second, chosen, leads along x at 1 m/s from x = 0."""
    positions = np.zeros((len(ids), 2, 50, 2), np.float32)
    positions[:, 1, :, 0] = 0.1 * np.arange(1, 51)
    flat = 0 * positions[..., 0]
    return Plans(
        np.array(ids, np.int32), np.ones(len(ids), np.int32), positions, flat, flat, "orca", [], None, 0.0
    )


def test_plans_begin_at_the_person_and_forget_what_has_gone_by():
    states = BodyStates(np.array([3], np.int32), np.zeros((1, 24, 13), np.float32))
    states.joints[0, 0, :2] = 1.0, 0.2
    overlay = Overlay(1.0, plans_of(3, 8), Objectives([AgentObjectives(3, [Waypoint((4.0, 5.0))])]))
    way, pin = strokes_of(overlay, states, None)  # nobody draws for 8, who is not there
    assert way.points[0, :2] == pytest.approx([1.0, 0.2])
    assert way.points[1, 0] == pytest.approx(1.1)
    assert np.diff(way.points[1:, 0]) == pytest.approx(0.1 * PLAN_STRIDE)
    assert way.points[:, 2] == pytest.approx(way.points[0, 2])
    assert way.colour == pytest.approx(colour_of(3) / 255)
    assert pin.points[0] == pytest.approx([4.0, 5.0, 0.0]) and pin.points[1, 2] > 0.5
    slope = HeightField(np.array([[0.0, 1.0], [0.0, 1.0]], np.float32), 10.0, (0.0, 0.0))
    way, pin = strokes_of(overlay, states, slope)
    assert way.points[:, 2] - way.points[0, 2] == pytest.approx(0.1 * (way.points[:, 0] - 1.0), abs=1e-6)
    assert pin.points[0, 2] == pytest.approx(0.4)
    old = Overlay(9.0, plans_of(3), Objectives())
    assert strokes_of(old, states, None) == []
