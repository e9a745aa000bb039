"""How noisy a depth image is, read off its smooth surfaces; the compiled loop against NumPy."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import IN_PIXELS, LARGEST, MOST_TIMES, USUAL_FOCAL, Beliefs, DepthModel
from scenes.recordings.frames import Frame
from vision import noise_kernels
from vision.noise import NoiseSettings, believed_of, grain, noise_ratio, window_of

CAMERA = Camera(570.0, 570.0, 159.5, 119.5, 320, 240)


def wall(rng, times, lost=0.0):
    """A slanting plane, 0.6 to 1 m off, read with so many times the noise that is believed."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    z = 1.0 / (1.0 + 1.2e-3 * u + 8e-4 * v)
    noise = times * DepthModel().independent_sigma(z) * rng.standard_normal(z.shape)
    return np.where(rng.random(z.shape) < lost, 0.0, z + noise).astype(np.float32)


def by_numpy(depth, step, count, stride, farthest):
    span, out = step * (count - 1), []
    i, j = np.meshgrid(np.arange(count), np.arange(count))
    design = np.stack([np.ones(count**2), i.ravel(), j.ravel()], axis=1)
    for top in range(0, depth.shape[0] - span, stride):
        for left in range(0, depth.shape[1] - span, stride):
            part = depth[top : top + span + 1 : step, left : left + span + 1 : step].astype(np.float64).ravel()
            if not ((part > 0.0) & (part <= farthest)).all():
                continue
            inverse = 1.0 / part
            off = inverse - design @ np.linalg.lstsq(design, inverse, rcond=None)[0]
            out.append((np.sqrt(off @ off / (count**2 - 3)) / inverse.mean() ** 2, 1.0 / inverse.mean()))
    return np.array(out).reshape(-1, 2)


def test_windows_are_fitted_as_numpy_fits_them(rng):
    depth = wall(rng, 1.3, lost=0.01)
    depth[40:60, 100:140] = np.nan
    told = by_numpy(depth, 4, 6, 20, 0.9)
    found = np.zeros((500, 2))
    count = noise_kernels.scatter_on_planes(depth, 4, 6, 20, 0.9, found)
    assert 10 < count == len(told)
    assert np.allclose(found[:count], told, rtol=1e-6)
    few = np.zeros((3, 2))
    assert noise_kernels.scatter_on_planes(depth, 4, 6, 20, 0.9, few) == 3
    assert np.array_equal(few, found[:3])


@pytest.mark.parametrize("times", [0.5, 1.0, 2.0, 4.0])
def test_noise_is_told_to_a_tenth(rng, times):
    assert noise_ratio(wall(rng, times), DepthModel()) == pytest.approx(times, rel=0.12)


def test_edges_and_bent_things_are_no_noise(rng):
    depth = wall(rng, 1.0)
    depth[60:180, 90:230] = 0.45 + 2e-5 * np.square(np.arange(140.0) - 70.0)
    depth[60:180, 90:230] += 0.0012 * rng.standard_normal((120, 140))
    assert noise_ratio(depth, DepthModel()) == pytest.approx(1.0, rel=0.15)


def test_only_more_than_usual_is_news(rng):
    usual, told = Beliefs(), Beliefs(depth=DepthModel(axial_floor=0.0024, axial_growth=0.0038))
    quiet, noisy = (Frame(0, camera=CAMERA, depth=wall(rng, times)) for times in (1.4, 3.2))
    # but that each reads its own place
    assert believed_of(quiet, usual) == replace(usual, depth=replace(usual.depth, window=0.0))
    # who measured it is believed
    assert believed_of(noisy, told).depth.axial_floor == pytest.approx(told.depth.axial_floor, rel=0.12)
    believed, known = believed_of(noisy, usual).depth, usual.depth
    times = believed.axial_floor / known.axial_floor
    assert times == pytest.approx(2.0, rel=0.12)
    assert believed.axial_growth == pytest.approx(times * known.axial_growth)
    assert believed.bias_sigma == pytest.approx(times * known.bias_sigma)
    assert believed.scale_sigma == known.scale_sigma
    worst = Frame(0, camera=CAMERA, depth=wall(rng, 20.0))
    assert believed_of(worst, usual).depth.axial_floor == pytest.approx(NoiseSettings().most * known.axial_floor)


def test_a_belief_as_large_as_any_grows_no_further(rng):
    told = Beliefs(depth=DepthModel(axial_floor=0.09, bias_sigma=0.08))
    nothing_but_noise = rng.uniform(0.1, 1.4, (240, 320)).astype(np.float32)
    believed = believed_of(Frame(0, camera=CAMERA, depth=nothing_but_noise), told).depth
    assert believed.axial_floor == LARGEST["axial_floor"]
    assert believed.bias_sigma == LARGEST["bias_sigma"]


