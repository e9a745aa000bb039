"""Depth images as sensors leave them."""

import numpy as np
import pytest


@pytest.fixture
def depth(rng):
    """(60, 80) metres, with every kind of reading that is none."""
    z = rng.uniform(0.3, 0.9, size=(60, 80)).astype(np.float32)
    for bad in (0.0, -1.0, np.nan, np.inf, 2e3):
        z[rng.integers(60, size=40), rng.integers(80, size=40)] = bad
    return z
