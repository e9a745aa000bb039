"""What is no reading, however it is written."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import estimate


@pytest.mark.parametrize("touch", [True, False], ids=["fused", "vision"])
@pytest.mark.parametrize("none", [np.nan, np.inf, -np.inf, 5000.0], ids=["nan", "inf", "negative", "far"])
def test_a_pixel_without_a_reading_says_the_same_however_it_is_written(lab_frame, drill, touch, none):
    depth = lab_frame.depth.copy()
    rng = np.random.default_rng(3)
    holes = (depth == 0.0) | (rng.random(depth.shape) < 0.1)
    holes[:, 150:165] = True
    use = ("vision", "touch") if touch else ("vision",)
    answers = []
    for value in (0.0, none):
        depth[holes] = value
        answers.append(estimate(replace(lab_frame, depth=depth.copy(), mask=None), drill, use=use))
    zero, other = answers
    np.testing.assert_array_equal(other.pose, zero.pose)
    np.testing.assert_array_equal(other.covariance, zero.covariance)
    assert other.confidence == zero.confidence
