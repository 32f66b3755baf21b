"""Who is let in, who leaves, what people are told."""

from dataclasses import replace

import numpy as np
import pytest

from footfall.messages.agents import AgentStates
from footfall.messages.config import ConfigError
from footfall.messages.objectives import TargetSpeed, Waypoint
from footfall.messages.topics import ADMISSIONS, AGENTS, OBJECTIVES, POPULATION, RECORDED_TRACKS
from footfall.models.scene import RecordedPopulation, Track, load_scene, save_scene
from footfall.nodes.director import Config, Director


def agents(places: dict[int, tuple[float, float]]):
    history = np.zeros((len(places), 31, 7), np.float32)
    history[:, -1, :2] = np.array(list(places.values())).reshape(-1, 2)
    history[:, -1, 6] = 1
    return AGENTS(AgentStates(np.array(list(places), np.int32), np.full(len(places), -1, np.int32), history))


def sent(outgoing, topic):
    return [item.message for item in outgoing if item.topic is topic]


def everybody_in(director, inbox_of, until=60.0):
    """Let time pass with everybody standing where they entered; returns the places and the last inbox."""
    places, inbox = {}, None
    for now in np.arange(0.0, until, 0.5):
        inbox = inbox_of(float(now), agents(places), inbox=inbox)
        for admissions in sent(director.step(inbox), ADMISSIONS):
            places |= {enter.id: enter.position for enter in admissions.enter}
    return places, inbox


def test_the_population_is_told_before_anybody_enters():
    start = list(Director(Config(scene="crossing"), seed=3).start())
    (population,) = sent(start, POPULATION)
    assert len(population.ids) == 20
    assert not sent(start, RECORDED_TRACKS)
    again = sent(Director(Config(scene="crossing"), seed=3).start(), POPULATION)[0]
    other = sent(Director(Config(scene="crossing"), seed=4).start(), POPULATION)[0]
    assert np.array_equal(population.shapes, again.shapes)
    assert not np.array_equal(population.shapes, other.shapes)


def test_everybody_enters_once_clear_of_the_others(inbox_of):
    director = Director(Config(scene="crossing"))
    places, _ = everybody_in(director, inbox_of)
    assert sorted(places) == list(range(20))
    xy = np.array(list(places.values()))
    gaps = np.linalg.norm(xy[:, None] - xy, axis=-1)[np.triu_indices(20, 1)]
    assert gaps.min() >= 0.6
    assert (load_scene("crossing").obstacle_distance(xy) > 0.3).all()


def test_everybody_inside_has_a_goal_and_a_speed(inbox_of):
    director = Director(Config(scene="crossing"))
    told = sent(director.step(inbox_of(30.0, agents({}))), OBJECTIVES)[-1]
    for agent in told.agents:
        kinds = {type(wish) for wish in agent.objectives}
        assert {Waypoint, TargetSpeed} <= kinds
    members = [member for group in told.groups for member in group.members]
    assert len(members) == len(set(members))


def test_who_arrives_in_a_random_scene_walks_on_to_another_place(inbox_of):
    director = Director(Config(scene="crossing", count=1))
    inbox = inbox_of(30.0, agents({}))
    told = sent(director.step(inbox), OBJECTIVES)[-1]
    goal = told.agents[0].objectives[0].position
    inbox = inbox_of(31.0, agents({0: goal}), inbox=inbox)
    outgoing = director.step(inbox)
    (admissions,) = sent(outgoing, ADMISSIONS)
    assert (admissions.reached, admissions.leave) == ([0], [])
    there = sent(outgoing, OBJECTIVES)[-1].agents[0].objectives[0].position
    assert np.linalg.norm(np.subtract(there, goal)) > 3.0


def recorded_scene(folder, tracks):
    scene = load_scene("corridor")
    return save_scene(replace(scene, population=RecordedPopulation(tracks), events=()), folder)


def test_people_of_a_recording_enter_where_they_did_and_leave_on_arrival(tmp_path, inbox_of):
    times = np.arange(0.0, 5.0, 0.1)
    track = np.column_stack([times, -3 + times, np.zeros_like(times)])
    folder = recorded_scene(tmp_path / "walk", (Track(7, track),))
    director = Director(Config(scene=str(folder)))
    (recorded,) = sent(director.start(), RECORDED_TRACKS)
    assert recorded.positions == pytest.approx(track[:, 1:])
    (admissions,) = sent(director.step(inbox_of(0.0, agents({}))), ADMISSIONS)
    assert admissions.enter[0].position == pytest.approx((-3, 0))
    assert admissions.enter[0].speed == pytest.approx(1.0)
    outgoing = director.step(inbox_of(4.0, agents({0: (track[-1, 1], 0.0)})))
    (admissions,) = sent(outgoing, ADMISSIONS)
    assert admissions.leave == [0]
    assert sent(outgoing, OBJECTIVES)[-1].agents == []


@pytest.mark.parametrize(
    ("config", "text"),
    [(Config(scene="crosing"), "crossing"), (Config(scene="crossing", count=0), "nobody enters")],
)
def test_a_scene_that_cannot_be_played_is_refused_in_one_sentence(config, text):
    with pytest.raises(ConfigError, match=text):
        Director(config)
