"""What recorders do to depth: smoothing, filling and registration, against their NumPy twins."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from scenes.synthesis.noise import recorder_kernels as kernels
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.noise.recorder import Recorder, median_of_readings, smoothed
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.settings import SynthesisSettings

CAMERA = Camera(57.0, 58.0, 31.0, 24.5, 64, 48)


@pytest.fixture
def depth():
    """Two slopes with a step between them, noise, and a tenth without a reading."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[:48, :64]
    z = np.where(u < 30, 0.5 + 1e-3 * v, 0.8 - 5e-4 * u) + rng.normal(0, 1e-3, (48, 64))
    return np.where(rng.random(z.shape) < 0.1, 0.0, z)


def mean_along(row, weight, step):
    """Recursive mean along one row, there and back."""
    row = row.copy()
    for order in (np.arange(len(row)), np.arange(len(row))[::-1]):
        mean = row[order[0]]
        for at in order[1:]:
            mixes = row[at] > 0 and mean > 0 and abs(row[at] - mean) < step
            mean = weight * row[at] + (1 - weight) * mean if mixes else row[at]
            row[at] = mean
    return row


def test_smoothing_is_a_mean_along_rows_and_columns(depth):
    settings, scale = Recorder(weight=0.5, rounds=2), 30.0
    disparity = np.where(depth > 0, scale / np.where(depth > 0, depth, 1.0), 0.0)
    for _ in range(2):
        for axis in (1, 0):
            disparity = np.apply_along_axis(mean_along, axis, disparity, 0.5, settings.step)
    expected = np.where(depth > 0, scale / np.where(depth > 0, disparity, 1.0), 0.0)
    found = smoothed(depth, scale, settings)
    assert np.allclose(found, expected, atol=1e-12)
    flat = (slice(5, 43), slice(35, 60))
    assert np.array_equal(found > 0, depth > 0)
    trend = 0.8 - 5e-4 * np.mgrid[:48, :64][1]
    left = [np.std((image - trend)[flat][depth[flat] > 0]) for image in (depth, found)]
    assert left[1] < 0.5 * left[0]
    step = np.abs(np.median(found[:, 25]) - np.median(found[:, 34]))
    assert step > 0.2  # an edge stays where it is


def test_a_median_counts_readings_alone(depth):
    found = median_of_readings(depth, 5)
    assert np.array_equal(found > 0, depth > 0)
    for v, u in ((0, 0), (20, 30), (47, 63), (10, 29)):
        window = depth[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3]
        assert found[v, u] == (np.median(window[window > 0]) if depth[v, u] > 0 else 0.0)


def test_holes_are_filled_from_the_left_or_from_what_is_farthest(depth):
    left, far = depth.copy(), depth.copy()
    kernels.fill_from_left(left)
    kernels.fill_from_farthest(far)
    slow, twin = depth.copy(), depth.copy()
    for v in range(48):
        for u in range(1, 64):
            if slow[v, u] == 0:
                slow[v, u] = slow[v, u - 1]
            if twin[v, u] == 0:
                beside = [twin[v, u - 1], *twin[max(v - 1, 0) : v + 2, u - 1]]
                beside += [twin[row, u] for row in (v - 1, v + 1) if 0 <= row < 48]
                twin[v, u] = max(beside)
    assert np.array_equal(left, slow)
    assert np.array_equal(far, twin)
    assert (far[:, 1:] > 0).all()
    assert np.array_equal(left[depth > 0], depth[depth > 0])


def test_registered_depth_is_where_the_other_camera_sees_it(depth):
    frame = Frame(0, depth=depth.astype(np.float32), camera=CAMERA)
    recorder = Recorder(registered=2.0, beside=0.03, turned=(0.01, -0.02, 0.015))
    other = recorder.recorded(frame)
    assert other.camera == CAMERA.scaled(2.0)
    assert other.depth.shape == (96, 128)
    moved = recorder.colour_from_depth
    assert np.allclose(other.camera_from_world, moved)
    before = poses.apply(moved, CAMERA.back_project(frame.depth))
    after = other.camera.back_project(other.depth)
    # every reading is one of those before: as deep as it, and within its square
    distance, nearest = cKDTree(before).query(after)
    assert np.median(distance) < 0.8 / 57
    assert np.quantile(np.abs(after[:, 2] - before[nearest, 2]), 0.9) < 4e-3
    assert set(other.depth[other.depth > 0].tolist()) <= set(before[:, 2].astype(np.float32).tolist())


def test_recorded_frames_agree_with_their_truth():
    """Truth, start and touch lie in the picture that is delivered; other kinds change depth alone."""
    settings = SynthesisSettings(camera=Camera(200.0, 200.0, 119.5, 89.5, 240, 180))
    model, clean = library.make("box"), PRESETS["none"]
    (plain,) = synthesize_frames(model, None, 1, 0.0, noise=clean, seed=3, settings=settings)
    kinds = [Recorder(), Recorder(median=3), Recorder(weight=0.5), Recorder(fill="left"), Recorder(fill="farthest")]
    for recorder in [*kinds, Recorder(registered=1.7, beside=0.04)]:
        (made,) = synthesize_frames(
            model, None, 1, 0.0, noise=replace(clean, recorder=recorder), seed=3, settings=settings
        )
        seen = poses.apply(poses.inverse(made.camera_from_object_truth), made.camera.back_project(made.depth))
        near = np.abs(model.field.distance(seen)) < 0.004
        assert near.sum() > 300
        assert np.median(np.abs(model.field.distance(seen[near]))) < 1e-3
        touched = poses.apply(made.camera_from_world, made.contacts.points)
        felt = poses.apply(poses.inverse(made.camera_from_object_truth), touched)
        assert np.abs(model.field.distance(felt)).max() < 1e-3
        if not recorder.registered:
            assert np.array_equal(made.camera_from_object_truth, plain.camera_from_object_truth)
            assert made.camera == plain.camera
        else:
            assert made.rgb is None
    (same,) = synthesize_frames(
        model, None, 1, 0.0, noise=replace(clean, recorder=Recorder()), seed=3, settings=settings
    )
    assert np.array_equal(same.depth, plain.depth)


def test_frames_without_an_image_are_left_alone():
    frame = Frame(0, contacts=Contacts(np.zeros((1, 3))))
    assert Recorder(median=3, registered=2.0).recorded(frame) is frame


def test_what_no_recorder_does_is_refused():
    for wrong in ({"median": 4}, {"weight": 0.0}, {"step": -1.0}, {"registered": -2.0}):
        with pytest.raises(InputError, match="recorder: expected"):
            Recorder(**wrong)
    with pytest.raises(InputError, match="farthest"):
        Recorder(fill="right")


def test_what_is_no_reading_is_filled(depth):
    told = np.where(depth > 0, depth, np.inf).astype(np.float32)
    filled = Recorder(fill="left").recorded(Frame(0, depth=told, camera=CAMERA)).depth
    kernels.fill_from_left(depth)
    assert np.allclose(filled, depth)
