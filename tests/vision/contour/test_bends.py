"""What an image bends an outline by: a part of what all its lines share."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from made_frames import coloured

from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel, ImageModel
from vision.contour.evidence import FADING, ContourEvidence, ContourSettings
from vision.contour.outline import bends, outline_of
from vision.picture.predictor import Predictor

BENT = 0.5


@pytest.mark.parametrize("angle", [0.0, 3.0])
def test_what_a_colour_image_is_turned_by_is_learned_from_the_frame(angle):
    """A few degrees about the box's middle, whose pose depth is sure of: lines share a turn, the object has none."""
    frame, model = coloured("box")
    pose, sure = frame.camera_from_object_truth, np.diag([1e-3] * 3 + [3e-4] * 3) ** 2
    (middle,), _ = frame.camera.project(poses.apply(pose, model.centroid[None]))
    height, width = frame.depth.shape
    turn = cv2.getRotationMatrix2D(tuple(middle), angle, 1.0)
    image = cv2.warpAffine(frame.rgb, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
    settings = ContourSettings(shift=ImageModel().colour_sigma, learned=True, bent=BENT)
    predictor = Predictor(frame, model, DepthModel())
    evidence = ContourEvidence(replace(frame, rgb=image), model, predictor, pose, 1e-4, settings)
    for _ in range(3):
        evidence.terms(np.zeros(6), (np.zeros(6), np.linalg.inv(sure)))
    learned = evidence.common_information[FADING + 1, FADING + 1] ** -0.5
    about = evidence.lines.outline.places - evidence.lines.outline.places.mean(axis=0)
    turned = np.deg2rad(angle) * np.sqrt(np.square(about).sum(axis=1).mean())
    # the likeliest of three of which one is not zero
    assert learned == pytest.approx(max(BENT, turned / np.sqrt(3.0)), rel=0.35)
    assert abs(evidence._common[FADING + 1]) == pytest.approx(turned, abs=0.4 + 0.2 * turned)


def test_bends_are_what_turning_stretching_and_shearing_do_to_places():
    frame, model = coloured("mug")
    outline = outline_of(model, frame.camera, frame.camera_from_object_truth)
    middle = outline.places.mean(axis=0)
    size = np.sqrt(np.square(outline.places - middle).sum(axis=1).mean())
    for column, change in enumerate([[[0, -1], [1, 0]], [[1, 0], [0, -1]], [[0, 1], [1, 0]]]):
        moved = middle + (outline.places - middle) @ (np.eye(2) + np.array(change) / size).T
        along = np.einsum("ij,ij->i", moved - outline.places, outline.normals)
        np.testing.assert_allclose(bends(outline)[:, column], along, atol=1e-9)
