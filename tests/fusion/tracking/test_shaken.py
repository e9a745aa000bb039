"""What moves faster than its velocity foretold is looked at again from where it was found, as unsure as it is fast."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import off_by, recording

from fusion import track
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief, Measurement
from fusion.tracking.memory.hypotheses import Hypothesis
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.predicting import Predicted, as_moved
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from vision.tracking.by_vision import FASTEST, VelocitySettings

HOW = VelocitySettings()


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def state_at(pose, index=4):
    return TrackState(belief=Belief(pose, np.eye(6), np.zeros((6, 6))), index=index)


def test_what_moves_may_be_elsewhere_at_the_time_of_the_frame(mug):
    before = poses.make_pose(np.eye(3), [0.0, 0.0, 0.6])
    after = poses.perturb(before, np.array([0.0, 0.0, 0.1, 0.02, 0.0, 0.0]), mug.centroid)
    smear = state_at(before).smear(mug, 5, after, HOW)
    np.testing.assert_allclose(smear, HOW.exposure * np.array([0.0, 0.0, 0.1, 0.02, 0.0, 0.0]), atol=1e-12)
    # two frames later it moved half as fast; a late frame tells of no speed
    np.testing.assert_allclose(state_at(before).smear(mug, 6, after, HOW), 0.5 * smear, atol=1e-12)
    assert not state_at(before).smear(mug, 4, after, HOW).any()
    # what is seen of a hand that is known is where that is seen, and what comes from afar was not there
    assert not replace(state_at(before), hand=object()).smear(mug, 5, after, HOW).any()
    far = poses.perturb(before, np.array([0.0, 0.0, 0.0, 1.1 * FASTEST, 0.0, 0.0]), mug.centroid)
    assert not state_at(before).smear(mug, 5, far, HOW).any()
    assert not TrackState().smear(mug, 5, after, HOW).any()


def test_a_turn_about_an_axis_of_symmetry_is_no_motion():
    can = library.make("cylinder")
    before = poses.make_pose(np.eye(3), [0.0, 0.0, 0.6])
    axis = can.symmetries.axes[0].direction
    spun = poses.perturb(before, np.array([*(0.3 * np.asarray(axis)), 0.0, 0.0, 0.0]), can.centroid)
    assert np.abs(state_at(before).smear(can, 5, spun, HOW)).max() < 1e-6


def test_a_measurement_is_as_unsure_as_the_thing_is_fast():
    still = Measurement(np.eye(4), 1e-6 * np.eye(6), np.zeros((6, 6)))
    moving = still.smeared(np.array([0.0, 0.0, 0.0, 0.003, 0.0, 0.0]))
    assert moving.own[3, 3] == pytest.approx(1e-6 + 0.003**2)
    np.testing.assert_array_equal(still.smeared(np.zeros(6)).own, still.own)


def test_a_prediction_goes_where_the_frame_was_solved_to(mug):
    at = poses.make_pose(poses.exp_rotation(np.array([0.3, -0.2, 0.1])), [0.02, 0.0, 0.6])
    aside = poses.perturb(at, np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]), mug.centroid)
    belief = Belief(at, 1e-6 * np.eye(6), 4e-6 * np.eye(6))
    others = tuple(Hypothesis(pose, 1e-6 * np.eye(6), 0.0) for pose in (at, aside))
    delta = np.array([0.0, 0.05, 0.0, 0.012, 0.0, 0.0])
    there = poses.perturb(at, delta, mug.centroid)
    moved = as_moved(mug, Predicted(belief, others, "at its last velocity"), there)
    np.testing.assert_allclose(moved.belief.pose, there, atol=1e-12)
    np.testing.assert_allclose(moved.hypotheses[0].pose, there, atol=1e-12)
    # what else it may be goes with it, and what is not known of the motion is as large as what was not foretold
    np.testing.assert_allclose(
        poses.inverse(moved.hypotheses[0].pose) @ moved.hypotheses[1].pose, poses.inverse(at) @ aside, atol=1e-12
    )
    assert moved.belief.own[3, 3] > 0.012**2
    assert "12 mm from there" in moved.why


@pytest.mark.parametrize("use", [("vision",), ("vision", "touch")])
def test_a_thing_that_jumps_to_and_fro_is_not_left_behind(mug, use):
    """By 8 mm a frame, up to 14 mm from what its velocity foretells: the prior about the prediction is 6 mm wide."""
    jumps = {k: np.array([0.0, 0.0, 0.0, 0.008 * (-1) ** (k // 2), 0.0, 0.0]) for k in range(1, 8)}
    made = recording(mug, 8, slip=jumps, step=(0.0,) * 6)
    shaken = [replace(frame, contacts=Contacts.none(), world_from_hand=None) for frame in made]
    answers = list(track(shaken, mug, use=use))
    assert [a.how for a in answers[1:]] == ["tracked"] * 7
    for answer, frame in zip(answers, shaken):
        assert off_by(answer, frame, mug)[1] < 2.5


def test_far_is_farther_than_a_frames_own_prior_is_wide():
    s = TrackSettings()
    assert not s.is_far(np.array([0.0, 0.0, 0.0, 0.9 * s.loose_distance, 0.0, 0.0]))
    assert s.is_far(np.array([0.0, 0.0, 0.0, 1.1 * s.loose_distance, 0.0, 0.0]))
    assert s.is_far(np.array([1.1 * s.loose_angle, 0.0, 0.0, 0.0, 0.0, 0.0]))
