"""Coarse to fine: thinning keeps the total weight, rotations are even, the search finds what the data say."""

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.evidence import table as evidence
from scenes.evidence.align import Alignment, AlignSettings, Prior, costs
from scenes.evidence.search import (
    SearchStage,
    best_that_differ,
    distinct_first,
    first_of_cells,
    first_of_each,
    leaders,
    least_of,
    rotation_grid,
    search,
    starts_around,
    starts_of_prior,
    thin,
)
from scenes.evidence.table import TOUCH, VISION, WEIGHT
from scenes.geometry import poses
from scenes.synthesis import library


def table(vision, touch, rng):
    return evidence.stack(
        evidence.make(rng.normal(size=(vision, 3)), 1e-3, VISION, weight=0.3),
        evidence.make(rng.normal(size=(touch, 3)), 1e-3, TOUCH),
    )


@pytest.mark.parametrize(("vision", "count"), [(500, 80), (500, 499), (81, 80), (7, 3), (1000, 1)])
def test_thinning_keeps_the_weight_of_vision_and_every_touch_row(vision, count, rng):
    full = table(vision, 6, rng)
    few = thin(full, count)
    assert len(few.of(VISION)) == count
    assert few.of(VISION).rows[:, WEIGHT].sum() == pytest.approx(full.of(VISION).rows[:, WEIGHT].sum())
    assert np.array_equal(few.of(TOUCH).rows, full.of(TOUCH).rows)
    assert (full.of(VISION).rows[:, WEIGHT] == 0.3).all()  # the table itself is left alone
    assert {tuple(p) for p in few.points} <= {tuple(p) for p in full.points}


def test_a_small_table_is_not_thinned(rng):
    full = table(40, 6, rng)
    assert thin(full, 40) is full
    assert len(thin(table(0, 3, rng), 5)) == 3


@pytest.mark.parametrize("count", [500, 3000])
def test_rotations_are_even(count):
    q = poses.to_quaternion(rotation_grid(count))
    cosine = np.abs(q @ q.T)
    np.fill_diagonal(cosine, 0.0)
    nearest = 2 * np.arccos(np.minimum(cosine.max(axis=1), 1.0))
    # a perfect packing of n rotations has about this angle between neighbours (volume of SO(3) over n)
    ideal = (np.pi**2 * 8 / count) ** (1 / 3)
    assert nearest.max() < 1.25 * ideal
    assert nearest.min() > 0.5 * ideal
    # and no rotation is far from all of them
    probes = poses.to_quaternion(poses.random_rotations(2000, np.random.default_rng(0)))
    gap = 2 * np.arccos(np.minimum(np.abs(probes @ q.T).max(axis=1), 1.0))
    assert gap.max() < 1.25 * ideal


def test_rotation_grids_repeat_and_turn():
    assert np.array_equal(rotation_grid(50), rotation_grid(50))
    turned = rotation_grid(50, np.random.default_rng(1))
    assert np.array_equal(turned, rotation_grid(50, np.random.default_rng(1)))
    assert not np.allclose(turned, rotation_grid(50))
    relative = turned @ np.swapaxes(rotation_grid(50), 1, 2)
    assert np.allclose(relative, relative[0], atol=1e-12)


def test_starts_around_a_prior(rng):
    model = library.make("drill")
    mean = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    starts = starts_around(model, mean, 0.1, 0.02, 4000, rng)
    delta = poses.difference(starts, mean, model.centroid)
    assert np.allclose(starts[0], mean, atol=1e-12)
    assert np.allclose(delta[1:, :3].std(axis=0), 0.1, rtol=0.06)
    assert np.allclose(delta[1:, 3:].std(axis=0), 0.02, rtol=0.06)


def correlated_prior(rng, pose, thin=1e4):
    """About 20 mm and 10 degrees a direction, but for one mix of both that is known `thin` times as well."""
    unit = np.repeat([np.deg2rad(10.0), 0.02], 3)
    basis, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    precision = (basis * np.array([thin, 1, 1, 1, 1, 1])) @ basis.T
    return Prior(pose, precision / unit / unit[:, None])


