"""The hand in the picture: a known calibration error is found again from its pixels."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera, is_reading
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from vision.look.hand.hand import camera_from_hand, prior_information, prior_spread, view_hand
from vision.look.hand.hand_kernels import explained, pulls, seen_past
from vision.look.pixels import read_pixels

FULL = (0, 0, 640, 480)


def look(frame, **changes):
    frame = replace(frame, **changes)
    pixels = read_pixels(frame.depth, frame.camera, FULL, 12_000)
    return view_hand(frame, pixels, Beliefs())


@pytest.mark.parametrize("seed", range(4))
def test_a_known_calibration_error_is_found(exact_frame, seed):
    rng = np.random.default_rng(seed)
    error = poses.exp(
        np.concatenate([np.deg2rad(0.3) * rng.normal(size=3), 0.002 * rng.normal(size=3)])  # at the camera
    )
    view = look(exact_frame, world_from_hand=error @ exact_frame.world_from_hand)
    left = poses.difference(view.aligned @ poses.inverse(exact_frame.world_from_hand), np.eye(4), view.centre)
    before = poses.difference(error, np.eye(4), view.centre)
    assert np.linalg.norm(left[3:]) < max(0.35 * np.linalg.norm(before[3:]), 0.0008)
    assert np.linalg.norm(left[:3]) < np.deg2rad(0.6)
    # the correction, applied to what the robot reports, is the aligned hand
    assert np.allclose(view.correct() @ view.measured, view.aligned)
    assert np.allclose(poses.perturb(np.eye(4), view.xi, view.centre) @ view.measured, view.aligned)


@pytest.mark.parametrize("way", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, -1, 1)])
@pytest.mark.parametrize("far", [0.015, 0.02])
def test_a_hand_is_found_where_no_alignment_reaches(exact_frame, way, far):
    error = poses.make_pose(None, far * np.array(way) / np.linalg.norm(way))
    view = look(exact_frame, world_from_hand=error @ exact_frame.world_from_hand)
    left = poses.difference(view.aligned @ poses.inverse(exact_frame.world_from_hand), np.eye(4), view.centre)
    assert np.linalg.norm(left[3:]) < 0.003
    # what it is told as is what was found
    assert np.allclose(poses.perturb(np.eye(4), view.xi, view.centre) @ view.measured, view.aligned)


def test_how_much_of_a_hand_is_explained_is_as_by_numpy(rng):
    lens, near, past = (500.0, 510.0, 40.3, 29.7), 0.012, 0.02
    points = np.stack([rng.uniform(-0.06, 0.06, 200), rng.uniform(-0.05, 0.05, 200), rng.uniform(0.4, 0.6, 200)], 1)
    points[:3, 2] = -0.2, 0.0, 0.01  # behind the camera, in it, and nearer than anything that is read
    depth = rng.uniform(0.4, 0.6, (60, 80)).astype(np.float32)
    depth[::7], depth[:, 5], depth[:, 9] = 0.0, np.nan, np.inf
    grid = [0.01 * rng.normal(size=count) for count in (3, 2, 4)]
    found = np.zeros((4, 2, 3), dtype=np.int64)
    explained(points, *grid, lens, depth, near, past, found)
    for place, count in np.ndenumerate(found.T):
        there = points + [line[k] for line, k in zip(grid, place)]
        there = there[there[:, 2] > past]
        u = np.floor(lens[0] * there[:, 0] / there[:, 2] + lens[2] + 0.5).astype(int)
        v = np.floor(lens[1] * there[:, 1] / there[:, 2] + lens[3] + 0.5).astype(int)
        inside = (u >= 0) & (v >= 0) & (u < 80) & (v < 60)
        read, z = depth[v[inside], u[inside]].astype(np.float64), there[inside, 2]
        good = is_reading(read)
        behind = read[good] - z[good]
        assert count == (np.abs(behind) < near).sum() - (behind > past).sum()


def test_without_an_error_hardly_anything_moves(exact_frame):
    view = look(exact_frame)
    assert np.linalg.norm(view.xi[3:]) < 0.0006
    assert np.abs(view.residual).max() < 0.005
    assert np.median(np.abs(view.residual)) < 0.0005
    # its own pixels are as near to it as their residuals say
    for limit in (0.0003, 0.001, 0.005):
        assert (view.nearer(view.points, limit) == (np.abs(view.residual) < limit)).all()


def test_a_hand_that_is_not_seen_is_left_where_it_was(exact_frame):
    view = look(exact_frame, depth=np.zeros_like(exact_frame.depth))
    assert np.array_equal(view.aligned, view.measured)
    assert (view.xi == 0).all()
    assert len(view.points) == 0
    assert np.allclose(view.correct(), np.eye(4), atol=1e-12)


def test_no_hand_no_view(exact_frame):
    assert look(exact_frame, hand=None) is None
    assert look(exact_frame, joints=None) is None
    assert look(exact_frame, world_from_hand=None) is None
    assert camera_from_hand(replace(exact_frame, world_from_hand=None)) is None


def test_an_error_made_at_the_camera_is_larger_at_the_hand():
    calibration = CalibrationModel()
    near = np.linalg.inv(prior_information(calibration, np.zeros(3)))
    far = np.linalg.inv(prior_information(calibration, np.array([0.0, 0.0, 0.6])))
    assert np.allclose(np.sqrt(np.diag(near)), [calibration.rotation_sigma] * 3 + [calibration.translation_sigma] * 3)
    across = np.hypot(calibration.translation_sigma, 0.6 * calibration.rotation_sigma)
    assert np.allclose(np.sqrt(np.diag(far))[3:], [across, across, calibration.translation_sigma])
    # by sampling: perturbing about the camera moves the hand's centre like this
    rng = np.random.default_rng(0)
    twist = rng.normal(size=(20_000, 6)) * ([calibration.rotation_sigma] * 3 + [calibration.translation_sigma] * 3)
    moved = poses.difference(poses.perturb(np.eye(4), twist, np.zeros(3)), np.eye(4), np.array([0.0, 0.0, 0.6]))
    assert np.allclose(np.cov(moved.T), far, atol=0.03 * far.max())
    spread = prior_spread(calibration, np.array([0.1, -0.2, 0.6]))
    information = prior_information(calibration, np.array([0.1, -0.2, 0.6]))
    assert np.array_equal(spread, np.tril(spread))
    assert np.allclose(spread @ spread.T @ information, np.eye(6), atol=1e-10)


@pytest.mark.parametrize("box", [FULL, (200, 100, 480, 300), (0, 0, 5, 5)])
def test_the_hands_depth_is_that_of_a_renderer(exact_frame, box):
    view = look(exact_frame)
    vertices, faces, _ = exact_frame.hand.mesh(exact_frame.joints)
    drawn = Renderer({"hand": (vertices, faces)}).render(exact_frame.camera, {"hand": view.aligned}, box)
    depth = view.depth(exact_frame.camera, box)
    there = drawn.ids >= 0
    assert depth.shape == there.shape
    assert (np.isfinite(depth) != there).mean() < 1e-3  # single precision, at the outline
    both = np.isfinite(depth) & there
    assert np.allclose(depth[both], drawn.depth[both], atol=1e-4)


def test_what_pixels_say_of_the_hand_is_as_by_numpy(rng):
    points, gradient = rng.normal(size=(60, 3)), rng.normal(size=(60, 3))
    distance, weight = 0.012 * rng.normal(size=60), rng.uniform(1.0, 2.0, 60)
    rotation, centre, gate = poses.exp_rotation(rng.normal(size=3)), rng.normal(size=3), 0.01
    hessian, pull = np.eye(6), rng.normal(size=6)
    whole, all_pull = hessian.copy(), pull.copy()
    direction, jacobian, robust = np.zeros((60, 3)), np.zeros((60, 6)), np.zeros(60)
    some = points, distance, gradient, rotation, centre, gate, weight
    pulls(*some, direction, jacobian, robust, whole, all_pull)
    turned = gradient @ rotation.T
    rows = -np.concatenate([np.cross(points - centre, turned), turned], axis=1)
    tukey = np.square(np.maximum(0.0, 1.0 - (distance / gate) ** 2))
    assert (tukey == 0.0).any()
    np.testing.assert_allclose(direction, turned, atol=1e-12)
    np.testing.assert_allclose(jacobian, rows, atol=1e-12)
    np.testing.assert_allclose(robust, tukey, atol=1e-12)
    np.testing.assert_allclose(whole, hessian + (rows * (weight * tukey)[:, None]).T @ rows, atol=1e-9)
    np.testing.assert_allclose(all_pull, pull + rows.T @ (weight * tukey * distance), atol=1e-9)


def test_how_many_points_of_a_hand_are_seen_past_is_as_by_numpy(rng):
    camera, depth = Camera(60.0, 61.0, 31.3, 23.7, 64, 48), rng.uniform(0.3, 0.9, (48, 64)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    depth[:3, :3] = np.nan
    points = rng.normal(size=(500, 3)) * [0.2, 0.2, 0.3] + [0.0, 0.0, 0.5]
    ahead = points[points[:, 2] > 1e-3]
    pixels = np.round(camera.project(ahead)[0]).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < [64, 48])).all(axis=1)
    seen, z = depth[pixels[inside, 1], pixels[inside, 0]].astype(np.float64), ahead[inside, 2]
    past = (seen > z + 0.012)[seen > 0.0]
    assert seen_past(points, (60.0, 61.0, 31.3, 23.7), depth, 0.012) == (len(past), past.sum())
    assert 0 < past.sum() < len(past) < len(points)
