"""Metrics against brute force, scipy and numerical integration; properties that must hold for any pose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion.truth import metrics
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.symmetries import Axis, Symmetries

seeds = st.integers(0, 2**32 - 1)
CAMERA = Camera(100.0, 110.0, 32.0, 24.0, 64, 48)


def random_pose(rng, far=0.5):
    return poses.make_pose(poses.random_rotations(1, rng)[0], rng.uniform(-0.1, 0.1, 3) + np.array([0, 0, far]))


def cloud(rng, count=200):
    return rng.uniform(-0.05, 0.05, (count, 3))


def bottle_points(turns=72):
    """A body of revolution about z through (0.01, 0, 0): rings of points, invariant to steps of 5 degrees."""
    angle = np.linspace(0, 2 * np.pi, turns, endpoint=False)
    rings = [
        np.stack([r * np.cos(angle) + 0.01, r * np.sin(angle), np.full(turns, z)], 1)
        for z, r in [(-0.08, 0.03), (0.0, 0.035), (0.06, 0.012), (0.1, 0.01)]
    ]
    return np.concatenate(rings)


BOTTLE = Symmetries.about_axis((0, 0, 1), point=(0.01, 0, 0))


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_add_and_add_s_equal_brute_force(seed):
    rng = np.random.default_rng(seed)
    a, b, points = random_pose(rng), random_pose(rng), cloud(rng)
    at_a, at_b = poses.apply(a, points), poses.apply(b, points)
    assert metrics.add(a, b, points) == pytest.approx(np.linalg.norm(at_a - at_b, axis=1).mean(), rel=1e-12)
    nearest = np.linalg.norm(at_b[:, None] - at_a[None], axis=2).min(axis=1).mean()
    assert metrics.add_s(a, b, points) == pytest.approx(nearest, rel=1e-9)
    assert metrics.add_s(a, b, points) <= metrics.add(a, b, points) + 1e-15


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_moving_the_camera_changes_no_distance(seed):
    rng = np.random.default_rng(seed)
    a, b, move, points = random_pose(rng), random_pose(rng), random_pose(rng), cloud(rng)
    for metric in (metrics.add, metrics.add_s, metrics.mssd):
        assert metric(move @ a, move @ b, points) == pytest.approx(metric(a, b, points), rel=1e-7, abs=1e-12)
    assert metrics.rotation_error(move @ a, move @ b) == pytest.approx(metrics.rotation_error(a, b), abs=1e-7)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_the_same_pose_has_no_error(seed):
    rng = np.random.default_rng(seed)
    pose, points = random_pose(rng), cloud(rng)
    errors = [
        metrics.add(pose, pose, points),
        metrics.add_s(pose, pose, points),
        metrics.mssd(pose, pose, points, BOTTLE),
        metrics.mspd(pose, pose, points, CAMERA, BOTTLE),
        metrics.rotation_error(pose, pose),
        metrics.translation_error(pose, pose),
    ]
    assert max(errors) < 1e-7


def test_mssd_of_a_mesh_is_reached_at_a_vertex():
    rng = np.random.default_rng(0)
    triangle = cloud(rng, 3)
    inside = rng.dirichlet(np.ones(3), 500) @ triangle
    a, b = random_pose(rng), random_pose(rng)
    assert metrics.mssd(a, b, inside) <= metrics.mssd(a, b, triangle)


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(-np.pi, np.pi))
def test_a_spin_about_the_symmetry_axis_is_no_error(seed, angle):
    rng = np.random.default_rng(seed)
    truth = random_pose(rng)
    turn = poses.exp_rotation([0, 0, angle])
    spin = poses.make_pose(turn, BOTTLE.axes[0].point - turn @ BOTTLE.axes[0].point)
    assert metrics.rotation_error(truth @ spin, truth, BOTTLE) < 1e-7
    assert metrics.translation_error(truth @ spin, truth, BOTTLE) < 1e-12
    assert metrics.mssd(truth @ spin, truth, bottle_points(), BOTTLE) < 1e-9
    assert metrics.mspd(truth @ spin, truth, bottle_points(), CAMERA, BOTTLE) < 1e-6


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_the_closed_form_turn_beats_a_dense_scan(seed):
    rng = np.random.default_rng(seed)
    estimate, truth = random_pose(rng), random_pose(rng)
    exact = metrics.rotation_error(estimate, truth, BOTTLE)
    scan = estimate[:3, :3] @ BOTTLE.poses(3600)[:, :3, :3] @ truth[:3, :3].T
    scanned = Rotation.from_matrix(scan).magnitude().min()
    assert exact <= scanned + 1e-9
    assert exact == pytest.approx(scanned, abs=2e-3)


def test_discrete_symmetry_and_plain_rotation_against_scipy():
    rng = np.random.default_rng(3)
    truth = random_pose(rng)
    half = poses.make_pose(poses.exp_rotation([np.pi, 0, 0]))
    box = Symmetries(np.array([np.eye(4), half]))
    estimate = poses.perturb(truth, [0.02, 0.01, -0.03, 0.001, 0.002, 0.003], np.zeros(3)) @ half
    expected = Rotation.from_rotvec([0.02, 0.01, -0.03]).magnitude()
    assert metrics.rotation_error(estimate, truth, box) == pytest.approx(expected, abs=1e-12)
    assert metrics.translation_error(estimate, truth, box) == pytest.approx(np.linalg.norm([1, 2, 3]) * 1e-3)
    assert metrics.rotation_error(estimate, truth) > 3.0
    assert metrics.pose_error(estimate, truth, np.zeros(3), box) == pytest.approx(
        [0.02, 0.01, -0.03, 0.001, 0.002, 0.003], abs=1e-12
    )


def test_a_ball_has_only_a_translation_error():
    ball = Symmetries(axes=(Axis(np.zeros(3), np.array([0, 0, 1.0])), Axis(np.zeros(3), np.array([1.0, 0, 0]))))
    rng = np.random.default_rng(5)
    truth = random_pose(rng)
    estimate = truth @ poses.make_pose(poses.random_rotations(1, rng)[0])
    estimate[:3, 3] += [0.003, 0, 0.004]
    points = 0.04 * poses.random_unit_vectors(500, rng)
    assert metrics.rotation_error(estimate, truth, ball) < 1e-7
    assert metrics.translation_error(estimate, truth, ball) == pytest.approx(0.005)
    assert metrics.mssd(estimate, truth, points, ball) == pytest.approx(0.005)


def test_translation_about_a_far_origin_counts_only_at_the_origin():
    truth = np.eye(4)
    centre = np.array([0.0, 0.0, 0.3])
    estimate = poses.perturb(truth, [0.1, 0, 0, 0, 0, 0], centre)
    assert metrics.translation_error(estimate, truth, centre=centre) < 1e-12
    assert metrics.translation_error(estimate, truth) == pytest.approx(2 * 0.3 * np.sin(0.05))


def test_mspd_is_a_shift_in_pixels_and_infinite_behind_the_camera():
    truth = poses.make_pose(translation=[0, 0, 0.5])
    estimate = poses.make_pose(translation=[0.01, 0, 0.5])
    flat = np.array([[0.0, 0, 0], [0.02, 0.01, 0]])
    assert metrics.mspd(estimate, truth, flat, CAMERA) == pytest.approx(CAMERA.fx * 0.01 / 0.5)
    assert metrics.mspd(poses.make_pose(translation=[0, 0, -0.5]), truth, flat, CAMERA) == float("inf")


class TestVsd:
    shape = (48, 64)

    def image(self, columns, depth):
        out = np.zeros(self.shape)
        out[:, columns] = depth
        return out

    def test_agreement_disjointness_and_half_overlap(self):
        truth = self.image(slice(10, 30), 0.5)
        assert metrics.vsd(truth, truth, truth, CAMERA) == 0.0
        assert metrics.vsd(self.image(slice(40, 60), 0.5), truth, np.zeros(self.shape), CAMERA) == 1.0
        shifted = self.image(slice(20, 40), 0.5)
        assert metrics.vsd(shifted, truth, np.zeros(self.shape), CAMERA) == pytest.approx(20 / 30)
        assert metrics.vsd(np.zeros(self.shape), np.zeros(self.shape), truth, CAMERA) == 1.0

    def test_depth_off_by_more_than_tau(self):
        truth, estimate = self.image(slice(10, 30), 0.5), self.image(slice(10, 30), 0.53)
        assert metrics.vsd(estimate, truth, truth, CAMERA, tau=0.02) == 1.0
        assert metrics.vsd(estimate, truth, truth, CAMERA, tau=0.05) == 0.0
        assert metrics.vsd(estimate, truth, truth, CAMERA, tau=[0.02, 0.05]) == 0.5

    def test_what_an_occluder_hides_does_not_count(self):
        truth, estimate = self.image(slice(10, 30), 0.5), self.image(slice(10, 30), 0.5)
        estimate[:, 10:20] = 0.55
        hand = truth.copy()
        hand[:, 10:20] = 0.3
        assert metrics.vsd(estimate, truth, truth, CAMERA) == 0.5
        assert metrics.vsd(estimate, truth, hand, CAMERA) == 0.0

    def test_refuses_images_of_another_camera(self):
        with pytest.raises(InputError, match="three depth images"):
            metrics.vsd(np.zeros((2, 2)), np.zeros(self.shape), np.zeros(self.shape), CAMERA)


class TestNees:
    def test_is_the_mahalanobis_square(self):
        rng = np.random.default_rng(1)
        root = rng.normal(size=(6, 6)) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
        covariance, error = root.T @ root, rng.normal(size=6) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
        assert metrics.nees(error, covariance) == pytest.approx(error @ np.linalg.solve(covariance, error), rel=1e-8)

    def test_averages_to_the_dimension(self):
        rng = np.random.default_rng(2)
        root = rng.normal(size=(6, 6)) * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])[:, None]
        errors = rng.normal(size=(4000, 6)) @ root.T
        assert np.mean([metrics.nees(e, root @ root.T) for e in errors]) == pytest.approx(6, abs=0.25)

    def test_no_variance_is_a_claim(self):
        covariance = np.diag([1e-4, 1e-4, 0.0, 1e-6, 1e-6, 1e-6])
        assert metrics.nees([0.01, 0, 0, 0.001, 0, 0], covariance) == pytest.approx(2)
        assert metrics.nees([0.01, 0, 1e-6, 0.001, 0, 0], covariance) == float("inf")
        # correlated: the null direction is the difference of the first two
        tied = np.array([[1.0, 1.0], [1.0, 1.0]])
        assert metrics.nees([1.0, 1.0], tied) == pytest.approx(1)
        assert metrics.nees([1.0, -1.0], tied) == float("inf")

    def test_nonsense_is_not_a_number(self):
        assert np.isnan(metrics.nees(np.zeros(6), np.full((6, 6), np.nan)))
        assert np.isnan(metrics.nees([1.0, -1.0], [[1.0, 2.0], [2.0, 1.0]]))
        with pytest.raises(InputError, match="covariance"):
            metrics.nees(np.zeros(6), np.eye(5))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0, 0.3), min_size=1, max_size=30))
def test_auc_is_the_integral_of_recall(errors):
    grid = np.linspace(0, 0.1, 20001)
    curve = (np.asarray(errors)[None, :] <= grid[:, None]).mean(axis=1)
    assert metrics.auc(errors) == pytest.approx(np.trapezoid(curve, grid) / 0.1, abs=2e-4)


def test_no_answer_is_a_miss():
    assert metrics.auc([0.0, np.nan, np.inf, 0.0]) == pytest.approx(0.5)
    assert metrics.recall([0.001, np.nan, 0.02, 0.004], 0.005) == 0.5
    assert np.isnan(metrics.auc([]))
    assert np.isnan(metrics.recall([], 1.0))
    with pytest.raises(InputError, match="limit"):
        metrics.auc([0.1], limit=0)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((3, 2)), np.zeros(3)])
def test_refuses_points_that_are_not(points):
    with pytest.raises(InputError, match="points of shape"):
        metrics.add(np.eye(4), np.eye(4), points)


def test_refuses_a_pose_that_is_not_finite():
    with pytest.raises(InputError, match="estimate"):
        metrics.add(np.full((4, 4), np.nan), np.eye(4), np.zeros((1, 3)))


@pytest.mark.parametrize("tau", [np.nan, 0.0, -0.01, [], [0.01, np.inf]])
def test_refuses_tolerances_that_are_none(tau):
    image = np.full((CAMERA.height, CAMERA.width), 0.5)
    with pytest.raises(InputError, match="vsd: expected tau above 0 and delta, finite metres, got"):
        metrics.vsd(image, image, image, CAMERA, tau=tau)