def test_draws_of_a_correlated_prior_are_as_wide_as_it_is(rng):
    model = library.make("drill")
    mean = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    prior = correlated_prior(rng, mean)
    covariance = np.linalg.inv(prior.information)
    starts = starts_of_prior(model, prior, 6000, np.deg2rad(60.0), 1.0, rng)
    delta = poses.difference(starts, mean, model.centroid)[1:]
    assert np.allclose(starts[0], mean, atol=1e-12)
    assert np.allclose(delta.std(axis=0), np.sqrt(np.diag(covariance)), rtol=0.06)
    # 1 / diag(information) took the widths that remain when all else is known
    assert np.sqrt(1 / np.diag(prior.information)).max() < 0.7 * np.sqrt(np.diag(covariance)).max()
    white = delta @ np.linalg.cholesky(prior.information)
    assert np.allclose(white.T @ white / len(white), np.eye(6), atol=0.1)


def test_draws_of_an_isotropic_prior_stay_the_same(rng):
    model = library.make("drill")
    seeded = [np.random.default_rng(3) for _ in range(2)]
    before = starts_around(model, np.eye(4), 0.1, 0.02, 50, seeded[0])
    after = starts_of_prior(model, Prior.isotropic(np.eye(4), 0.1, 0.02), 50, 1.0, 1.0, seeded[1])
    assert np.allclose(before, after, atol=1e-12)


@pytest.mark.parametrize("information", [np.zeros((6, 6)), np.diag([0.0, 0.0, 1e4, 1e-9, 1e6, 0.0])])
def test_a_prior_that_knows_nothing_is_drawn_as_wide_as_told(rng, information):
    model = library.make("drill")
    starts = starts_of_prior(model, Prior(np.eye(4), information), 4000, 0.3, 0.1, rng)
    delta = poses.difference(starts, np.eye(4), model.centroid)[1:]
    expected = np.minimum(1 / np.sqrt(np.maximum(np.diag(information), 1e-12)), np.repeat([0.3, 0.1], 3))
    assert np.allclose(delta.std(axis=0), expected, rtol=0.1)


def test_the_search_finds_the_pose_and_repeats(rng):
    model = library.make("drill")
    truth = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    points, _ = model.sample_surface(300, seed=1)
    rows = evidence.make(poses.apply(truth, points), 1e-3, VISION)
    starts = starts_around(model, truth, 0.3, 0.03, 200, rng)
    stages = (SearchStage(0.01, 0.5, 60, 8, 40), SearchStage(0.003, 0.2, 150, 20, 10))
    found = search(model, rows, starts, stages)
    assert (np.diff(found.costs) >= 0).all()
    assert len(found.poses) <= 10
    delta = poses.difference(found.poses[0], truth, model.centroid)
    assert np.linalg.norm(delta[3:]) < 1e-3
    assert np.linalg.norm(delta[:3]) < 0.02
    assert np.array_equal(search(model, rows, starts, stages).poses, found.poses)


def test_a_search_needs_a_stage(rng):
    with pytest.raises(InputError, match="at least one stage"):
        search(library.make("box"), evidence.empty(), np.eye(4)[None], ())


def test_poses_that_fell_together_count_once(rng):
    model = library.make("drill")
    distinct = poses.make_poses(poses.random_rotations(4, rng), rng.normal(size=(4, 3)))
    stack = np.concatenate([distinct, distinct, distinct])
    costs = np.concatenate([[3.0, 1.0, 2.0, 0.0]] * 3) + np.repeat([0.0, 1e-9, 2e-9], 4)
    result = Alignment(stack, costs, np.zeros((12, 6, 6)), np.ones(12, dtype=np.int64))
    assert distinct_first(model, result, 10).tolist() == [3, 1, 2, 0]
    assert distinct_first(model, result, 2).tolist() == [3, 1]


