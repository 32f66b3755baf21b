"""One list says what a picture is made of: it is wired live, and read from logs."""

from footfall.launch.viewing import with_viewer
from footfall.launch.wiring import complete
from footfall.messages.graph import Graph, NodeSpec
from footfall.messages.shown_topics import SHOWN
from footfall.messages.topics import TOPICS
from footfall.nodes.viewer_picture import Picture
from footfall.tools.view_log import EVENTS, STATES, STREAMS


def test_the_live_window_hears_every_topic_of_the_list():
    outputs = {shown.topic.name: shown.topic.name for shown in SHOWN}
    graph = with_viewer(complete(Graph("g", [NodeSpec("all", "x", outputs=outputs)])), {})
    wires = graph.node("viewer").inputs
    for shown in SHOWN:
        wire = wires[shown.topic.name]
        assert (wire.depth if wire.policy == "queue" else 0) == shown.queue
    alone = with_viewer(complete(Graph("g", [NodeSpec("one", "x", outputs={"agents": "agents"})])), {})
    assert "plans" not in alone.node("viewer").inputs


def test_a_picture_forgets_what_it_can_take():
    for topic in (*STATES, *STREAMS):
        picture, before = Picture(), Picture()
        picture.take(topic.name, "something", 0)
        assert picture != (before if topic.name else None)
        picture.forget(topic.name)
        picture.changed = set()
        assert picture == before, topic.name


def test_kinds_share_out_the_list():
    kinds = {*STATES, *STREAMS, *(event.topic for event in EVENTS)}
    assert {shown.topic for shown in SHOWN} - kinds == {TOPICS["admissions"]}  # falls are found anew in a log
