"""What is handed to viser: a real server, no browser."""

from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.structs import replace

from footfall.messages.agents import AgentStates
from footfall.messages.diagnostics import LogLine
from footfall.messages.map import Obstacle
from footfall.messages.steering import DropObstacle, Push, SetWaypoint
from footfall.messages.topics import PLANS
from footfall.nodes.viewer_clicks import Clicks
from footfall.nodes.viewer_light import in_linear_light
from footfall.nodes.viewer_panels import Panels
from footfall.nodes.viewer_people import colour_of
from footfall.nodes.viewer_picture import Picture
from footfall.nodes.viewer_refusals import Refusals
from footfall.nodes.viewer_scene import Scene
from footfall.nodes.viewer_server import Window
from footfall.nodes.viewer_steering import OBSTACLE, PUSH, SELECT, WAYPOINT, SteeringPanel, obstacle_at
from footfall.nodes.viewer_trails import SPACING, Trails
from footfall.tools.view import LogViewer
from footfall.tools.view_log import LogPictures


@pytest.fixture(scope="module")
def window() -> Iterator[Window]:
    window = Window("127.0.0.1", 0, "test")
    yield window
    window.close()


@pytest.fixture
def server(window):
    window.server.scene.reset()
    window.server.gui.reset()
    return window.server


def drawn(server, name: str):
    return server.scene.get_handle_by_name(name)


def test_people_stand_where_their_bodies_are(server, run_log):
    picture = LogPictures(run_log).show(2.5)
    scene = Scene(server)
    scene.draw(picture)
    states = picture.states
    assert states is not None and scene._parts
    for part, handle in scene._parts:
        assert handle.batched_positions == pytest.approx(states.positions[:, part.body], abs=1e-5)
        assert (handle.batched_scales > 0.5).all()
    chosen = drawn(server, "/run/plans").points
    assert chosen[:, 0, 0].min() == pytest.approx(0.5)  # from where they are
    assert chosen[..., 0].max() == pytest.approx(0.5 + 1.2 * 5.0, abs=1e-4)  # to the end of the chosen sample
    assert drawn(server, "/run/samples").points.shape[1:] == (2, 3)
    assert len(drawn(server, "/run/contacts").batched_positions) == 1
    assert len(drawn(server, "/run/waypoints").batched_positions) == 3
    assert len(drawn(server, "/run/groups").points) == 1
    assert drawn(server, "/run/labels/fall4").text == "#4 has fallen"
    crate, tower = drawn(server, "/run/obstacles/0"), drawn(server, "/run/buildings/0")
    assert crate.opacity is None and crate.vertices[:, 2].max() == 1.0
    assert tower is None  # high, but nobody can hide behind one metre


def test_houses_are_see_through_and_a_new_obstacle_paints_no_new_ground(server, yard):
    scene, picture, place = Scene(server), Picture(), yard()
    house = Obstacle("house", np.array([[-4.0, -4.0], [-1.0, -4.0], [-1.0, -1.0]]), 6.0)
    picture.take("map", place, 0)
    scene.draw(picture)
    ground = drawn(server, "/run/ground")
    picture.take("map", replace(place, obstacles=[*place.obstacles, house]), 1)
    scene.draw(picture)
    assert drawn(server, "/run/ground") is ground
    assert drawn(server, "/run/buildings/0").opacity < 1
    scene.shown.buildings = False
    scene.draw(picture, everything=True)
    assert drawn(server, "/run/buildings/0") is None and drawn(server, "/run/obstacles/0") is not None
    raster = place.raster.copy()
    raster[1, :5] = 1
    picture.take("map", replace(place, raster=raster), 2)
    scene.draw(picture)
    assert drawn(server, "/run/ground") is not ground


def test_what_is_switched_off_or_over_goes_away(server, run_log):
    pictures = LogPictures(run_log)
    scene = Scene(server)
    scene.draw(pictures.show(2.6))
    scene.draw(pictures.show(3.5))
    assert drawn(server, "/run/contacts") is None
    scene.shown.plans = scene.shown.people = False
    scene.draw(pictures.show(3.5), everything=True)
    assert drawn(server, "/run/plans") is None
    assert all((handle.batched_scales < 1e-3).all() for _, handle in scene._parts)
    scene.draw(pictures.show(1.0))
    assert not scene._labels


