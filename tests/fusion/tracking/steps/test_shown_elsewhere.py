"""A mask that shows the object elsewhere than it was predicted: a track without a hand follows it there."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import off_by, recording

from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory.state import Renewal, RenewalSettings, TrackState
from fusion.tracking.steps import searching
from fusion.tracking.steps.predicting import Predicted, where_shown
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.synthesis import library

# From frame to frame, as a camera at a few images a second sees it (rad, m).
LEAP = (0.02, 0.05, 0.0, 0.05, 0.02, 0.0)
S = TrackSettings()


def masked(frame):
    """The frame with its mask, and nothing of a hand."""
    return replace(frame.without_touch(), mask=frame.depth > 0, world_from_hand=None)


@pytest.fixture(scope="module")
def drill():
    return library.make("drill")


@pytest.fixture(scope="module")
def leaping(drill):
    return [masked(frame) for frame in recording(drill, 5, step=LEAP)]


def predicted(frame, by):
    """A prediction that is off by so many metres along the image."""
    truth = frame.camera_from_object_truth
    pose = poses.make_pose(truth[:3, :3], truth[:3, 3] + [by, 0.0, 0.0])
    return Predicted(Belief(pose, np.eye(6), np.eye(6), np.eye(6)), (), "at its last velocity")


@pytest.mark.parametrize(("by", "moved"), [(0.0, False), (0.01, False), (0.12, True), (-0.25, True)])
def test_where_the_mask_shows_it(drill, leaping, by, moved):
    frame = leaping[0]
    found = where_shown(drill, frame, predicted(frame, by), TrackState(), S)
    assert (found is not None) is moved
    if found is not None:
        off = found.belief.pose[:3, 3] - frame.camera_from_object_truth[:3, 3]
        assert np.linalg.norm(off) < 0.3 * drill.radius
        assert "mm from there" in found.why


@pytest.mark.parametrize("lacks", ["mask", "depth", "in time", "object"])
def test_nothing_is_shown(drill, leaping, lacks):
    frame, state = leaping[0], TrackState()
    if lacks == "in time":
        state = TrackState(index=frame.index + 1)
    elif lacks == "object":
        frame = replace(frame, mask=np.zeros_like(frame.mask))
    else:
        frame = replace(frame, **{lacks: None})
    assert where_shown(drill, frame, predicted(leaping[0], 0.2), state, S) is None


def test_what_leaps_is_found_in_the_frame_in_which_it_leapt(drill, leaping):
    tracker = Tracker(drill)
    answers = [tracker.step(frame) for frame in leaping]
    assert answers[0].how == "started"
    for answer, frame in zip(answers[1:], leaping[1:]):
        degrees, millimetres = off_by(answer, frame, drill)
        assert answer.verdict == "ok", (frame.index, answer.notes)
        assert degrees < 3.0
        assert millimetres < 5.0
    assert any(answer.how == "re-initialised" for answer in answers)


def test_what_no_search_finds_is_told_to_be_where_the_mask_is(drill, leaping, monkeypatch):
    tracker = Tracker(drill)
    tracker.step(leaping[0])
    monkeypatch.setattr(searching, "recover", lambda *_: None)
    answer = tracker.step(leaping[1])
    assert (answer.verdict, answer.how) == ("lost", "carried")
    assert answer.notes[0] == "the mask shows it elsewhere: moved there"
    assert off_by(answer, leaping[1], drill)[1] < 0.5e3 * drill.radius


def test_a_mask_of_nothing_like_it_is_not_followed(drill, leaping):
    tracker = Tracker(drill)
    tracker.step(leaping[0])
    wall = np.full_like(leaping[1].depth, 2.0)
    answer = tracker.step(replace(leaping[1], depth=wall, mask=np.ones_like(leaping[1].mask)))
    assert answer.verdict == "lost"


def test_it_is_followed_there_whatever_was_in_vain_before(drill, leaping):
    tracker = Tracker(drill)
    tracker.step(leaping[0])
    tracker._state.renewal.alone = 1000
    answer = tracker.step(leaping[1])
    assert off_by(answer, leaping[1], drill)[1] < 5.0


def test_searches_in_vain_grow_rarer():
    how, renewal = RenewalSettings(), Renewal()
    renewal.restart(7, how)
    assert renewal.alone == 8
    waits = []
    for _ in range(8):
        renewal.in_vain(renewal.alone, how)
        waits.append(renewal.patience)
    assert waits == [2, 4, 8, 16, 16, 16, 16, 16]
    renewal.restart(100, how)
    assert (renewal.alone, renewal.patience) == (101, 1)
