"""Where nobody tells what hides the object, a track follows what must be seen, not rows that fingers pull away."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import Tracker
from fusion.tracking.steps.by_picture import meant, walked
from fusion.tracking.steps.refining import loose
from scenes.geometry import poses
from scenes.synthesis.recording import synthesize_frames


def sensed_of(frames, model):
    """What a tracker has sensed of the last frame when it begins at the truth."""
    tracker = Tracker(model, use=("vision",))
    for frame in frames:
        tracker.step(replace(frame, prior=frames[0].camera_from_object_truth if frame is frames[0] else None))
    return tracker._sensed, tracker.settings


@pytest.fixture(scope="module")
def frames(drill, hand):
    return synthesize_frames(drill, hand, 2, 0.3, noise="lab", seed=3, scene="table", motion="carry")


def off_mm(pose, frame):
    return 1e3 * float(np.linalg.norm(pose[:3, 3] - frame.camera_from_object_truth[:3, 3]))


@pytest.mark.parametrize("aside_mm", [8.0, -8.0])
def test_a_fit_that_slid_aside_is_given_up_for_what_must_be_seen(frames, drill, aside_mm):
    unknown = [replace(f, hand=None, joints=None, world_from_hand=None) for f in frames]
    sensed, settings = sensed_of(unknown, drill)
    assert not sensed.told_apart
    truth = frames[-1].camera_from_object_truth
    slid = poses.perturb(truth, np.array([0.0, 0.0, 0.0, 1e-3 * aside_mm, 0.0, 0.0]), drill.centroid)
    prior = loose(slid, 1e-8 * np.eye(6), settings)
    found = walked(drill, prior, slid, sensed, settings)
    assert found is not None
    assert off_mm(found.pose, frames[-1]) < 0.5 * off_mm(slid, frames[-1])
    np.testing.assert_array_equal(walked(drill, prior, slid, sensed, settings).pose, found.pose)


def test_a_right_fit_stays(frames, drill):
    unknown = [replace(f, hand=None, joints=None, world_from_hand=None) for f in frames]
    sensed, settings = sensed_of(unknown, drill)
    truth = frames[-1].camera_from_object_truth
    found = walked(drill, loose(truth, 1e-8 * np.eye(6), settings), truth, sensed, settings)
    assert found is None or off_mm(found.pose, frames[-1]) < 3.0


def test_where_the_hand_is_known_rows_decide(frames, drill):
    sensed, settings = sensed_of(frames, drill)
    assert sensed.told_apart
    truth = frames[-1].camera_from_object_truth
    assert walked(drill, loose(truth, 1e-8 * np.eye(6), settings), truth, sensed, settings) is None
    solved = object()
    assert meant(drill, solved, sensed, settings) is solved
