"""Inboxes made by hand."""

from collections.abc import Callable

import pytest

from footfall.messages.bus import Received
from footfall.messages.topics import Outgoing
from footfall.nodes.node import Inbox

Fill = Callable[..., Inbox]


@pytest.fixture
def inbox_of() -> Fill:
    """Makes an inbox at a time [s] from addressed messages; give `inbox=` to add to one."""

    def fill(now: float, *messages: Outgoing, inbox: Inbox | None = None) -> Inbox:
        box = inbox or Inbox()
        box.next_step()
        box.now_ns = round(now * 1e9)
        box.deliver(
            Received(m.topic.name, m.topic.name, "test", 0, box.now_ns, 0, m.message) for m in messages
        )
        return box

    return fill
