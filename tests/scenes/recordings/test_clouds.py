"""Pixels to points: boxes that hold the whole ball, grids that stay inside the image, noise that grows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel
from vision.look.pixels import Pixels, Region, read_pixels

CAMERA = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)


@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.2), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.3, 1.5))
def test_the_box_holds_every_pixel_that_can_see_the_ball(seed, radius, x, y, z):
    region = Region(np.array([x, y, z]), radius)
    points = region.centre + radius * poses.random_unit_vectors(500, np.random.default_rng(seed))
    uv = np.round(CAMERA.project(points)[0])
    inside = ((uv >= 0) & (uv <= [639, 479])).all(axis=1)
    box = region.box(CAMERA)
    if box is None:
        assert not inside.any()
        return
    u0, v0, u1, v1 = box
    assert 0 <= u0 < u1 <= 640
    assert 0 <= v0 < v1 <= 480
    assert ((uv[inside] >= [u0, v0]) & (uv[inside] < [u1, v1])).all()


@pytest.mark.parametrize("centre", [(0, 0, -0.5), (5, 0, 0.5), (0, -5, 0.5), (0, 0, 0)])
def test_a_ball_that_the_camera_cannot_see(centre):
    assert Region(np.array(centre, dtype=float), 0.1).box(CAMERA) is None


def test_pixels_are_back_projected(rng):
    depth = rng.uniform(0.3, 1.0, size=(480, 640)).astype(np.float32)
    pixels = read_pixels(depth, CAMERA, (0, 0, 640, 480), 10**9)
    assert len(pixels) == 640 * 480
    assert pixels.area == 1.0
    assert np.allclose(pixels.points, CAMERA.back_project(depth))
    uv, z = CAMERA.project(pixels.points)
    assert np.allclose(uv, pixels.uv, atol=1e-9)
    assert np.array_equal(z, depth.ravel().astype(float))


@pytest.mark.parametrize("most", [1, 50, 1000, 10_000])
def test_the_grid_keeps_to_the_box_and_the_number(most):
    depth = np.full((480, 640), 0.5, dtype=np.float32)
    box = (100, 50, 400, 300)
    pixels = read_pixels(depth, CAMERA, box, most)
    assert 1 <= len(pixels) <= 2 * most + 1
    assert ((pixels.uv >= box[:2]) & (pixels.uv < box[2:])).all()
    assert pixels.area * len(pixels) == pytest.approx(300 * 250, rel=0.25 if most > 1 else 4)


def test_only_readings_count():
    depth = np.full((480, 640), 0.5, dtype=np.float32)
    depth[:, :100], depth[:, 100:200], depth[:, 200:300], depth[:, 300:400] = 0.0, np.nan, np.inf, -1.0
    pixels = read_pixels(depth, CAMERA, (0, 0, 640, 480), 10**9)
    assert len(pixels) == 480 * 240
    assert np.isfinite(pixels.points).all()
    assert pixels.uv[:, 0].min() == 400
    nothing = read_pixels(np.full((480, 640), np.nan, dtype=np.float32), CAMERA, (0, 0, 640, 480), 100)
    assert len(nothing) == 0
    assert nothing.points.shape == (0, 3)


def test_a_mask_restricts_and_refines_the_grid():
    depth = np.full((480, 640), 0.5, dtype=np.float32)
    mask = np.zeros((480, 640), dtype=bool)
    mask[200:220, 300:330] = True
    pixels = read_pixels(depth, CAMERA, (0, 0, 640, 480), 600, mask)
    assert len(pixels) == 600
    assert mask[pixels.uv[:, 1], pixels.uv[:, 0]].all()
    assert len(read_pixels(depth, CAMERA, (0, 0, 640, 480), 600, mask & False)) == 0


def test_thinning_is_even_and_each_pixel_stands_for_more(rng):
    pixels = Pixels(np.arange(200).reshape(100, 2), rng.normal(size=(100, 3)), 4.0)
    few = pixels.thinned(30)
    assert len(few) == 30
    assert few.area * 30 == pytest.approx(400.0)
    assert (np.diff(few.uv[:, 0]) > 0).all()
    assert pixels.thinned(100) is pixels
    assert len(pixels.take(np.zeros(100, dtype=bool))) == 0


def test_noise_grows_with_distance():
    model = DepthModel()
    assert model.independent_sigma(np.array([0.4]))[0] == model.axial_floor
    # Nguyen, Izadi & Lovell 2012: 0.0012 + 0.0019 (z - 0.4)^2
    assert model.independent_sigma(np.array([1.4]))[0] == pytest.approx(0.0031)
