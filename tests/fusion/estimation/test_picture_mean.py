"""The picture's last word: a pose that slid along a flat side comes back, one that is right stays."""

import numpy as np
import pytest
from made_frames import plain_view

from fusion.estimation.steps.picture import PictureMeanSettings, why_not_asked, with_picture
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


def test_it_is_asked_only_where_nobody_says_what_hides_the_object():
    _, _, _, predictor = slid(0.0)
    assert why_not_asked(predictor) == ""
    assert "known" in why_not_asked(Predictor(plain_view("box"), predictor.model, DepthModel()))
    assert why_not_asked(Predictor(Frame(0), predictor.model, DepthModel())) == "nothing is seen"
