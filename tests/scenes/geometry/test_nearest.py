"""Nearest points against every distance, where points coincide, lie in a plane or are far away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.geometry.nearest import Nearest


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 400), st.sampled_from(["space", "plane", "line", "places", "one"]))
def test_it_finds_what_comparing_all_finds(seed, count, kind):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * {"space": (1, 1, 1), "plane": (1, 1, 0), "line": (0, 1, 0)}.get(kind, 1)
    if kind == "places":  # many at the same place
        points = np.rint(points)
    if kind == "one":
        points = np.broadcast_to(points[0], points.shape)
    asked = np.concatenate([rng.normal(size=(50, 3)), 1e3 * rng.normal(size=(20, 3)), points[:20]])
    everything = np.linalg.norm(asked[:, None] - points[None], axis=2).min(axis=1)
    np.testing.assert_allclose(Nearest(points).distance(asked), everything, rtol=1e-12, atol=1e-15)


def test_none_and_unknown_points_are_refused():
    for points in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(InputError, match="expected finite points"):
            Nearest(points)
    assert len(Nearest(np.zeros((1, 3))).distance(np.zeros((0, 3)))) == 0
