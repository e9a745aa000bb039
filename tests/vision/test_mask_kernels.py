"""The compiled loops of an object's mask and of an image's pieces, against NumPy."""

import numpy as np
import pytest

from scenes.geometry.cameras import is_reading
from scenes.recordings.beliefs import DepthModel
from vision.look.mask import mask_kernels as kernels
from vision.look.mask import piece_kernels as pieces_of
from vision.look.mask.planes import for_kernels, on_planes
from vision.look.mask.settings import MaskSettings
from vision.look.pixels import median

LENS = 110.0, 120.0, 41.2, 28.9
BOX = 7, 3, 64, 51


def points_of(z, corner):
    fx, fy, cx, cy = LENS
    u, v = np.arange(z.shape[1]) + corner[0], np.arange(z.shape[0]) + corner[1]
    return np.stack([(u - cx) / fx * z, ((v - cy) / fy)[:, None] * z, z], axis=2)


def test_candidates_are_in_the_ball_and_off_the_planes(depth):
    settings, camera = MaskSettings(), DepthModel()
    seen = depth[BOX[1] : BOX[3], BOX[0] : BOX[2]].astype(np.float64)
    read = is_reading(seen)
    points = points_of(np.where(read, seen, 0.0), BOX)
    for planes in (np.zeros((0, 6)), np.array([[0.0, 0.6, -0.8, 0.55, 1.3, np.inf]])):
        for ball in ((0.0, 0.0, 0.0, np.inf), (0.01, 0.02, 0.6, 0.15)):
            z, good = np.zeros(seen.shape), np.zeros(seen.shape, dtype=bool)
            kernels.candidates(depth, LENS, BOX, ball, *for_kernels(planes, camera, settings), z, good)
            near = np.square(points - ball[:3]).sum(axis=2) < ball[3] ** 2
            assert np.array_equal(z, points[..., 2])
            assert np.array_equal(good, read & near & ~on_planes(points, planes, camera, settings))


def test_what_is_close_to_the_hand_is_told_in_single_precision(rng):
    z = rng.uniform(0.3, 0.9, size=(40, 50))
    near, far = (
        rng.uniform(0.3, 0.6, size=(40, 50)).astype(np.float32),
        rng.uniform(0.5, 0.9, (40, 50)).astype(np.float32),
    )
    good, out, margin = rng.random(z.shape) < 0.8, np.zeros(z.shape, dtype=bool), 0.006
    z[0] = near[0] - margin
    kernels.close_to(z, good, near, far, np.float32(margin), out)
    assert np.array_equal(out, good & (z > near - margin) & (z < far + margin))


def test_a_hand_is_laid_and_its_neighbours_are_parted_as_by_numpy(rng):
    drawn = np.where(rng.random((30, 40)) < 0.4, rng.uniform(0.3, 0.9, (30, 40)), np.inf)
    nearest, farthest = np.zeros((2, 30, 40), dtype=np.float32)
    there = np.zeros(drawn.shape, dtype=np.uint8)
    kernels.lay_hand(drawn, nearest, farthest, there)
    assert np.array_equal(there > 0, np.isfinite(drawn))
    assert np.array_equal(nearest, np.where(there > 0, drawn, 1e3).astype(np.float32))
    assert np.array_equal(farthest, np.where(there > 0, drawn, 0.0).astype(np.float32))
    good, whole, around = rng.random((3, 30, 40)) < 0.6
    close = good & (rng.random(drawn.shape) < 0.5)
    inner, outer, uncertain = np.zeros((3, 30, 40), dtype=bool)
    kernels.part(good, close, nearest, whole.astype(np.uint8), around.astype(np.uint8), inner, outer, uncertain)
    assert np.array_equal(inner, close & whole)
    assert np.array_equal(uncertain, close & ~whole)
    assert np.array_equal(outer, good & ~close & around & (there == 0))