@pytest.mark.parametrize("depth", [np.zeros((240, 320)), np.full((240, 320), np.nan), np.full((240, 320), 5.0)])
def test_nothing_flat_and_near_tells_nothing(depth):
    assert np.isnan(noise_ratio(depth, DepthModel()))
    usual = Beliefs()
    assert believed_of(Frame(0, camera=CAMERA, depth=np.nan_to_num(depth).astype(np.float32)), usual) is usual


def test_images_smaller_than_a_window_tell_nothing():
    for size in ((1, 1), (16, 2), (20, 20)):
        assert np.isnan(noise_ratio(np.full(size, 0.5), DepthModel()))


@pytest.mark.parametrize("times", [0.4, 1.0, 1.8, 2.0, 40.0])
def test_sizes_in_pixels_that_nobody_told_are_those_of_the_scene(times):
    usual, told = DepthModel(), DepthModel(bias_length=25.0)
    known = usual.through(times * USUAL_FOCAL)
    larger = min(max(times, 1.0), MOST_TIMES)
    for name in IN_PIXELS:
        assert getattr(known, name) == pytest.approx(larger * getattr(usual, name), abs=0.5 * (name == "edge_pixels"))
    assert isinstance(known.edge_pixels, int)
    assert (known.axial_floor, known.shift_sigma) == (usual.axial_floor, usual.shift_sigma)
    assert told.through(times * USUAL_FOCAL).bias_length == 25.0
    lens = replace(CAMERA, fx=times * USUAL_FOCAL)
    frame = Frame(0, camera=lens, depth=np.zeros((CAMERA.height, CAMERA.width), np.float32))
    assert believed_of(frame, Beliefs()).depth == known


def test_who_says_less_noise_than_any_camera_has_is_not_believed(rng):
    usual, finer = DepthModel(), DepthModel(axial_floor=6e-5, axial_growth=9.5e-5, bias_sigma=1.25e-4)
    frame = Frame(0, camera=CAMERA, depth=wall(rng, 1.6))
    believed = believed_of(frame, Beliefs(depth=finer)).depth
    assert believed.axial_floor == pytest.approx(usual.axial_floor, rel=0.15)
    assert believed.bias_sigma == pytest.approx(usual.bias_sigma, rel=0.15)


def smoothed(rng, side):
    """A wall whose readings are averages of so many by so many of their neighbours, twice."""
    noise = cv2.blur(cv2.blur(rng.standard_normal((240, 320)), (side, side)), (side, side))
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    return (0.8 + 2e-4 * u + 1e-4 * v + 0.002 * noise / noise.std()).astype(np.float32)


def test_neighbours_that_err_together_are_told_from_those_that_do_not(rng):
    alone, together = (smoothed(rng, side) for side in (1, 9))
    assert grain(alone) == pytest.approx(1.0, abs=0.06)
    assert grain(together) < 0.5
    assert window_of(alone, 7.0) == 0.0
    assert window_of(together, 7.0) == 7.0
    assert 0.0 < window_of(smoothed(rng, 2), 7.0) < 7.0
    # nobody is told more than he believed, and what is not seen is as it was believed
    assert window_of(together, 0.0) == 0.0
    assert window_of(np.zeros((240, 320)), 3.0) == 3.0
    usual = Beliefs()
    assert believed_of(Frame(0, camera=CAMERA, depth=together), usual) is usual
    once = believed_of(Frame(0, camera=CAMERA, depth=alone), usual)
    assert believed_of(Frame(0, camera=CAMERA, depth=alone), once) == once


def test_what_is_averaged_over_more_of_an_object_is_blunter():
    usual = DepthModel()
    sizes = [usual.blunting(depth, 285.0, 0.06) for depth in (0.0, 0.3, 0.6, 1.0, 5.0)]
    assert sizes[:2] == [0.0, 0.0]
    assert 0.0 < sizes[2] < sizes[3] < sizes[4]
    # as it is usual, nothing is added
    assert usual.blunting(0.75, 600.0, 0.06) == 0.0
    # a pixel of 3.5 mm: 8.6 mm of a mug, less of what is larger, and no more than half the window of a ball in it
    assert sizes[3] == pytest.approx(((7.0 / 285.0) ** 2 - 0.0091**2) / 0.06)
    assert usual.blunting(1.0, 285.0, 0.12) == pytest.approx(0.5 * sizes[3])
    assert usual.blunting(1.0, 285.0, 1e-12) == pytest.approx(0.5 * 7.0 / 285.0)
    assert replace(usual, window=0.0).blunting(1.0, 285.0, 0.06) == 0.0
