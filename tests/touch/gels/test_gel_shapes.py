"""The likelihood of whole patches: its derivatives, one pose error a sensor, and where it leads."""

from __future__ import annotations

import numpy as np
import pytest

from scenes.evidence import table as tables
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.synthesis import library
from touch.gels.patches import Patch
from touch.gels.shapes import Shapes, ShapeSettings, covariance_of, fit_shapes, hessians_at


def patches_on(model, count=3, seed=4):
    """Exact patches of 30 points around places of the object, in its own frame."""
    points, normals = model.sample_surface(20000, seed=seed)
    out = []
    for i in np.random.default_rng(seed).choice(len(points), count, replace=False):
        near = np.argsort(np.linalg.norm(points - points[i], axis=1) + 1.0 * (normals @ normals[i] < 0.2))[:200:7]
        sigma = np.full(len(near), 1e-4)
        out.append(Patch(f"g{i}", points[near], normals[near], sigma, sigma, np.zeros((0, 3)), np.eye(4)))
    return out


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_gradients_are_those_of_the_cost(mug):
    shapes = Shapes(patches_on(mug))
    pose = se3.perturb(np.eye(4), [0.02, -0.01, 0.03, 0.001, -0.0007, 0.0005], mug.centroid)
    cost, gradient, hessian = shapes.terms(mug, pose[None])
    step = 1e-6
    for axis in range(6):
        ends = se3.perturb(pose, step * np.array([np.eye(6)[axis], -np.eye(6)[axis]]), mug.centroid)
        upper, lower = shapes.terms(mug, ends)[0]
        scale = np.sqrt(2 * cost[0] * hessian[0, axis, axis])
        assert (upper - lower) / (2 * step) == pytest.approx(gradient[0, axis], abs=0.03 * scale)
    assert np.linalg.eigvalsh(hessian[0])[0] >= -1e-6


def test_whitening_agrees_with_the_covariance(mug):
    """The twin: half of r^T C^-1 r for each patch, which is within its scale here."""
    patches = patches_on(mug)
    pose = se3.perturb(np.eye(4), [0.0, 0.0, 0.01, 0.0005, 0.0, 0.0], mug.centroid)
    plain = 0.0
    for patch in patches:
        far = mug.field.distance(se3.apply(se3.inverse(pose), patch.points))
        plain += 0.5 * far @ np.linalg.solve(covariance_of(patch, ShapeSettings()), far)
    assert Shapes(patches).terms(mug, pose[None])[0][0] == pytest.approx(plain, rel=1e-6)


def test_a_shape_that_does_not_fit_costs_more_than_a_finger_that_is_off(mug):
    patch = patches_on(mug, 1)[0]
    settings = ShapeSettings()
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_of(patch, settings)))
    rigid = patch.normals @ (0.001 * patch.normals.mean(axis=0) / np.linalg.norm(patch.normals.mean(axis=0)))
    bent = 0.001 * np.sign(np.random.default_rng(0).normal(size=len(patch)))
    assert ((whiten @ rigid) ** 2).sum() < 4.0
    assert ((whiten @ bent) ** 2).sum() > 10 * ((whiten @ rigid) ** 2).sum()


def test_the_pull_of_what_lies_elsewhere_is_bounded(mug):
    shapes = Shapes(patches_on(mug, 1))
    away = np.array([se3.make_pose(None, [0.3 * k, 0.0, 0.0]) for k in (1, 10)])
    cost = shapes.terms(mug, away)[0]
    assert cost[1] - cost[0] < 29 * np.log(10) * 1.5  # n ln of the ratio of the distances


def test_a_fit_never_costs_more_and_comes_home(mug):
    patches = patches_on(mug)
    shapes, rows = Shapes(patches), tables.empty()
    rng = np.random.default_rng(1)
    starts = se3.perturb(np.eye(4), rng.normal(size=(5, 6)) * np.repeat([0.03, 0.002], 3), mug.centroid)
    before = shapes.terms(mug, starts)[0]
    found = fit_shapes(mug, shapes, starts, rows)
    assert (found.costs <= before + 1e-12).all()
    assert np.isfinite(found.poses).all()
    assert found.costs.min() < 0.5
    middle = mug.centroid + 0.01, 0.02
    prior = Prior.isotropic(np.eye(4), 0.1, 0.01)
    held = fit_shapes(mug, shapes, starts, rows, prior, middle)
    bend = hessians_at(mug, rows, held.poses, prior, middle)
    np.testing.assert_allclose(
        bend[:, 3:, 3:], np.broadcast_to(np.eye(3) * (0.01**-2 + 0.02**-2), (5, 3, 3)), rtol=1e-6
    )
    assert len(fit_shapes(mug, shapes, np.zeros((0, 4, 4)), rows).poses) == 0
