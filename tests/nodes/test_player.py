import logging

import pytest

from footfall.nodes.transport import Transport


def test_transport_obeys():
    transport = Transport(1.0, paused=False)
    transport.obey("pause", None)
    assert transport.paused and transport.changed
    transport.obey("step", 3)
    transport.obey("step", None)
    assert transport.steps == 4
    transport.obey("seek", 2.5)
    assert transport.seek_ns == 2_500_000_000
    transport.obey("rate", 4)
    assert transport.rate == 4.0
    transport.obey("rate", 0)
    assert transport.rate is None
    transport.obey("resume", None)
    assert not transport.paused


def test_other_controls_are_none_of_its_business():
    transport = Transport(1.0, paused=False)
    transport.obey("log_level", "DEBUG")
    assert not transport.changed


@pytest.mark.parametrize(("name", "value"), [("rate", -1), ("rate", "fast"), ("seek", None), ("step", "x")])
def test_nonsense_is_logged_and_left(name, value, caplog):
    transport = Transport(2.0, paused=False)
    with caplog.at_level(logging.ERROR):
        transport.obey(name, value)
    assert f"control {name}" in caplog.text
    assert (transport.rate, transport.seek_ns, transport.steps) == (2.0, None, 0)