def test_pieces_are_thinned_in_the_images_order(rng):
    z = rng.uniform(0.3, 0.9, size=(40, 50))
    pieces = rng.integers(-1, 4, size=z.shape)
    step = np.array([3, 0, 1, 7])
    size = np.bincount(pieces[pieces >= 0], minlength=4)
    counts = np.where(step > 0, -(-size // np.maximum(step, 1)), 0)
    first = np.cumsum(counts) - counts
    points = np.zeros((counts.sum(), 3))
    kernels.every(pieces, step, first, LENS, (5, 9), z, points)
    for piece in (0, 2, 3):
        own = points_of(z, (5, 9))[pieces == piece][:: step[piece]]
        assert np.array_equal(points[first[piece] : first[piece] + counts[piece]], own)


@pytest.mark.parametrize("step", [1, 4])
def test_shares_of_colours(rng, step):
    rgb = rng.integers(0, 256, size=(40, 50, 3)).astype(np.uint8)
    rgb[3] = 0
    chosen = rng.random((40, 50)) < 0.4
    chosen[3] = True
    out = np.zeros((-(-int(chosen.sum()) // step), 2))
    kernels.shares(rgb, chosen, step, out)
    colours = rgb[chosen].astype(np.float64)
    assert np.array_equal(out, (colours[:, :2] / np.maximum(colours.sum(axis=1, keepdims=True), 1.0))[::step])


def test_surfaces_are_read_off_the_planes(depth):
    settings, camera, step = MaskSettings(), DepthModel(), 3
    for planes in (np.zeros((0, 6)), np.array([[0.0, 0.6, -0.8, 0.55, 1.3, np.inf]])):
        points, good = np.zeros((20, 27, 3)), np.zeros((20, 27), dtype=bool)
        pieces_of.surface_points(depth, LENS, step, *for_kernels(planes, camera, settings), points, good)
        seen = depth.astype(np.float64)
        every = points_of(np.where(is_reading(seen), seen, 0.0), (0, 0))[::step, ::step]
        assert np.array_equal(points, every)
        assert np.array_equal(good, (every[..., 2] > 0) & ~on_planes(every, planes, camera, settings))


def test_cells_of_chosen_pieces_are_listed_in_order(rng):
    numbers = rng.integers(-1, 5, size=300)
    slot = np.array([1, -1, 0, -1, 2])
    size = np.bincount(numbers[numbers >= 0])[[2, 0, 4]]
    ends = np.cumsum(size)
    cells = np.zeros(ends[-1], dtype=np.int64)
    pieces_of.list_cells(numbers, slot, ends - size, cells)
    for own, piece in zip(np.split(cells, ends[:-1]), (2, 0, 4)):
        assert np.array_equal(own, np.flatnonzero(numbers == piece))


def test_votes_on_planes_and_nearness(rng):
    points, tolerance = rng.normal(size=(200, 3)), rng.uniform(0.05, 0.2, 200)
    normals, offsets, votes = rng.normal(size=(7, 3)), rng.normal(size=7), np.zeros(7, dtype=np.int64)
    pieces_of.count_votes(points, tolerance, normals, offsets, 3, votes)
    on = np.abs(points[::3] @ normals.T + offsets) < tolerance[::3, None]
    assert np.array_equal(votes, on.sum(axis=0))
    others = rng.normal(size=(30, 3)) + 2.0
    least = np.linalg.norm(points[:, None] - others[None], axis=2).min()
    assert pieces_of.are_near(points, others, 1.001 * least)
    assert not pieces_of.are_near(points, others, 0.999 * least)


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_medians_are_numpys(rng, count):
    for values in (rng.normal(size=count), rng.normal(size=(count, 3)).astype(np.float32)):
        found = median(values)
        assert np.array_equal(found, np.median(values, axis=0))
        assert found.dtype == values.dtype


@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_what_goes_on_behind_a_plane_is_counted_where_most_of_the_image_is_behind(rng, bend):
    x, y = rng.uniform(-0.5, 0.5, size=(2, 2500))
    z = 0.8 + bend * x * x + 0.003 * rng.normal(size=len(x))
    points, tolerance = np.stack([x * z, y * z, z], axis=1), rng.uniform(0.006, 0.009, size=len(x))
    normal, offset, cell, far = np.array([0.0, 0.0, -1.0]), 0.8, 8.0, 6.0
    found = pieces_of.runs_on_behind(points, tolerance, normal, offset, cell, far)
    height = (points @ normal + offset) / tolerance
    on, behind = np.abs(height) < 1.0, (height <= -1.0) & (height > -far)
    seen = points[:, :2] / points[:, 2:]
    step = np.sqrt(np.prod(np.ptp(seen, axis=0)) * cell / len(points))
    _, place = np.unique(np.floor((seen - seen.min(axis=0)) / step).astype(int), axis=0, return_inverse=True)
    count = [np.bincount(place.ravel(), weights=which) for which in (on, behind)]
    assert found == pytest.approx(count[1][count[1] > count[0]].sum() / on.sum(), abs=0.02)
    assert (found > MaskSettings().plane_most_behind) == (bend > 0.0)
