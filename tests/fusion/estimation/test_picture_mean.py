"""The picture's last word: a pose that slid along a flat side comes back, one that is right stays."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion.estimation.steps.picture import PictureMeanSettings, asked_picture, left_open, why_not_asked, with_picture
from scenes.evidence.modes import Mode
from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from vision.picture.predictor import Predictor

UNKNOWN = np.zeros((80, 107), dtype=np.int64)


def slid(millimetres):
    """A box's truth, its pose slid across the camera's rays, what sees it, and a covariance that would allow it."""
    frame, model = plain_view("box"), library.make("box")
    truth = frame.camera_from_object_truth
    covariance = np.diag([1e-4, 1e-4, 1e-4, 64e-6, 64e-6, 4e-6])
    mode = Mode(poses.make_pose(None, [1e-3 * millimetres, 0.0, 0.0]) @ truth, 1.0, 0.0, covariance)
    return model, truth, mode, Predictor(frame, model, DepthModel(), pieces=UNKNOWN)


def test_what_slid_comes_back_and_what_is_right_stays():
    model, truth, mode, predictor = slid(12.0)
    found, gained = with_picture(model, mode, np.eye(4), predictor, 0)
    assert gained > PictureMeanSettings().least
    off, before = (np.linalg.norm(one.pose[:3, 3] - truth[:3, 3]) for one in (found, mode))
    assert off < 0.6 * before
    np.testing.assert_array_equal(found.covariance, mode.covariance)
    model, truth, right, predictor = slid(0.0)
    found, gained = with_picture(model, right, np.eye(4), predictor, 0)
    assert np.linalg.norm(found.pose[:3, 3] - truth[:3, 3]) < 0.002
    again, _ = with_picture(model, right, np.eye(4), predictor, 0)
    np.testing.assert_array_equal(found.pose, again.pose)


def test_it_is_asked_where_the_uncorrected_image_shows_the_object():
    """A depth scale of one per cent: what is solved for is not what the image shows."""
    model, truth, mode, predictor = slid(12.0)
    apart = poses.make_pose(None, [0.0, 0.0, 0.004])
    found, gained = with_picture(
        model, Mode(poses.inverse(apart) @ mode.pose, 1.0, 0.0, mode.covariance), apart, predictor, 0
    )
    assert gained > PictureMeanSettings().least
    assert np.linalg.norm((apart @ found.pose)[:3, 3] - truth[:3, 3]) < 0.008


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.diag([0.0, 0.0, 0.0, 1e-4, 0.0, 0.0])])
def test_a_degenerate_covariance_moves_nothing_it_does_not_allow(covariance):
    model, _, mode, predictor = slid(12.0)
    found, gained = with_picture(model, Mode(mode.pose, 1.0, 0.0, covariance), np.eye(4), predictor, 0)
    assert np.isfinite(found.pose).all()
    assert np.abs(found.pose[1:3, 3] - mode.pose[1:3, 3]).max() < 1e-9
    assert gained == 0.0 or covariance.any()


def test_it_is_asked_where_nobody_says_what_hides_the_object_or_a_direction_is_open():
    model, _, mode, predictor = slid(0.0)
    known = Predictor(plain_view("box"), model, DepthModel())
    sure = replace(mode, covariance=1e-6 * np.eye(6))
    assert why_not_asked(model, sure, predictor) == ""
    assert why_not_asked(model, sure, known) == "no direction is open"
    assert why_not_asked(model, mode, known) == ""
    assert why_not_asked(model, mode, known, PictureMeanSettings(open_from=0.05)) == "no direction is open"
    assert why_not_asked(model, mode, Predictor(Frame(0), model, DepthModel())) == "nothing is seen"


@pytest.mark.parametrize("told", [True, False])
def test_what_rows_leave_open_is_as_wide_as_the_picture_leaves_it(told):
    """A box that may have slid by 30 mm along its side, as its rows have it: its ends are in view."""
    frame, model = plain_view("box"), library.make("box")
    truth = frame.camera_from_object_truth
    along = np.eye(6)[3]
    wide = 1e-6 * np.eye(6) + 9e-4 * np.outer(along, along)
    mode = Mode(poses.make_pose(None, [0.012, 0.0, 0.0]) @ truth, 1.0, 0.0, wide)
    predictor = Predictor(frame, model, DepthModel(), pieces=None if told else UNKNOWN)
    found, why = asked_picture(model, mode, np.eye(4), predictor, 0)
    assert "1 open direction" in why
    assert np.linalg.norm(found.pose[:3, 3] - truth[:3, 3]) < 0.008
    left = np.sqrt(along @ found.covariance @ along)
    assert abs(found.pose[0, 3] - truth[0, 3]) < 3.0 * left < 0.03
    # what was known stays as it was
    np.testing.assert_allclose(found.covariance[:3, :3], wide[:3, :3], atol=1e-9)
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()
    again, _ = asked_picture(model, mode, np.eye(4), predictor, 0)
    np.testing.assert_array_equal(found.pose, again.pose)


def test_a_turn_about_the_own_axis_is_not_open():
    """A can may turn as it likes: no picture tells, and nothing of its surface moves."""
    model = library.make("cylinder")
    pose = poses.make_pose(None, [0.0, 0.0, 0.5])
    axis = pose[:3, :3] @ model.symmetries.axes[0].direction
    arm = np.cross(axis, pose[:3, :3] @ (model.centroid - model.symmetries.axes[0].point))
    turning = np.concatenate([axis, arm])
    mode = Mode(pose, 1.0, 0.0, 1e-6 * np.eye(6) + np.outer(turning, turning))
    assert left_open(model, mode).shape == (6, 0)


def test_what_goes_with_a_turn_about_the_own_axis_stays_a_covariance():
    """A can that may have slid by 30 mm, and turned about itself as it slid."""
    frame, model = plain_view("cylinder"), library.make("cylinder")
    pose = frame.camera_from_object_truth
    axis = model.symmetries.axes[0]
    turn = pose[:3, :3] @ axis.direction
    turning = np.concatenate([turn, np.cross(turn, pose[:3, :3] @ (model.centroid - axis.point))])
    slid = 0.03 * np.concatenate([np.zeros(3), turn]) + 2.0 * turning
    mode = Mode(pose, 1.0, 0.0, 1e-6 * np.eye(6) + np.outer(slid, slid))
    basis = left_open(model, mode)
    assert basis.shape[1] == 1
    found, _ = asked_picture(model, mode, np.eye(4), Predictor(frame, model, DepthModel()), 0)
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()
    known = model.symmetries.quotient(pose[:3, :3], model.centroid)
    before, after = (np.sqrt(np.trace((known @ c @ known.T)[3:, 3:])) for c in (mode.covariance, found.covariance))
    assert after < 0.5 * before


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), 4.0 * np.eye(6)])
def test_nothing_known_and_everything_known_stay_finite(covariance):
    frame, model = plain_view("box"), library.make("box")
    mode = Mode(frame.camera_from_object_truth, 1.0, 0.0, covariance)
    found, _ = asked_picture(model, mode, np.eye(4), Predictor(frame, model, DepthModel()), 0)
    assert np.isfinite(found.pose).all()
    assert (np.linalg.eigvalsh(found.covariance) >= -1e-9).all()
    assert np.trace(found.covariance) <= np.trace(covariance) + 1e-9
