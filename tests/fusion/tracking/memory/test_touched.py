"""What fingers have felt stays evidence when they let go, and a search that is not sure does not undo it."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

import fusion.tracking.steps.searching as searching
from fusion.estimation.posterior.verdict import VerdictSettings
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import GlanceSettings
from fusion.tracking.memory.touched import Touched
from fusion.tracking.motion import HandState
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library

ELSEWHERE = np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.1])


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def tracked(model, touching=6, last=7):
    """A tracker, looking at all frames in full, whose fingers touch until frame `touching`, with the last answer."""
    tracker = Tracker(model, settings=TrackSettings(glance=GlanceSettings(every=1)))
    frames = recording(model, last + 1)
    for frame in frames:
        answer = tracker.step(frame if frame.index < touching else frame.without_touch())
    return tracker, frames[-1], answer


def test_what_was_felt_is_explained_where_it_was_felt_and_not_elsewhere(mug):
    points, normals = mug.sample_surface(4, seed=0)
    pose = poses.exp(np.array([0.3, -0.2, 0.1, 0.0, 0.1, 0.6]))
    hand = poses.exp(np.array([0.1, 0.5, 0.0, 0.0, 0.0, 0.5]))
    contacts, rules = Contacts(points, normals, 0.001).moved(pose), VerdictSettings()
    by = HandState(hand, None, tuple(contacts.sensors), points)
    felt = Touched.of(mug, contacts, by, hand, pose, rules)
    assert felt is not None
    motion = poses.exp(np.array([0.0, 0.4, 0.0, 0.1, 0.0, 0.0]))  # of hand and object
    there, hand = motion @ pose, motion @ hand
    assert not felt.is_let_go(mug, there, there, hand, rules)
    assert felt.is_let_go(mug, poses.perturb(there, ELSEWHERE, mug.centroid), there, hand, rules)
    # an object that has moved in the hand since has room for as much
    near = poses.perturb(there, np.array([0.0, 0.0, 0.0, 0.02, 0.0, 0.0]), mug.centroid)
    assert not felt.is_let_go(mug, near, near, hand, rules)
    # an answer that does not explain its contacts remembers none
    assert Touched.of(mug, contacts, by, np.eye(4), poses.perturb(pose, ELSEWHERE, mug.centroid), rules) is None


def test_fingers_that_let_go_are_remembered(mug):
    touching, _, _ = tracked(mug, touching=8)
    let_go, _, _ = tracked(mug, touching=6)
    assert let_go._state.touched is not None
    assert len(let_go._state.touched.points) == len(touching._state.touched.points)
    let_go.believe(recording(mug, 1)[0], let_go.estimated(recording(mug, 1)[0], None))
    assert let_go._state.touched is None


@pytest.mark.parametrize("verdict", ["ambiguous", "ok"])
def test_a_search_that_is_not_sure_does_not_undo_what_was_felt(mug, verdict):
    tracker, frame, answer = tracked(mug)
    there = poses.perturb(answer.pose, ELSEWHERE, mug.centroid)
    alone = tracker.estimated(replace(frame, prior=None), None)
    mode = replace(alone.modes[0], pose=there)
    found = replace(alone, pose=there, as_seen=there, modes=(mode,), verdict=verdict, confidence=0.9)
    asked = tracker._sensed, tracker._state, lambda what, frame, prior: found
    searching.renew(mug, frame, answer, *asked, lambda *_: None, tracker.settings)
    far = [h for h in tracker._state.hypotheses if np.linalg.norm(h.pose[:3, 3] - answer.pose[:3, 3]) > 0.1]
    assert bool(far) == (verdict == "ok")


def released(model, count=10, let_go=5, step=0.03):
    """Frames of a hand that lets go of what it has carried before frame `let_go`, and goes on without it."""
    frames = recording(model, count)
    stands, out = frames[let_go - 1], []
    for frame in frames:
        if frame.index < let_go:
            out.append(frame)
            continue
        gone = poses.make_pose(np.eye(3), [step * (frame.index - let_go + 1), 0.0, 0.0]) @ stands.world_from_hand
        truth = stands.camera_from_object_truth
        out.append(
            replace(stands.without_touch(), index=frame.index, world_from_hand=gone, camera_from_object_truth=truth)
        )
    return out


def test_what_a_hand_has_let_go_of_is_not_carried_on_with_it(mug):
    tracker = Tracker(mug)
    answers = [tracker.step(frame) for frame in released(mug)]
    assert tracker._state.released
    assert tracker._state.hand is None
    truth = recording(mug, 5)[-1].camera_from_object_truth
    for answer in answers[5:]:
        assert np.linalg.norm((answer.pose - truth)[:3, 3]) < 0.004
    assert sum(answer.how == "re-initialised" for answer in answers) <= 1
    assert all(answer.how == "tracked" for answer in answers[7:])


def test_a_hand_that_stays_where_it_touched_still_holds(mug):
    """Fingers that feel nothing for a while have let go only when what they felt is elsewhere."""
    tracker, _, _ = tracked(mug, touching=4, last=7)
    assert not tracker._state.released
    assert tracker._state.hand is not None


def test_what_is_felt_again_is_carried_again(mug):
    tracker = Tracker(mug)
    frames = released(mug)
    for frame in frames:
        tracker.step(frame)
    back = replace(recording(mug, 5)[-1], index=len(frames))
    tracker.step(back)
    assert not tracker._state.released
    assert tracker._state.hand is not None


def test_a_late_frame_says_nothing_of_what_is_held_now(mug):
    tracker = Tracker(mug)
    for frame in released(mug):
        if frame.index != 3:
            tracker.step(frame)
    assert tracker._state.released
    tracker.step(recording(mug, 4)[-1])  # the third, in which it was held
    assert tracker._state.released
