"""A track takes the way round from what is printed, and not from another object's print."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import Tracker
from fusion.tracking.answer import TrackSettings
from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.staging.prints import with_print


@pytest.fixture(scope="module", params=["box", "cylinder"])
def sequence(request, hand):
    model = with_print(library.make(request.param))
    return synthesize_frames(model, hand, 3, 0.3, noise="lab", seed=3, scene="print", motion="carry"), model


def off(pose, frame):
    """Degrees between a pose and the truth, symmetries or not."""
    return float(np.rad2deg(poses.rotation_angle(pose[:3, :3].T @ frame.camera_from_object_truth[:3, :3])))


def test_a_track_that_began_at_another_face_turns_to_what_is_printed(sequence):
    frames, model = sequence
    turned = model.symmetries.discrete[1]
    unseen = replace(frames[0], rgb=None, prior=frames[0].prior @ turned)
    tracker = Tracker(model)
    first = tracker.step(unseen)
    assert off(first.pose, frames[0]) > 90.0
    answers = [tracker.step(replace(frame, prior=None)) for frame in frames[1:]]
    assert off(answers[-1].pose, frames[-1]) < 20.0
    assert answers[-1].print_share > 0.95
    np.testing.assert_allclose(answers[-1].modes[0].pose, answers[-1].pose)


def test_without_the_print_it_stays_where_it_began(sequence):
    frames, model = sequence
    plain = TrackSettings()
    plain = replace(plain, first=replace(plain.first, texture=replace(plain.first.texture, used=False)))
    tracker = Tracker(model, settings=plain)
    tracker.step(replace(frames[0], prior=frames[0].prior @ model.symmetries.discrete[1]))
    answer = tracker.step(replace(frames[1], prior=None))
    assert off(answer.pose, frames[1]) > 90.0
    assert np.isnan(answer.print_share)
