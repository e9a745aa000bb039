"""From aligned poses to distinct modes: merging modulo symmetry, weights, finite covariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.evidence.align import Alignment
from scenes.evidence.leader_kernels import are_one, displacements
from scenes.evidence.modes import ModeSettings, covariance_of, distinct_modes, information_of
from scenes.geometry import poses
from scenes.synthesis import library


def aligned(stack, costs, hessian=None):
    count = len(stack)
    hessian = np.diag([1e4] * 3 + [1e6] * 3) if hessian is None else hessian
    return Alignment(
        np.asarray(stack),
        np.asarray(costs, dtype=float),
        np.tile(hessian, (count, 1, 1)),
        np.ones(count, dtype=np.int64),
    )


def draw(count, seed=0):
    rng = np.random.default_rng(seed)
    return poses.make_poses(poses.random_rotations(count, rng), rng.normal(size=(count, 3)))


@pytest.mark.parametrize("name", ["box", "cylinder", "pencil", "bottle", "sphere"])
def test_symmetric_duplicates_are_one_mode(name):
    model = library.make(name)
    assert not model.symmetries.is_trivial
    equivalents = draw(1)[0] @ model.symmetry_poses(steps=5)
    modes = distinct_modes(model, aligned(equivalents, np.linspace(0, 0.1, len(equivalents))))
    assert len(modes) == 1
    assert modes[0].weight == 1.0
    assert np.array_equal(modes[0].pose, equivalents[0])


def test_different_poses_stay_apart_and_weights_sum_to_one():
    model = library.make("drill")
    stack = draw(5)
    modes = distinct_modes(model, aligned(stack, [3.0, 0.5, 2.0, 0.0, 1.0]))
    assert [m.cost for m in modes] == [0.0, 0.5, 1.0, 2.0, 3.0]
    assert np.array_equal(modes[0].pose, stack[3])
    assert sum(m.weight for m in modes) == pytest.approx(1.0, abs=1e-12)
    # equal Hessians: Laplace weights are exp(-cost)
    assert modes[1].weight / modes[0].weight == pytest.approx(np.exp(-0.5), rel=1e-6)


def test_a_flatter_minimum_weighs_more():
    model = library.make("drill")
    stack = draw(2)
    hessians = np.stack([np.diag([1e4] * 3 + [1e6] * 3), np.diag([4e4] * 3 + [1e6] * 3)])
    result = Alignment(stack, np.zeros(2), hessians, np.ones(2, dtype=np.int64))
    first, second = distinct_modes(model, result)
    assert first.weight / second.weight == pytest.approx(8.0, rel=1e-2)


def test_costs_and_widths_count_as_much_as_they_are_told_to():
    model = library.make("drill")
    hessians = np.stack([np.diag([1e4] * 3 + [1e6] * 3), np.diag([4e4] * 3 + [1e6] * 3)])
    result = Alignment(draw(2), np.array([0.0, 3.0]), hessians, np.ones(2, dtype=np.int64))
    first, second = distinct_modes(model, result, ModeSettings(temper=0.5, width=-0.5))
    assert first.weight / second.weight == pytest.approx(np.exp(1.5) / np.sqrt(8.0), rel=1e-2)
    first, second = distinct_modes(model, result, ModeSettings(temper=1.0, width=0.0))
    assert first.weight / second.weight == pytest.approx(np.exp(3.0), rel=1e-6)


def test_near_poses_merge_and_far_costs_are_left_out():
    model = library.make("drill")
    base = draw(1)[0]
    near = poses.perturb(base, [0.02, 0, 0, 0.001, 0, 0], model.centroid)
    margin = ModeSettings().cost_margin
    modes = distinct_modes(model, aligned([base, near, draw(1, 9)[0]], [0.0, 1.0, margin + 1.0]))
    assert len(modes) == 1


def test_minima_that_are_one_mode_widen_it_by_as_much_as_they_lie_apart():
    model = library.make("drill")
    base = draw(1)[0]
    slid = poses.perturb(base, [0, 0, 0, 0.0, 0.008, 0.0], model.centroid)
    back = poses.perturb(base, [0, 0, 0, 0.0, -0.008, 0.0], model.centroid)
    own = ModeSettings(scatter=1.0, width=0.0)
    (plain,) = distinct_modes(model, aligned([base, slid, back], [0.0, 0.0, 0.0]))
    (wide,) = distinct_modes(model, aligned([base, slid, back], [0.0, 0.0, 0.0]), own)
    added = wide.covariance - plain.covariance
    expected = np.zeros((6, 6))
    expected[4, 4] = 2.0 / 3.0 * 0.008**2
    np.testing.assert_allclose(added, expected, atol=1e-9)
    np.testing.assert_array_equal(wide.pose, plain.pose)
    # one that is unlikely adds little, one that solutions ended in twice counts once, and where all end in one place
    # nothing is added
    (less,) = distinct_modes(model, aligned([base, slid], [0.0, 4.0]), own)
    share = np.exp(-4.0) / (1.0 + np.exp(-4.0))
    assert less.covariance[4, 4] - plain.covariance[4, 4] == pytest.approx(share * 0.008**2, rel=1e-6)
    (again,) = distinct_modes(model, aligned([base, slid, slid, back], [0.0, 0.0, 0.0, 0.0]), own)
    np.testing.assert_allclose(again.covariance, wide.covariance, atol=1e-12)
    (same,) = distinct_modes(model, aligned([base, base, base], [0.0, 0.0, 0.0]), own)
    np.testing.assert_array_equal(same.covariance, plain.covariance)


@pytest.mark.parametrize("name", ["bottle", "box"])
def test_minima_that_symmetry_makes_one_widen_nothing(name):
    model = library.make(name)
    base = draw(1)[0]
    equivalents = base @ model.symmetry_poses(steps=5)
    stack = aligned(equivalents, np.zeros(len(equivalents)))
    (wide,) = distinct_modes(model, stack, ModeSettings(scatter=1.0))
    np.testing.assert_allclose(wide.covariance, distinct_modes(model, stack)[0].covariance, atol=1e-12)


def test_a_wide_minimum_swallows_what_lies_within_its_own_width():
    model = library.make("drill")
    base = draw(1)[0]
    slid = poses.perturb(base, [0, 0, 0, 0.0, 0.04, 0.0], model.centroid)
    flat = np.diag([1e4] * 3 + [1e6, 1.0, 1e6])
    assert len(distinct_modes(model, aligned([base, slid], [0.0, 0.0], flat))) == 1
    assert len(distinct_modes(model, aligned([base, slid], [0.0, 0.0]))) == 2


def test_no_more_modes_than_asked():
    model = library.make("drill")
    stack = draw(60)
    modes = distinct_modes(model, aligned(stack, np.linspace(0, 1, 60)), ModeSettings(most=7))
    assert len(modes) == 7
    assert sum(m.weight for m in modes) == pytest.approx(1.0)


def test_costs_that_are_not_finite_are_no_modes():
    model = library.make("drill")
    assert distinct_modes(model, aligned(draw(2), [np.nan, np.inf])) == ()
    assert distinct_modes(model, aligned(np.zeros((0, 4, 4)), [])) == ()
    assert len(distinct_modes(model, aligned(draw(3), [np.nan, 1.0, np.inf]))) == 1


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.floats(-3, 12))
def test_a_singular_hessian_has_a_finite_covariance(seed, rank, size):
    model = library.make("drill")
    root = np.random.default_rng(seed).normal(size=(rank, 6)) * 10**size
    covariance = covariance_of(model, root.T @ root)
    assert np.isfinite(covariance).all()
    assert np.allclose(covariance, covariance.T)
    weak = np.array([1.0] * 3 + [model.radius] * 3)
    values = np.linalg.eigvalsh(covariance / weak / weak[:, None])
    assert values.min() > -1e-9
    assert values.max() <= 1 + 1e-9
    if size < 5:  # directions without information keep the widest prior (beyond, its digits are gone)
        assert (np.sort(values)[rank:] > 0.99).all()


def test_the_covariance_of_good_data_is_the_inverse_hessian():
    model = library.make("drill")
    root = np.random.default_rng(0).normal(size=(6, 6)) * ([1e3] * 3 + [1e5] * 3)
    hessian = root.T @ root
    assert np.allclose(covariance_of(model, hessian) @ hessian, np.eye(6), atol=1e-3)


def test_a_singular_hessian_makes_a_mode():
    model = library.make("sphere")
    hessian = np.diag([0.0] * 3 + [1e6] * 3)
    (mode,) = distinct_modes(model, aligned(draw(1), [0.0], hessian))
    assert np.isfinite(mode.covariance).all()
    assert np.allclose(np.diag(mode.covariance)[:3], 1.0)


def test_what_is_of_one_mode_is_so_by_numpy(rng):
    delta, root = rng.normal(size=(200, 6)) * np.repeat([0.1, 0.005], 3), rng.normal(size=(6, 6)) * 20.0
    hessian, radius, apart, sigmas, one = root @ root.T, 0.07, 0.012, 3.0, np.zeros(200, dtype=bool)
    own = rng.uniform(0.2, 2.0, 200)[:, None, None] * hessian
    are_one(delta, hessian, own, radius, apart, sigmas, one)
    moved = np.linalg.norm(delta[:, :3], axis=1) * radius + np.linalg.norm(delta[:, 3:], axis=1)
    square = np.einsum("ni,ij,nj->n", delta, hessian, delta)
    owns = np.einsum("ni,nij,nj->n", delta, own, delta)
    np.testing.assert_array_equal(one, (moved < apart) | ((square < sigmas**2) & (owns < sigmas**2)))
    assert 0 < one.sum() < 200
    way = np.zeros(200)
    displacements(delta, radius, way)
    np.testing.assert_allclose(way, moved, rtol=1e-12)


@given(st.integers(0, 10_000), st.integers(0, 6), st.floats(-9.0, 0.0))
def test_information_is_the_inverse_and_finite_where_a_direction_is_known_to_the_last_digit(seed, known, small):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    spread = np.where(np.arange(6) < known, 0.0, 10.0 ** rng.uniform(small, 0.0, 6))
    covariance = (axes * spread) @ axes.T
    information = information_of(np.array([covariance, np.eye(6)]))
    assert np.isfinite(information).all()
    assert np.linalg.eigvalsh(information[0]).min() >= 0.0 or known
    assert np.allclose(information[1], np.eye(6))
    if not known and small > -5.0:
        assert np.allclose(information[0] @ covariance, np.eye(6), atol=1e-6)


def test_what_nothing_ties_does_not_swallow_what_is_well_known():
    """A pose that hides behind other things is as wide as all it could be; a narrow minimum within that is another."""
    model = library.make("drill")
    aside = poses.perturb(np.eye(4), np.array([0.1, 0.0, 0.0, 0.03, 0.0, 0.0]), model.centroid)
    both, costs = np.array([np.eye(4), aside]), np.array([0.0, 4.0])
    loose, tied = np.zeros((6, 6)), np.diag([1e6] * 3 + [1e8] * 3)
    count = np.zeros(2, dtype=np.int64)
    found = distinct_modes(model, Alignment(both, costs, np.array([loose, tied]), count))
    assert len(found) == 2
    # of two that nothing ties, or that lie in one valley, one is left
    assert len(distinct_modes(model, Alignment(both, costs, np.array([loose, loose]), count))) == 1
