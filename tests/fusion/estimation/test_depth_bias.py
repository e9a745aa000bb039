"""The smooth error of depth: as large everywhere as is believed, however few pixels carry it."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.estimation.solve.depth_bias import DepthBias
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel


@pytest.mark.parametrize("most", [20, 80, 400])
@pytest.mark.parametrize("length", [12.0, 25.0, 120.0])
def test_few_inducing_pixels_leave_no_gaps(rng, most, length):
    camera = Camera(430.0, 430.0, 319.5, 239.5, 640, 480)
    points = np.column_stack([rng.uniform([-0.1, -0.08], [0.1, 0.08], (500, 2)), np.full(500, 0.2)])
    bias = DepthBias.over(camera, points, replace(DepthModel(), bias_length=length), 1.2, most)
    assert len(bias) <= most
    variance = np.square(bias.basis(points)).sum(axis=1)
    assert variance.min() > 0.85
    assert variance.max() < 1.0 + 1e-6
    # smoother than believed only where they do not suffice
    assert bias.length >= length
    assert bias.length == length or most < 400 or length == 12.0
