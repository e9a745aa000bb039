"""The compiled linear algebra of the joint solution against NumPy's."""

import numpy as np
import pytest
from joint_twin import made_problem

from fusion.estimation.solve import newton_kernels as kernels
from fusion.estimation.solve.kernels import blocks_off, hand_rows, lay_bells, number_blocks, places
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import Level
from fusion.estimation.solve.system import System
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


def test_rows_are_laid_as_terms_lay_them(drill, rng):
    problem, pose = made_problem(drill, rng)
    system = System(problem, pose, Level())
    unknown = np.concatenate([np.zeros(6), 0.3 * rng.normal(size=system.size - 6)])
    system.terms(pose, unknown)
    count, cost, room = system._used, system.seen_cost, [part.copy() for part in problem.room]
    for part in problem.room:
        part[:] = 0
    problem.filled_by = None
    system.stand(pose, unknown)
    assert (system._used, system.seen_cost) == (count, cost)
    for known, found in zip(room, problem.room, strict=True):
        np.testing.assert_array_equal(known[:count], found[:count])


def test_where_a_solution_ends_its_rows_are_at_hand(drill, rng):
    """Whether the last step was taken or refused, and whichever system of the problem filled the room last."""
    problem, pose = made_problem(drill, rng)
    systems = [System(problem, pose, Level(bias=bias)) for bias in (0.25, 4.0)]
    ends = [system.descend(pose, system.start(pose), system.size)[:2] for system in systems]
    for system, (end, unknown) in zip(systems, ends, strict=True):
        system.stand(end, unknown)
        found = system.seen_cost, system._used, [part[: system._used].copy() for part in problem.room]
        system.terms(end, unknown)
        assert found[1] == system._used
        np.testing.assert_allclose(found[0], system.seen_cost, rtol=1e-9)
        for known, part in zip(found[2], problem.room, strict=True):
            np.testing.assert_allclose(known, part[: system._used], rtol=1e-6, atol=1e-9)


def test_what_problems_of_one_frame_share_is_laid_out_once(drill, rng):
    problem, _ = made_problem(drill, rng)
    told = problem.model, problem.seen, problem.felt, problem.fingers, problem.prior, problem.hand, problem.beliefs
    again = JointProblem(*told, problem.camera, settings=problem.settings, beside=problem)
    assert again.bias is problem.bias
    elsewhere = problem.seen.take(np.arange(len(problem.seen)) < len(problem.seen) // 3)
    other = JointProblem(problem.model, elsewhere, *told[2:], problem.camera, settings=problem.settings, beside=problem)
    alone = JointProblem(problem.model, elsewhere, *told[2:], problem.camera, settings=problem.settings)
    np.testing.assert_array_equal(other.bias.inducing, alone.bias.inducing)
    np.testing.assert_array_equal(other.seen_basis, alone.seen_basis)


@pytest.mark.parametrize("count", [0, 5, 300])
def test_blocks_are_off_by_the_mean_of_their_pixels(rng, count):
    uv, on = rng.uniform(0, 200, (400, 2)), rng.random(400) < 0.8
    index = np.sort(rng.choice(400, count, replace=False))
    residuals, information = rng.normal(size=count), rng.uniform(0.1, 1.0, count) * (rng.random(count) < 0.9)
    off, weight = blocks_off(uv, on, index, residuals, information, 16.0, 16.0)
    mine = on[index] & (information > 0.0)
    assert len(off) == 0 or mine.any()
    if not mine.any():
        return
    group = np.zeros(mine.sum(), dtype=np.int64)
    number_blocks(uv, index[mine], 16.0, 16.0, group)
    expected = np.bincount(group, information[mine])
    np.testing.assert_array_equal(weight, expected)
    np.testing.assert_array_equal(off, np.bincount(group, (information * residuals)[mine]) / expected)
