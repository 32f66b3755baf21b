import numpy as np
import pytest

from footfall.messages.compare import Tolerance, first_difference
from footfall.messages.diagnostics import LogLine
from footfall.messages.objectives import AgentObjectives, Objectives, SocialDistance, Waypoint
from footfall.messages.plan import Plans


def plans(**changes) -> Plans:
    fields = {
        "ids": np.array([1, 2], np.int32),
        "chosen": np.array([0, 0], np.int32),
        "positions": np.zeros((2, 1, 3, 2), np.float32),
        "headings": np.zeros((2, 1, 3), np.float32),
        "speeds": np.zeros((2, 1, 3), np.float32),
        "method": "orca",
    }
    return Plans(**(fields | changes))


def changed(index, value) -> np.ndarray:
    positions = np.zeros((2, 1, 3, 2), np.float32)
    positions[index] = value
    return positions


def test_same():
    assert first_difference(plans(), plans()) is None
    nan = plans(speeds=np.full((2, 1, 3), np.nan, np.float32))
    assert first_difference(nan, nan) is None


def test_element_of_an_array():
    found = first_difference(plans(), plans(positions=changed((1, 0, 2, 1), 0.5)))
    assert found and (found.field, found.index) == ("positions", (1, 0, 2, 1))
    assert (found.left, found.right) == (0.0, 0.5)
    assert found.text == "positions[1, 0, 2, 1]: 0.0 and 0.5"


def test_nan_differs_from_a_number():
    found = first_difference(
        plans(), plans(positions=changed((0, 0, 0, 0), np.nan)), Tolerance((), {"positions": 9})
    )
    assert found and found.index == (0, 0, 0, 0)


def test_tolerance_is_by_field():
    near = plans(positions=changed((1, 0, 2, 1), 1e-7))
    assert first_difference(plans(), near)
    assert first_difference(plans(), near, Tolerance((), {"positions": 1e-6})) is None
    assert first_difference(plans(), near, Tolerance((), {"speeds": 1e-6}))


def test_ignored_and_volatile_fields():
    assert first_difference(plans(), plans(method="x"), Tolerance(["method"])) is None
    assert first_difference(plans(planning_time=1.0), plans(planning_time=2.0)) is None
    line = LogLine("a", "INFO", "text", wall_time="now")
    assert first_difference(line, LogLine("a", "INFO", "text", wall_time="then")) is None


@pytest.mark.parametrize(
    ("other", "field", "values"),
    [
        (plans(ids=np.array([1, 3], np.int32)), "ids", (2, 3)),
        (plans(headings=np.zeros((2, 1, 4), np.float32)), "shape of headings", ((2, 1, 3), (2, 1, 4))),
        (plans(method="x"), "method", ("orca", "x")),
        (plans(loss_names=["a"]), "length of loss_names", (0, 1)),
        (plans(losses=np.zeros((2, 1, 1), np.float32)), "losses", None),
    ],
)
def test_where(other, field, values):
    found = first_difference(plans(), other)
    assert found and found.field == field
    assert values is None or (found.left, found.right) == values


def objectives(weight: float, second: float = 0.2) -> Objectives:
    return Objectives(
        [AgentObjectives(3), AgentObjectives(4, [Waypoint((1.0, 2.0)), SocialDistance(second, weight)])]
    )


def test_deep_paths():
    found = first_difference(objectives(1.0), objectives(2.0))
    assert found and found.field == "agents[1].objectives[1].weight"
    assert first_difference(objectives(1.0), objectives(2.0), Tolerance(["weight"])) is None
    assert first_difference(objectives(1.0), objectives(2.0), Tolerance(["agents.objectives.weight"])) is None
    assert first_difference(objectives(1.0), objectives(1.05), Tolerance((), {"weight": 0.1})) is None
    one, other = Waypoint((0.0, 0.0)), SocialDistance()
    found = first_difference(AgentObjectives(1, [one]), AgentObjectives(1, [other]))
    assert found and found.field == "objectives[0]"


def test_plain_data():
    assert first_difference({"a": [1, 2.0]}, {"a": [1, 2.0]}) is None
    found = first_difference({"a": 1}, {"b": 1})
    assert found and found.field == "keys"
    assert first_difference({"a": True}, {"a": "True"})
