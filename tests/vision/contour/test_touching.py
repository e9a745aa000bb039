"""What touches an object may lie over its outline, or in its shade: such lines are not asked."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import coloured

from scenes.recordings.beliefs import DepthModel
from vision.contour.evidence import ContourEvidence, ContourSettings
from vision.picture.predictor import Predictor


@pytest.mark.parametrize(("behind", "asked"), [(0.01, False), (0.06, True)], ids=["touching", "far behind"])
@pytest.mark.parametrize("masked", [False, True], ids=["no mask", "a mask"])
def test_lines_beside_what_touches_are_not_asked_whatever_a_mask_says(behind, asked, masked):
    """In each row something goes on to the right, so far behind what is there of the object; nobody knows the hand."""
    frame, model = coloured("box")
    pose, depth = frame.camera_from_object_truth, frame.depth.copy()
    seen = depth > 0.0
    for row in np.flatnonzero(seen.any(axis=1)):
        last = np.flatnonzero(seen[row])[-1]
        depth[row, last + 1 :] = depth[row, last] + behind
    frame = replace(frame, depth=depth, mask=seen if masked else None)
    pieces = None if masked else np.full((-(-depth.shape[0] // 4), -(-depth.shape[1] // 4)), -1, dtype=np.int64)
    predictor = Predictor(frame, model, DepthModel(), pieces=pieces)
    assert not predictor.knows_hand
    lines = ContourEvidence(frame, model, predictor, pose, 1e-4, ContourSettings()).lines
    assert lines is not None
    to_the_right = lines.outline.normals[:, 0]
    assert (to_the_right < -0.8).sum() > 5
    assert ((to_the_right > 0.8).sum() > 5) == asked
