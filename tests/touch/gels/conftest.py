"""What tests of gels share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pressed_gels import BALL

from scenes.synthesis.gels import ball_presses, lit_digit
from touch.gels.skin.calibration import calibrate


@pytest.fixture(scope="session")
def digit():
    """A lit DIGIT with its calibration by presses of a ball."""
    rng = np.random.default_rng(3)
    gel = lit_digit(rng)
    images = ball_presses(gel, BALL, 0.0008, 10, rng)
    return replace(gel, calibration=calibrate(images, gel, BALL).to_json())
