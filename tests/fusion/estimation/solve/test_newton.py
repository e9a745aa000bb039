"""The compiled linear algebra of the joint solution against NumPy's."""

import numpy as np
import pytest

from fusion.estimation.solve import newton_kernels as kernels
from fusion.estimation.solve.kernels import hand_rows, lay_bells, places
from scenes.geometry.cameras import Camera


def positive(rng, size):
    a = rng.normal(size=(size + 3, size))
    return a.T @ a + 0.1 * np.eye(size)


@pytest.mark.parametrize(("size", "first"), [(1, 1), (7, 7), (40, 12), (53, 53)])
def test_systems_are_solved(rng, size, first):
    matrix, right = positive(rng, size), rng.normal(size=size)
    factor, found = matrix.copy(), right.copy()
    assert kernels.factorize(factor, first)
    kernels.solved(factor, first, found)
    np.testing.assert_allclose(found[:first], np.linalg.solve(matrix[:first, :first], right[:first]), rtol=1e-8)
    np.testing.assert_array_equal(found[first:], right[first:])


def test_what_is_not_positive_has_no_factor():
    assert not kernels.factorize(np.diag([1.0, -1.0]), 2)
    assert not kernels.factorize(np.zeros((2, 2)), 2)


@pytest.mark.parametrize("size", [1, 8, 9])
@pytest.mark.parametrize("count", [0, 1, 4, 11])
def test_products_are_added_up(rng, count, size):
    design, information, residuals = rng.normal(size=(count, size)), rng.uniform(size=count), rng.normal(size=count)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    kernels.add_products(design, information, residuals, count, normal, gradient)
    weighted = design * information[:, None]
    np.testing.assert_allclose(np.tril(normal), np.tril(weighted.T @ design), atol=1e-12)
    np.testing.assert_allclose(gradient, weighted.T @ residuals, atol=1e-12)


@pytest.mark.parametrize("count", [0, 3, 4, 10])
def test_the_bias_of_rows_is_a_product(rng, count):
    basis, unknown, bias = rng.normal(size=(count, 5)), rng.normal(size=5), np.full(count, 7.0)
    kernels.bias_of(basis, unknown, bias)
    np.testing.assert_allclose(bias, basis @ unknown, atol=1e-12)


@pytest.mark.parametrize("free", [12, 15])
def test_leaving_groups_out_is_a_step_of_the_rest(rng, free):
    """Columns stand for the pose, and for scale and bias, which are solved for or not."""
    count, groups, share = 60, 7, 0.9
    design, information, residuals = rng.normal(size=(count, 9)), rng.uniform(size=count), rng.normal(size=count)
    group, columns = rng.integers(0, groups, count), np.array([0, 1, 2, 3, 4, 5, 12, 13, 14])
    rows = np.zeros((count, 15))
    rows[:, columns] = design
    rows = rows[:, :free]
    whole = rows.T @ (rows * information[:, None]) + positive(rng, free)
    own, moved = np.zeros((free, free)), np.zeros((groups, 6))
    given = design, information, residuals, group, groups, columns
    assert kernels.left_out(*given, whole, share, own, moved)
    np.testing.assert_allclose(own, rows.T @ (rows * information[:, None]), atol=1e-10)
    for g in range(groups):
        mine = rows[group == g] * information[group == g, None]
        step = np.linalg.solve(whole - share * mine.T @ rows[group == g], mine.T @ residuals[group == g])
        np.testing.assert_allclose(moved[g], step[:6], atol=1e-9)


def test_bells_along_lines_are_those_of_distances(rng):
    columns, rows = np.array([10.0, 40.0, 70.0]), np.array([5.0, 35.0])
    lines = np.array([[u, v] for v in rows for u in columns])[[0, 1, 2, 4]]
    uv, out = rng.uniform(-20.0, 100.0, (50, 2)), np.zeros((50, 4))
    (u, column), (v, row) = (np.unique(lines[:, axis], return_inverse=True) for axis in (0, 1))
    lay_bells(uv, u, column, v, row, -0.5 / 30.0**2, out)
    square = np.square(uv[:, None] - lines).sum(axis=-1)
    np.testing.assert_allclose(out, np.exp(-0.5 * square / 30.0**2), rtol=1e-12)


def test_places_in_the_image_are_a_cameras(rng):
    camera, points = Camera(600.0, 610.0, 321.3, 238.7, 640, 480), rng.normal(size=(40, 3))
    points[:, 2] = np.abs(points[:, 2]) + 0.1
    uv, bounds = np.zeros((40, 2)), np.zeros((2, 2))
    places(points, (600.0, 610.0, 321.3, 238.7), uv, bounds)
    assert np.array_equal(uv, camera.project(points)[0])
    assert np.array_equal(bounds, [uv.min(axis=0), uv.max(axis=0)])


def test_rows_of_a_hand_are_those_of_plain_arrays(rng):
    points, directions, basis = rng.normal(size=(30, 3)) + 5.0, rng.normal(size=(30, 3)), rng.random((30, 4))
    centre, jacobian = rng.normal(size=3), np.zeros((30, 11))
    hand_rows(points, directions, centre, basis, jacobian)
    along = -np.sum(directions * points / points[:, 2:], axis=1)
    turns = -np.cross(points - centre, directions)
    expected = [turns, -directions, (along * points[:, 2])[:, None], along[:, None] * basis]
    np.testing.assert_allclose(jacobian, np.concatenate(expected, axis=1), atol=1e-12)