def test_equivalents_of_a_symmetric_object_count_once(rng):
    """A bottle that is turned about its axis is where it was; one that is turned over is not."""
    model = library.make("bottle")
    axis = model.symmetries.axes[0]
    about = poses.exp_rotation(np.linspace(0.1, 6.0, 40)[:, None] * axis.direction)
    turns = poses.make_poses(about, axis.point - about @ axis.point)
    over = poses.exp_rotation(np.pi * np.cross(axis.direction, [1.0, 0.0, 0.0])[None])[0]
    truth, other = poses.make_poses(poses.random_rotations(2, rng), rng.normal(size=(2, 3)))
    turned_over = truth @ poses.make_pose(over, model.centroid - over @ model.centroid)
    stack = np.concatenate([truth @ turns, other @ turns, turned_over @ turns])
    costs = np.arange(120.0)
    result = Alignment(stack, costs, np.zeros((120, 6, 6)), np.ones(120, dtype=np.int64))
    assert distinct_first(model, result, 20).tolist() == [0, 40, 80]


def test_the_first_of_each_cell_is_as_by_hand(rng):
    model = library.make("box")
    centres = poses.make_poses(poses.random_rotations(6, rng), 0.1 * rng.normal(size=(6, 3)))
    members = model.symmetries.discrete[rng.integers(len(model.symmetries.discrete), size=60)]
    which = rng.integers(6, size=60)
    stack = centres[which] @ members
    order = rng.permutation(60)
    found = first_of_cells(model, stack, order, 0.03, 0.03)
    assert found.tolist() == [next(n for n in order if which[n] == k) for k in dict.fromkeys(which[order])]
    assert len(first_of_cells(model, stack, order[:0], 0.03, 0.03)) == 0


def leaders_by_arrays(model, candidates, apart):
    """The twin of `leaders` in plain NumPy."""
    chosen, group = [], np.full(len(candidates), -1)
    middles = poses.apply(candidates, model.centroid[None])[:, 0]
    for n, pose in enumerate(candidates):
        for k, other in enumerate(chosen):
            alike = model.symmetries.nearest(pose, candidates[other])
            chord = np.linalg.norm(alike[:3, :3] - candidates[other][:3, :3]) / np.sqrt(2.0)
            if chord * model.radius + np.linalg.norm(middles[n] - middles[other]) < apart:
                group[n] = k
                break
        else:
            group[n] = len(chosen)
            chosen.append(n)
    return chosen, group


@pytest.mark.parametrize("name", ["drill", "box", "bottle", "cylinder", "sphere"])
def test_leaders_stand_for_poses_that_look_alike(name, rng):
    model = library.make(name)
    some = poses.perturb(np.eye(4), rng.normal(size=(12, 6)) * ([2.0] * 3 + [0.02] * 3), model.centroid)
    alike = some @ model.symmetry_poses(5)[rng.integers(len(model.symmetry_poses(5)), size=12)]
    near = poses.perturb(alike, rng.normal(size=(12, 6)) * ([0.05] * 3 + [0.002] * 3), model.centroid)
    candidates = np.concatenate([some, alike, near])[rng.permutation(36)]
    for apart in (0.001, 0.2 * model.radius, model.radius):
        expected, of = leaders_by_arrays(model, candidates, apart)
        chosen, group = leaders(model, candidates, apart)
        assert np.array_equal(chosen, expected)
        assert np.array_equal(group, of)


