"""Pixels read and sorted by compiled loops, against NumPy."""

import numpy as np
import pytest

from scenes.geometry.cameras import Camera, is_reading
from scenes.recordings.beliefs import DepthModel
from vision.look.mask.planes import for_kernels, on_planes
from vision.look.mask.settings import MaskSettings
from vision.look.pixel_kernels import CHOSEN, OTHER
from vision.look.pixels import Pixels, Region, quantile, read_pixels, sort_pixels

CAMERA = Camera(110.0, 120.0, 41.2, 28.9, 80, 60)
BOXES = [(0, 0, 80, 60), (7, 3, 64, 51), (5, 5, 5, 9)]


def by_numpy(depth, box, stride, mask):
    u, v = (x.ravel() for x in np.meshgrid(np.arange(box[0], box[2], stride), np.arange(box[1], box[3], stride)))
    z = depth[v, u]
    valid = is_reading(z)
    if mask is not None:
        valid &= mask[v, u]
    u, v, z = u[valid], v[valid], z[valid].astype(np.float64)
    points = np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], axis=1)
    return np.stack([u, v], axis=1), points


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("most", [10_000, 300])
@pytest.mark.parametrize("box", BOXES)
def test_pixels_are_read_as_numpy_reads_them(depth, rng, box, most, masked):
    mask = rng.random((60, 80)) < 0.5 if masked else None
    pixels = read_pixels(depth, CAMERA, box, most, mask)
    uv, points = by_numpy(depth, box, int(np.sqrt(pixels.area)), mask)
    assert np.array_equal(pixels.uv, uv)
    assert np.array_equal(pixels.points, points)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("most", [10_000, 300])
@pytest.mark.parametrize("box", BOXES)
def test_pixels_are_sorted_and_thinned_as_numpy_does(depth, rng, box, most, masked):
    mask = rng.random((60, 80)) < 0.8 if masked else None
    settings, camera = MaskSettings(), DepthModel()
    plane = np.array([[0.0, 0.6, -0.8, 0.55, 1.3, 0.0]])
    for region in (None, Region(np.array([0.02, -0.01, 0.6]), 0.17)):
        for planes in (plane, plane[:0]):
            found = sort_pixels(depth, CAMERA, box, most, region, mask, for_kernels(planes, camera, settings))
            every = read_pixels(depth, CAMERA, box, most)
            inside = ~on_planes(every.points, planes, camera, settings)
            if region is not None:
                inside &= np.linalg.norm(every.points - region.centre, axis=1) < region.radius
            if mask is not None:
                inside &= mask[every.uv[:, 1], every.uv[:, 0]]
            for kind, own in ((CHOSEN, every.take(inside)), (OTHER, every.take(~inside))):
                for kept in (7, 90, 10_000):
                    same(found.some(kind, kept), own.thinned(kept))


def same(a: Pixels, b: Pixels) -> None:
    assert np.array_equal(a.uv, b.uv)
    assert np.array_equal(a.points, b.points)
    assert a.area == b.area


@pytest.mark.parametrize("count", [1, 2, 7, 300])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.985, 1.0])
def test_a_quantile_is_numpys_to_the_last_bit(rng, count, share):
    for _ in range(20):
        values = rng.normal(size=count)
        assert quantile(values, share) == np.quantile(values, share)