def test_a_plan_s_past_is_not_drawn(server, run_log):
    pictures = LogPictures(run_log)
    scene = Scene(server)
    scene.draw(pictures.show(2.4))
    lines = drawn(server, "/run/plans").points
    first = lines[: len(lines) // 3]
    assert first[0, 0, 0] == pytest.approx(0.4)
    assert (np.diff(first[:, 0, 0]) > 0).all()
    assert len(first) == 50 - 4


def test_two_runs_are_told_apart_by_colour_or_place(server, run_log):
    viewer = LogViewer(server, [LogPictures(run_log), LogPictures(run_log)])
    viewer.time_line.seek(2.0)
    viewer.refresh()
    one, other = (drawn(server, f"/{name}/tracks").colors[0, 0] for name in ("first", "second"))
    assert (one != other).any()
    server.scene.reset()
    server.gui.reset()
    viewer = LogViewer(server, [LogPictures(run_log), LogPictures(run_log)], beside=True)
    viewer.time_line.seek(2.0)
    viewer.refresh()
    assert drawn(server, "/second").position == pytest.approx([14.0, 0.0, 0.0])
    assert (drawn(server, "/second/tracks").colors[0, 0] == in_linear_light(colour_of(0) // 2)).all()


def test_clicks_select_or_steer(server, messages):
    picture, sent = Picture(), []
    for time, item in messages():
        if time <= 1.0:
            picture.take(item.topic.name, item.message, round(time * 1e9))
    panels = Panels(server, [Scene(server)])
    clicks = Clicks(server, lambda: picture, panels.select)
    panel = SteeringPanel(server, sent.append)
    panel.connect(panels, clicks, lambda: picture)
    panels.update(picture)
    eye = np.array([-1.0, -6.0, 5.0])
    clicks.click(eye, np.array([-1.0, -1.0, 1.0]) - eye)
    assert panels.selected == 0 and "#0" in panels._choice.value
    panel._action.value = WAYPOINT
    clicks.click(eye, np.array([2.0, 2.0, 0.0]) - eye)
    command = sent.pop().command
    assert isinstance(command, SetWaypoint) and command.agent == 0
    assert command.position == pytest.approx((2.0, 2.0))
    panel._action.value = OBSTACLE
    clicks.click(eye, np.array([2.0, -2.0, 0.0]) - eye)
    command = sent.pop().command
    assert isinstance(command, DropObstacle) and command.name == "dropped 1"
    assert np.mean(command.polygon, axis=0) == pytest.approx([2.0, -2.0])
    panel._action.value = PUSH
    clicks.click(eye, np.array([2.0, 2.0, 0.0]) - eye)  # nobody there
    assert not sent
    clicks.click(eye, np.array([-1.0, -1.0, 1.0]) - eye)
    assert sent.pop().command == Push(0, (300.0, 0.0, 0.0))
    panel._action.value = SELECT
    assert clicks.on_place is None
    assert obstacle_at(picture, (3.6, 3.4)) == "crate" and obstacle_at(picture, (0.0, 0.0)) is None
    assert PLANS.name in picture.changed


def test_ways_of_the_whole_run_grow_with_time(server, run_log):
    pictures = LogPictures(run_log)
    scene = Scene(server, trails=pictures.trails)
    scene.draw(pictures.show(3.0))
    assert drawn(server, "/run/trails") is None
    scene.shown.trails = True
    scene.draw(pictures.show(3.0), everything=True)
    points = drawn(server, "/run/trails").points
    lengths = np.linalg.norm(np.diff(points[..., :2], axis=1), axis=-1)
    assert lengths.sum() == pytest.approx(3 * 3.0, abs=3 * SPACING)  # three people, a metre a second
    assert points[..., 0].min() == pytest.approx(-2.0) and points[..., 0].max() <= 1.0
    scene.draw(pictures.show(1.0), everything=True)
    assert len(drawn(server, "/run/trails").points) < len(points)


def test_who_comes_back_has_not_walked_there():
    def here(x: float, *ids: int) -> AgentStates:
        history = np.zeros((len(ids), 31, 7), np.float32)
        history[:, -1, 0] = x
        return AgentStates(np.array(ids, np.int32), np.full(len(ids), -1, np.int32), history)

    trails = Trails()
    for stamp, (x, *ids) in enumerate([(0.0, 1, 2), (0.5, 1, 2), (1.0, 2), (1.2, 1, 2), (9.0, 2), (9.1, 2)]):
        trails.take(here(x, *ids), stamp)
    ids, segments = trails.until(99)
    assert sorted(ids.tolist()) == [1, 2, 2] == sorted(ids.tolist())
    assert np.abs(np.diff(segments[..., 0], axis=1)).max() == pytest.approx(0.5)
    assert trails.until(0)[1].shape == (0, 2, 2)


def test_a_refusal_is_told_once_and_other_lines_are_not(server):
    told = Refusals(server)
    line = LogLine("director", "WARNING", "steering: there is no person 9; they are numbered 0 to 4\n")
    assert told.take(line) == "there is no person 9; they are numbered 0 to 4"
    assert told.take(line) is None  # pressed twice
    assert told.take(LogLine("director", "INFO", "steering: x")) is None
    assert told.take(LogLine("planner", "WARNING", "slow")) is None