@pytest.mark.parametrize("count", [3, 40, 500])
def test_rows_are_thinned_as_plain_arrays_are(rng, count):
    rows = rng.normal(size=(150, evidence.COLUMNS))
    rows[:, evidence.GATE_ABOVE] = rng.choice([0.0, 2.0], 150)
    full = evidence.Evidence(rows, rng.choice([evidence.VISION, evidence.TOUCH], 150).astype(np.uint8))
    silent, felt = rows[:, evidence.GATE_ABOVE] == 0.0, full.sense == evidence.TOUCH
    most = (felt & ~silent, 150), (~felt & ~silent, count), (~felt & silent, count // 2), (felt & silent, count // 2)
    chosen, factors = [], []
    for group, limit in ((np.flatnonzero(of), limit) for of, limit in most):
        kept = max(1, min(limit, len(group)))
        chosen.append(group[(np.arange(kept) * len(group)) // kept])
        factors.append(np.full(kept, len(group) / kept))
    expected = full if count == 500 else full.take(np.concatenate(chosen)).reweighted(np.concatenate(factors))
    few = thin(full, count)
    np.testing.assert_array_equal(few.rows, expected.rows)
    np.testing.assert_array_equal(few.sense, expected.sense)


def test_rows_are_taken_once_in_their_order(rng):
    keys = rng.integers(-3, 3, size=(400, 4))
    _, first = np.unique(keys, axis=0, return_index=True)
    assert np.array_equal(first_of_each(keys), np.sort(first))


@pytest.mark.parametrize("count", [0, 1, 7, 250, 399, 400, 1000])
def test_the_least_are_those_that_a_stable_sort_has_first(count, rng):
    values = rng.integers(0, 60, size=400) / 7.0
    values[[3, 50, 51]] = np.nan
    np.testing.assert_array_equal(least_of(values, count), np.argsort(values, kind="stable")[:count])
    assert len(least_of(np.zeros(0), count)) == 0


@pytest.mark.parametrize("keep", [1, 20, 60, 500])
@pytest.mark.parametrize("share", [0.1, 1.0, 10.0])
def test_the_best_that_differ_are_found_without_asking_what_all_cost(drill, rng, keep, share):
    """By chance, and where what is known tells nothing: then all are asked."""
    centre = poses.make_pose(None, [0.0, 0.0, 0.6])

    def differ(some, at):
        return first_of_cells(drill, some, np.argsort(at, kind="stable"), 0.12, 0.25)

    candidates = poses.perturb(centre, rng.normal(size=(300, 6)) * ([0.6] * 3 + [0.02] * 3), drill.centroid)
    for known in (rng.uniform(0.0, 1.0, 300), np.zeros(300), np.round(rng.uniform(0.0, 1.0, 300), 1)):
        costly, asked = dict(zip(map(bytes, candidates), share * rng.uniform(0.0, 1.0, 300))), []

        def ask(some, costly=costly, asked=asked):
            asked.extend(some)
            return np.array([costly[bytes(pose)] for pose in some])

        found, at = best_that_differ(candidates, known, ask, differ, keep)
        assert len(asked) <= len(candidates)
        if share < 1.0 and keep < 60 and known.max() > 0.0:
            assert len(asked) < 0.5 * len(candidates)
        every = np.array([costly[bytes(pose)] for pose in candidates])
        np.testing.assert_array_equal(found, differ(candidates, known + every)[:keep])
        np.testing.assert_array_equal(at, every[found])


@pytest.mark.parametrize("ranked", [True, False])
def test_a_pass_without_steps_keeps_the_best_that_differ(drill, rng, ranked):
    points, _ = drill.sample_surface(40, seed=0)
    rows = evidence.make(points, 1e-3, VISION)
    starts = poses.perturb(np.eye(4), rng.normal(size=(200, 6)) * ([0.5] * 3 + [0.01] * 3), drill.centroid)
    starts[150:] = starts[:50]  # those that are the same count once

    def rank(candidates, blur):
        return 1e3 * blur * np.abs(candidates[:, 0, 3]) if ranked else np.zeros(len(candidates))

    found = search(drill, rows, starts, (SearchStage(0.01, 0.0, 40, 0, 30),), rank=rank if ranked else None)
    at = costs(drill, rows, starts, settings=AlignSettings(blur=0.01))
    order = first_of_cells(drill, starts, np.argsort(at + rank(starts, 0.01), kind="stable"), 1e-3, 1e-2)[:30]
    np.testing.assert_array_equal(found.poses, starts[order])
    np.testing.assert_array_equal(found.costs, at[order])
    assert not found.hessians.any()
