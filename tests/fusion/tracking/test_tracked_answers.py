"""What a track's answers say of one pose, and of frames between: the same thing in every field."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

import fusion.tracking.tracker as tracking
from fusion import Tracker
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import EstimateSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory.state import TrackState
from fusion.tracking.motion import HandMotion
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.predicting import predict
from fusion.tracking.steps.printed import as_before
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames
from vision.tracking.by_vision import ConstantVelocity


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_a_frame_that_tells_nothing_keeps_where_the_object_is_in_the_hand(hand, drill):
    frames = synthesize_frames(drill, hand, 8, 0.3, noise="lab", seed=5, motion="carry")
    nothing = replace(frames[6], depth=np.zeros_like(frames[6].depth), rgb=None, contacts=Contacts(np.zeros((0, 3))))
    tracker = Tracker(drill)
    answers = [tracker.step(frame) for frame in (*frames[:6], nothing)]
    assert answers[-1].how == "carried"
    before, after = (answer.hand_from_object for answer in answers[-2:])
    np.testing.assert_allclose(1e3 * after[:3, 3], 1e3 * before[:3, 3], atol=1.0)


def test_an_object_found_again_is_one_way_round_in_every_field():
    box = library.make("box")
    frame = recording(box, count=1)[0]
    found = estimate(frame, box)
    turned = found.pose @ box.symmetries.discrete[1]
    told = as_before(box, found, replace(found, pose=turned), EstimateSettings())
    np.testing.assert_allclose(told.pose, turned, atol=1e-12)
    np.testing.assert_array_equal(told.modes[0].pose, told.pose)
    turn = poses.inverse(found.pose) @ told.pose
    np.testing.assert_allclose(told.as_seen, found.as_seen @ turn)
    if found.hand_from_object is not None:
        np.testing.assert_allclose(told.hand_from_object, found.hand_from_object @ turn)


def test_what_frames_do_not_tell_stays_untold_without_a_hand(mug):
    hidden = np.diag([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    belief = Belief(poses.make_pose(None, [0.0, 0.0, 0.5]), 1e-6 * np.eye(6), np.zeros((6, 6)), hidden)
    velocity = ConstantVelocity(mug.centroid)
    velocity.restart(0, belief.pose)
    beliefs = Beliefs()
    watch = SlipWatch(mug, beliefs.depth.bias_length)
    frame = replace(recording(mug, count=1)[0], index=1, hand=None, world_from_hand=None)
    moving = velocity, HandMotion(mug), watch
    ahead = predict(mug, frame, belief, TrackState(belief=belief, index=0), *moving, CalibrationModel(), None)
    np.testing.assert_allclose(ahead.belief.hidden, hidden)


def test_searches_of_a_track_believe_what_it_was_told(mug, monkeypatch):
    asked = []

    def listening(frame, model, *rest, beliefs=None, **kinds):
        asked.append(beliefs)
        return estimate(frame, model, *rest, beliefs=beliefs, **kinds)

    monkeypatch.setattr(tracking, "estimate", listening)
    told = Beliefs()
    tracker = Tracker(mug, beliefs=told)
    tracker.step(recording(mug, count=1)[0])
    assert asked
    assert all(one is told for one in asked)


def test_an_image_that_is_not_looked_at_is_said_before_a_track_has_begun(mug):
    frames = recording(mug, count=2)
    empty = replace(frames[0], depth=np.zeros_like(frames[0].depth), contacts=Contacts(np.zeros((0, 3))))
    camera = frames[1].camera
    longer = replace(frames[1], camera=replace(camera, fx=1.5 * camera.fx, fy=1.5 * camera.fy))
    tracker = Tracker(mug)
    assert tracker.step(empty).verdict == "lost"
    assert any("focal lengths" in note for note in tracker.step(longer).notes)
