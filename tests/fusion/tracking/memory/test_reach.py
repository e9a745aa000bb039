"""A hand that is clear of the object does not hold it, and what it does not hold has not moved by itself."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_frames import recording

from fusion.tracking.memory.reach import CLEAR, out_of_reach
from fusion.tracking.memory.rest import FRAMES, Rest
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.following_hand import resting
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis.hands import five_finger_hand
from vision.look.hand.hand import camera_from_hand

NOTHING_FELT = Contacts.none()


def aside(pose, metres):
    return poses.make_pose(np.eye(3), [metres, 0.0, 0.0]) @ pose


@pytest.mark.parametrize(("away", "clear"), [(0.0, False), (0.5, True)])
def test_a_hand_is_clear_of_what_is_far_from_all_of_its_surface(lab_frame, drill, away, clear):
    frame = replace(lab_frame, contacts=NOTHING_FELT)
    pose = aside(frame.camera_from_object_truth, away)
    assert out_of_reach(drill, frame, pose, camera_from_hand(frame)) is clear


def test_the_hand_is_as_near_as_its_nearest_part(lab_frame, drill):
    frame = replace(lab_frame, contacts=NOTHING_FELT)
    at = camera_from_hand(frame)
    points = poses.apply(at, frame.hand.points_on_surface(frame.joints))
    for metres in np.linspace(0.0, 0.3, 13):
        pose = aside(frame.camera_from_object_truth, metres)
        gap = drill.field.distance(poses.apply(poses.inverse(pose), points)).min()
        if abs(gap - CLEAR) > 0.006:  # of the hand's surface a point every centimetre is asked
            assert out_of_reach(drill, frame, pose, at) is bool(gap > CLEAR)


@pytest.mark.parametrize("what", ["hand", "joints", "touch"])
def test_of_a_hand_that_nobody_tells_or_that_feels_nothing_is_said(lab_frame, drill, what):
    far = aside(lab_frame.camera_from_object_truth, 0.5)
    frame = lab_frame if what == "touch" else replace(lab_frame, contacts=NOTHING_FELT, **{what: None})
    assert bool(len(frame.contacts.points)) is (what == "touch")
    assert not out_of_reach(drill, frame, far, camera_from_hand(lab_frame))


def test_a_track_is_not_taken_along_by_a_hand_that_is_clear(drill):
    """The robot says that its hand goes 40 mm a frame, far from an object that lies."""
    hand, lying = five_finger_hand(), recording(drill, 1)[0].without_touch()
    lying = replace(lying, hand=hand, joints=dict.fromkeys(hand.joint_names, 0.0))
    tracker = Tracker(drill, seed=0)
    for index in range(4):
        away = aside(lying.world_from_hand, 0.4 + 0.04 * index)
        answer = tracker.step(replace(lying, index=index, world_from_hand=away))
        off = poses.difference(answer.pose, lying.camera_from_object_truth, drill.centroid)
        assert np.linalg.norm(off[3:]) < 0.005
        if index:
            assert not answer.slip
            assert tracker._state.apart
            assert tracker._state.hand is None


def test_what_a_clear_hand_does_not_hold_rests_from_the_first_frame(drill):
    rest = Rest().followed(drill, None, np.eye(4), clear=True)
    rest = rest.followed(drill, np.eye(4), np.eye(4), clear=True)
    np.testing.assert_array_equal(rest.left(drill, aside(np.eye(4), 0.01)), np.eye(4))
    near = rest.followed(drill, np.eye(4), np.eye(4), clear=False)
    assert near.left(drill, aside(np.eye(4), 0.01)) is None


@dataclass(frozen=True)
class Solved:
    pose: np.ndarray
    as_seen: np.ndarray


@pytest.mark.parametrize(
    ("told_apart", "clear", "agrees", "rests"),
    [(False, False, 0.1, True), (True, True, 0.1, True), (True, False, 0.5, True), (True, False, 0.1, False)],
)
def test_behind_a_hand_that_may_push_it_little_tells_that_it_rests(drill, told_apart, clear, agrees, rests):
    predictor = SimpleNamespace(
        predict=lambda pose: SimpleNamespace(agree=np.array([agrees])), costs=lambda both: np.array([0.0, 1.0])
    )
    sensed = SimpleNamespace(told_apart=told_apart, pool=SimpleNamespace(predictor=predictor))
    state = TrackState(rest=Rest(np.eye(4), np.eye(4), FRAMES, np.eye(4)), apart=clear)
    found = aside(np.eye(4), 0.01)
    assert bool(resting(drill, Solved(found, found), sensed, state).pose[0, 3] == 0.0) is rests
