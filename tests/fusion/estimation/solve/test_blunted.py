"""What windows of a depth camera blunt of an object that is small in the image is part of the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.families import making
from fusion.benchmarks.families.table import FAMILIES
from scenes.recordings.beliefs import Beliefs, DepthModel


@pytest.mark.parametrize(("camera", "wider"), [("d435", True), ("lab", False)])
def test_what_windows_blunt_widens_where_the_image_shows_windows(camera, wider):
    """A held drill a metre off, 3.5 mm a pixel: of stereo, and of a camera each of whose pixels errs by itself."""
    family = replace(FAMILIES[camera], lens=FAMILIES["coarse"].lens, distance=(0.9, 1.1))
    made = next(iter(making.frames_of(family, 0.3, 1, 5, ("drill",))))
    none, usual = (
        estimate(made.frame, made.model, beliefs=Beliefs(depth=DepthModel(window=pixels))) for pixels in (0.0, 7.0)
    )
    if wider:
        assert np.trace(usual.covariance[3:, 3:]) > 1.3 * np.trace(none.covariance[3:, 3:])
        assert usual.confidence < none.confidence
    else:
        assert np.array_equal(usual.covariance, none.covariance)
