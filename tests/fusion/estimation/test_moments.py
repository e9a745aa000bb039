"""Mean and covariance of posteriors that are no Gaussians: against sums over grids and over many samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from fusion.estimation.posterior.moments import MomentSettings, moments, uneven_rows
from fusion.estimation.solve.kernels import log_mixture
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior, align, costs
from scenes.evidence.table import GATE_ABOVE, TOUCH, VISION
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import shapes

SIDES = 64


@pytest.fixture(scope="module")
def prism():
    """A prism of 64 sides, 8 cm wide and 10 cm high: a cylinder as a mesh has it, of no declared symmetry."""
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    vertices, faces = shapes.extrude(0.04 * np.stack([np.cos(turn), np.sin(turn)], axis=1), 0.1)
    return ObjectModel.from_mesh(vertices, faces, name="prism")


def held(model, count, seed, normals=True):
    """Exact contacts on the object where it is, with the usual sigmas, and a prior of 10 degrees and 1 cm."""
    points, outward = model.sample_surface(count, seed=seed)
    rows = evidence.make(points, 9e-4, TOUCH, normals=outward if normals else None, sigma_normal=0.087, gate_above=1e6)
    return rows, Prior.isotropic(np.eye(4), np.deg2rad(10.0), 0.01)


def spin(model, covariance):
    return float(np.sqrt(covariance[2, 2]))


def test_facets_do_not_make_a_cylinder_sure_of_its_turn(prism):
    rows, prior = held(prism, 6, 3)
    found = align(prism, rows, np.eye(4)[None], prior)
    laplace = np.linalg.inv(found.hessians[0])
    pose = found.poses[0]
    turns = np.deg2rad(np.linspace(-50, 50, 401))
    along = poses.perturb(pose, np.outer(turns, [0, 0, 1, 0, 0, 0]), prism.centroid)
    density = np.exp(-(costs(prism, rows, along, prior) - found.costs[0]))
    mean = np.sum(density * turns) / density.sum()
    exact = np.sqrt(np.sum(density * (turns - mean) ** 2) / density.sum())
    assert spin(prism, laplace) < 0.6 * exact, "the case is not the one meant"
    result = moments(prism, rows, pose, laplace, 0, prior)
    assert result.widened >= 1
    assert spin(prism, result.covariance) == pytest.approx(exact, rel=0.5)


def test_distances_alone_keep_their_gaussian(prism):
    rows, prior = held(prism, 12, 3, normals=False)
    found = align(prism, rows, np.eye(4)[None], prior)
    covariance = np.linalg.inv(found.hessians[0])
    result = moments(prism, rows, found.poses[0], covariance, 0, prior)
    assert result.effective == 0.0
    assert np.array_equal(result.pose, found.poses[0])
    assert np.array_equal(result.covariance, covariance)


def test_a_wall_is_no_spring(drill):
    """A wide prior and a wall that its mean presses into: nothing holds the object on the free side."""
    prior = Prior.isotropic(np.eye(4), 0.02, 0.01)
    top = drill.vertices[np.argmax(drill.vertices[:, 2])]
    wall = evidence.outside(np.tile(top - np.array([0, 0, 0.002]), (5, 1)), 0.001, VISION, gate=1e3)
    found = align(drill, wall, np.eye(4)[None], prior)
    covariance = np.linalg.inv(found.hessians[0])
    result = moments(drill, wall, found.poses[0], covariance, 0, prior)
    many = np.random.default_rng(5).normal(size=(20000, 6)) * ([0.02] * 3 + [0.01] * 3)
    weight = np.exp(-costs(drill, wall, poses.perturb(np.eye(4), many, drill.centroid)))
    weight /= weight.sum()
    exact = np.cov(many.T, aweights=weight)
    _, vectors = np.linalg.eigh(covariance[3:, 3:])
    across = np.concatenate([np.zeros(3), vectors[:, 0]])  # straight at the wall
    assert across @ covariance @ across < 0.5 * (across @ exact @ across), "the case is not the one meant"
    assert result.widened >= 1
    assert across @ result.covariance @ across == pytest.approx(across @ exact @ across, rel=0.6)


@given(st.integers(0, 2**31 - 1), st.integers(1, 8))
def test_never_narrower_and_always_finite(prism, seed, count):
    rows, prior = held(prism, count, seed)
    found = align(prism, rows, np.eye(4)[None], prior)
    covariance = np.linalg.inv(found.hessians[0])
    result = moments(prism, rows, found.poses[0], covariance, seed, prior)
    assert np.isfinite(result.covariance).all()
    assert np.linalg.eigvalsh(result.covariance - covariance).min() > -1e-9
    poses.check_pose(result.pose)
    again = moments(prism, rows, found.poses[0], covariance, seed, prior)
    assert np.array_equal(result.pose, again.pose)
    assert np.array_equal(result.covariance, again.covariance)


def test_nothing_known_at_all_keeps_what_there_was(drill):
    covariance = np.diag([1.0] * 3 + [0.01] * 3)
    result = moments(drill, evidence.empty(), np.eye(4), covariance, 0)
    assert np.array_equal(result.covariance, covariance)


def test_the_uneven_rows_are_walls_and_normals(prism):
    rows, _ = held(prism, 5, 1)
    seen = evidence.make(rows.points, 0.002, VISION)
    walls = evidence.outside(rows.points, 0.003, VISION, gate=3.0)
    uneven = uneven_rows(evidence.stack(rows, seen, walls))
    assert len(uneven) == 10
    assert (uneven.rows[:, GATE_ABOVE] == 0).sum() == 5


def test_few_samples_tell_nothing(prism):
    rows, prior = held(prism, 6, 3)
    found = align(prism, rows, np.eye(4)[None], prior)
    covariance = np.linalg.inv(found.hessians[0])
    result = moments(prism, rows, found.poses[0], covariance, 0, prior, settings=MomentSettings(effective=1e9))
    assert result.widened == 0
    assert np.array_equal(result.covariance, covariance)


def test_the_density_of_a_mixture_is_that_of_its_gaussians(rng):
    z, means, roots = rng.normal(size=(40, 6)), rng.normal(size=(3, 6)), rng.normal(size=(3, 6, 6))
    factors, counts, out = (
        np.linalg.cholesky(roots @ np.swapaxes(roots, 1, 2) + np.eye(6)),
        [5.0, 7.0, 11.0],
        np.zeros(40),
    )
    log_mixture(z, means, factors, np.array(counts), out)
    each = [multivariate_normal(m, f @ f.T).logpdf(z) + np.log(n) for m, f, n in zip(means, factors, counts)]
    np.testing.assert_allclose(out, np.logaddexp.reduce(each) + 3.0 * np.log(2.0 * np.pi), rtol=1e-10)
