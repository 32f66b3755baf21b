"""The score against runs whose score is known beforehand."""

import numpy as np
import pytest

from footfall.messages.agents import AgentStates
from footfall.messages.body import Bodies, Falls
from footfall.messages.map import Obstacle, SemanticMap
from footfall.messages.population import Admissions, RecordedTracks
from footfall.messages.topics import ADMISSIONS, AGENTS, BODIES, FALLS, MAP, RECORDED_TRACKS
from footfall.nodes.referee import Config, Referee

SQUARE = Obstacle("box", np.array([[5.0, -1.0], [6.0, -1.0], [6.0, 1.0], [5.0, 1.0]]))
PLACE = MAP(SemanticMap("test", ["walkable"], np.ones((1, 4, 4), np.uint8), 5.0, (-10.0, -10.0), [SQUARE]))


def bodies(count: int, radius: float = 0.25):
    zeros = np.zeros(count, np.float32)
    return BODIES(
        Bodies(
            np.arange(count, dtype=np.int32),
            np.zeros((count, 10), np.float32),
            zeros,
            zeros,
            zeros + radius,
            np.zeros((count, 24, 3), np.float32),
        )
    )


def agents(*places: tuple[float, float]):
    history = np.zeros((len(places), 31, 7), np.float32)
    history[:, -1, :2] = np.array(places).reshape(-1, 2)
    history[:, -1, 6] = 1
    ids = np.arange(len(places), dtype=np.int32)
    return AGENTS(AgentStates(ids, np.full(len(places), -1, np.int32), history))


def play(inbox_of, *frames, first=()):
    """The last score of a referee who has seen one frame each tenth of a second, then a whole second."""
    referee = Referee(Config())
    inbox, scores = None, []
    for number, frame in enumerate(frames):
        extra = (PLACE, bodies(4), *first) if number == 0 else ()
        inbox = inbox_of(number / 10, *extra, frame, inbox=inbox)
        scores += referee.step(inbox)
    inbox = inbox_of(100.0, agents(), inbox=inbox)
    scores += referee.step(inbox)
    return scores[-1].message


def test_disks_apart_do_not_overlap(inbox_of):
    score = play(inbox_of, *[agents((0, 0), (0.51, 0))] * 10)
    assert (score.agent_overlap_seconds, score.collisions) == (0.0, 0)
    assert score.agent_seconds == pytest.approx(2.0)
    assert score.entered == 2


def test_both_of_an_overlapping_pair_are_charged_and_the_touch_counts_once(inbox_of):
    score = play(inbox_of, *[agents((0, 0), (0.4, 0))] * 10)
    assert score.agent_overlap_seconds == pytest.approx(2.0)
    assert score.collisions == 1


def test_a_pair_that_parts_and_meets_again_collides_twice(inbox_of):
    meet, part = agents((0, 0), (0.4, 0)), agents((0, 0), (1.0, 0))
    assert play(inbox_of, meet, part, meet).collisions == 2


@pytest.mark.parametrize(("x", "overlap"), [(4.74, 0.0), (4.76, 0.3), (5.5, 0.3)])
def test_an_obstacle_is_overlapped_from_one_radius_away(inbox_of, x, overlap):
    assert play(inbox_of, *[agents((x, 0))] * 3).obstacle_overlap_seconds == pytest.approx(overlap)


def test_distance_from_recorded_tracks_is_the_mean_while_recorded(inbox_of):
    times = np.array([0.1, 0.3])
    tracks = RECORDED_TRACKS(RecordedTracks(np.zeros(2, np.int32), times, np.array([[0.0, 0.0], [2.0, 0.0]])))
    score = play(inbox_of, *[agents((0, 0))] * 6, first=(tracks,))
    assert score.track_distance == pytest.approx((0.0 + 1.0 + 2.0) / 3)
    assert score.tracked_seconds == pytest.approx(0.3)


def test_goals_and_falls_are_counted(inbox_of):
    fall = FALLS(Falls(np.array([1, 2], np.int32), np.zeros((2, 3), np.float32), "report"))
    score = play(inbox_of, agents((0, 0)), first=(ADMISSIONS(Admissions(leave=[3], reached=[3])), fall))
    assert (score.goals_reached, score.falls) == (1, 2)
