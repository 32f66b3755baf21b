"""What a picture makes of messages, live and from a log."""

import numpy as np
import pytest

from footfall.messages.clock import Clock
from footfall.messages.log import LogError, LogWriter
from footfall.messages.topics import CLOCK, LOG, SCORE
from footfall.models.scene import Terrain
from footfall.nodes.viewer_panels import lines_html, nodes_html, person_html, topics_html
from footfall.nodes.viewer_pick import pick_ground, pick_person
from footfall.nodes.viewer_picture import Picture, heights_at
from footfall.tools.view import TimeLine
from footfall.tools.view_log import LogPictures


def live(messages, until: float) -> Picture:
    picture = Picture()
    for time, item in messages():
        if time > until + 1e-6:
            break
        picture.take(item.topic.name, item.message, round(time * 1e9))
    return picture


@pytest.mark.parametrize("times", [[0.0, 2.7, 1.3, 4.0], [3.5, 0.4], [2.55]])
def test_a_log_shows_at_any_moment_what_was_seen_live(messages, run_log, times):
    pictures = LogPictures(run_log)
    for time in times:
        seen, expected = pictures.show(time), live(messages, time)
        assert seen.states is not None and expected.states is not None
        assert np.array_equal(seen.states.joints, expected.states.joints)
        assert seen.agents is not None and expected.agents is not None
        assert np.array_equal(seen.agents.history, expected.agents.history)
        assert seen.plans_ns == expected.plans_ns
        assert seen.objectives == expected.objectives
        assert (seen.contacts is None) == (expected.contacts is None)
        assert [f.agent for f in seen.recent_falls()] == ([4] if 2.5 <= time <= 5.5 else [])
        assert [r[-1][1].steps for r in seen.reports.values()] == [2 * int(time)]
        assert seen.methods == {"planner": "trace"}
        assert [line.text for line in seen.lines] == ["<b>slow</b>"]


def test_only_what_differs_is_read_again(run_log):
    pictures = LogPictures(run_log)
    picture = pictures.show(1.0)
    picture.changed = set()
    pictures.show(1.0)
    assert picture.changed == set()
    pictures.show(1.1)
    assert picture.changed == {"agents", "body_states"}


def test_a_log_with_nobody_in_it_is_refused(tmp_path):
    with LogWriter(tmp_path / "a.mcap") as writer:
        writer.write_message(CLOCK, "simulator", 0, 0, 0, Clock(0, 1, "lockstep"))
    with pytest.raises(LogError, match="nobody is in it"):
        LogPictures(tmp_path / "a.mcap")


def test_time_that_jumps_back_leaves_no_future_behind(messages):
    picture = live(messages, 3.0)
    assert picture.recent_falls()
    picture.take(CLOCK.name, Clock(3, 1, "lockstep"), 100_000_000)
    assert picture.now == pytest.approx(0.1)
    assert not picture.falls


def test_heights_agree_with_the_scene_s_own(yard):
    ground = yard(0.2).terrain
    points = np.random.default_rng(0).uniform(-7, 7, (200, 2))
    expected = Terrain(ground.heights, ground.resolution, ground.origin).height_at(points)
    assert heights_at(ground, points) == pytest.approx(expected)


def test_a_click_finds_the_person_under_it_and_the_ground(messages, yard):
    picture = live(messages, 1.0)  # people at x = -1, y = -1, 0, 1
    eye = np.array([-1.0, -6.0, 5.0])
    assert pick_person(picture, eye, np.array([-1.0, -1.0, 1.0]) - eye) == 0
    assert pick_person(picture, eye, np.array([-1.0, 1.0, 1.5]) - eye) == 4
    assert pick_person(picture, eye, np.array([2.0, 2.0, 0.0]) - eye) is None
    assert pick_person(picture, eye, eye - np.array([-1.0, -1.0, 1.0])) is None  # behind the camera
    assert pick_ground(picture, eye, np.array([2.0, 2.0, 0.0]) - eye) == pytest.approx((2.0, 2.0))
    assert pick_ground(picture, eye, np.array([0.0, 0.0, 1.0])) is None
    picture.place = yard(0.2)
    x, y = pick_ground(picture, eye, np.array([2.0, 2.0, 0.4]) - eye) or (0.0, 0.0)
    assert (x, y) == pytest.approx((2.0, 2.0), abs=1e-3)


def test_the_read_outs_tell_the_numbers(messages):
    picture = live(messages, 3.2)
    text = person_html(picture, 1)
    for part in ("1.20, 0.00 m", "1.00 m/s", "sample 2 of 3", "plan age</td><td", "0.20 s", "led by #0"):
        assert part in text
    assert "loss waypoint" in text and "4 (best 3)" in text
    assert "trace" in text
    assert "not there" in person_html(picture, 9)
    assert "50 %" in nodes_html(picture)
    assert "2.0 Hz" in topics_html(picture)
    assert "<b>slow" not in lines_html(picture)
    assert "&lt;b&gt;slow" in lines_html(picture)


def test_losses_of_a_topic_are_those_of_its_subscribers(messages):
    picture = live(messages, 1.0)
    reports = picture.reports["planner"]
    lost = reports[-1][1].inputs[0]
    assert (lost.dropped, lost.rejected) == (3, 1)
    map_row = [row for row in topics_html(picture).split("<tr>") if "map_server" in row]
    assert not map_row  # map_server itself has not reported
    assert SCORE.name not in picture.changed and LOG.name in picture.changed


def test_the_time_line_plays_stops_and_loops():
    line = TimeLine(2.0, 4.0)
    line.advance(1.0)
    assert line.time == 2.0
    line.playing, line.speed = True, 2.0
    line.advance(0.5)
    assert line.time == 3.0
    line.advance(1.0)
    assert (line.time, line.playing) == (4.0, False)
    line.playing = line.loop = True
    line.advance(0.25)
    assert line.time == pytest.approx(2.5) and line.playing
    line.seek(9.0)
    assert line.time == 4.0
