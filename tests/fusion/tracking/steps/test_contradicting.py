"""Contacts of another instant, or of no object, do not pull a track off what the image shows."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion.tracking.checkpoint import restore_tracker, save_tracker
from fusion.tracking.steps.doubts.contradicting import NOT_HERE, strain
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library

FAST = (0.02, 0.03, 0.0, 0.014, 0.004, 0.002)


@pytest.fixture(scope="module")
def seen():
    """A drill that moves 15 mm a frame, what touches it, of unknown worth, and nothing of the hand."""
    model = library.make("drill")
    frames = recording(model, 8, step=FAST)
    return model, [replace(f, hand=None, joints=None, world_from_hand=None) for f in frames]


def with_points(frame, points):
    return replace(frame, contacts=Contacts(points, frame.contacts.normals, sensors=frame.contacts.sensors))


def off(frame, answer, model):
    """How far (m) the answer is from the truth, at the centroid."""
    truth = frame.camera_from_object_truth
    return float(np.linalg.norm(poses.difference(answer.pose, truth, model.centroid)[3:]))


def test_a_correction_is_measured_by_what_a_robot_may_be_off():
    rng, believed, centre = np.random.default_rng(0), CalibrationModel(), np.array([0.1, -0.05, 0.8])
    found = []
    for _ in range(400):
        turn = believed.rotation_sigma * rng.normal(size=3)
        move = believed.translation_sigma * rng.normal(size=3)
        xi = np.concatenate([turn, move + np.cross(turn, centre)])
        found.append(strain(xi, centre, believed))
    assert np.mean(found) == pytest.approx(6.0, rel=0.1)


def test_contacts_that_come_two_frames_late_are_left_out(seen):
    model, frames = seen
    tracker = Tracker(model)
    for k, frame in enumerate(frames):
        late = frames[max(0, k - 2)].contacts
        answer = tracker.step(with_points(frame, late.points))
    assert off(frames[-1], answer, model) < 0.004
    assert answer.verdict == "ok"
    assert NOT_HERE in answer.notes
    again = Tracker(model)
    content = save_tracker(tracker)
    assert len(content) < frames[0].depth.nbytes  # no image is kept with the state
    restore_tracker(again, content)
    last = replace(with_points(frames[-1], frames[-3].contacts.points), index=len(frames))
    np.testing.assert_array_equal(again.step(last).pose, tracker.step(last).pose)


def test_a_sensor_that_has_stopped_is_left_out_and_the_others_are_not(seen):
    model, frames = seen
    tracker = Tracker(model)
    for frame in frames:
        points = frame.contacts.points.copy()
        points[0] = frames[0].contacts.points[0]
        answer = tracker.step(with_points(frame, points))
    assert off(frames[-1], answer, model) < 0.004
    assert answer.verdict == "ok"
    assert NOT_HERE in answer.notes
    assert len(answer.contacts) == len(frames[-1].contacts) - 1


def test_contacts_where_they_are_said_to_be_are_used(seen):
    model, frames = seen
    tracker = Tracker(model)
    for frame in frames:
        answer = tracker.step(with_points(frame, frame.contacts.points))
        assert NOT_HERE not in answer.notes
    assert len(answer.contacts) == len(frames[-1].contacts)
