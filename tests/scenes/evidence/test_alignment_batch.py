"""Batches of poses: the same bits for any number of threads and order, refusals, degenerate evidence, invariance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.evidence import table as evidence
from scenes.evidence.align import AlignSettings, Prior, align, align_each, costs, terms
from scenes.evidence.table import TOUCH, VISION, Evidence
from scenes.geometry import poses
from scenes.synthesis import library

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def scene():
    """A drill at a pose, rows on its surface, and starts around it."""
    model = library.make("drill")
    rng = np.random.default_rng(3)
    truth = poses.make_poses(poses.random_rotations(1, rng), [[0.1, -0.2, 0.6]])[0]
    points, normals = model.sample_surface(80, seed=2)
    points, normals = poses.apply(truth, points), normals @ truth[:3, :3].T
    table = evidence.stack(
        evidence.make(points[:60], 2e-3, VISION, gate_above=2.5),
        evidence.make(points[60:], 1e-3, TOUCH, normals=normals[60:], sigma_normal=0.1),
    )
    delta = rng.normal(size=(60, 6)) * ([0.2] * 3 + [0.015] * 3)
    return model, truth, table, poses.perturb(truth, delta, model.centroid)


def equal(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("poses", "costs", "hessians", "iterations")
    )


def test_bits_do_not_depend_on_threads(scene, monkeypatch):
    model, truth, table, starts = scene
    prior = Prior.isotropic(truth, 0.3, 0.03)
    results = []
    for threads in ("1", "2", "4"):
        monkeypatch.setenv("PALPATE_THREADS", threads)
        results.append((align(model, table, starts, prior), costs(model, table, starts, prior)))
    for result, cost in results[1:]:
        assert equal(results[0][0], result)
        assert np.array_equal(results[0][1], cost)


def test_bits_do_not_depend_on_the_order_or_company(scene):
    model, _, table, starts = scene
    order = np.random.default_rng(0).permutation(len(starts))
    together = align(model, table, starts)
    assert equal(together.take(order), align(model, table, starts[order]))
    alone = align(model, table, starts[7:8])
    assert np.array_equal(alone.poses[0], together.poses[7])
    assert alone.costs[0] == together.costs[7]


def test_the_starts_are_not_written_to(scene):
    model, _, table, starts = scene
    kept, rows = starts.copy(), table.rows.copy()
    align(model, table, starts)
    assert np.array_equal(starts, kept)
    assert np.array_equal(table.rows, rows)


def test_most_starts_reach_the_truth(scene):
    model, truth, table, starts = scene
    result = align(model, table, starts)
    delta = poses.difference(result.poses, truth, model.centroid)
    near = (np.linalg.norm(delta[:, :3], axis=1) < 0.01) & (np.linalg.norm(delta[:, 3:], axis=1) < 1e-3)
    assert near.mean() > 0.7
    assert (result.costs[near] < result.costs[~near].min(initial=np.inf)).all()
    rotation = result.poses[:, :3, :3]
    assert np.allclose(np.swapaxes(rotation, 1, 2) @ rotation, np.eye(3), atol=1e-13)
    assert ((result.iterations >= 1) & (result.iterations <= AlignSettings().iterations)).all()


@settings(max_examples=15)
@given(seed=seeds)
def test_moving_the_world_moves_the_answer(scene, seed):
    model, truth, table, starts = scene
    rng = np.random.default_rng(seed)
    world = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)) * 0.3)[0]
    prior, other = (Prior.isotropic(p, 0.3, 0.03) for p in (truth, world @ truth))
    there = costs(model, table.moved(world), world @ starts, other)
    assert np.allclose(there, costs(model, table, starts, prior), rtol=1e-9)
    here = terms(model, table, starts[0], prior)
    moved = terms(model, table.moved(world), world @ starts[0], other)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = world[:3, :3]
    assert np.allclose(turn @ here[1], moved[1], rtol=1e-7, atol=1e-7 * np.abs(here[1]).max())
    assert np.allclose(turn @ here[2] @ turn.T, moved[2], rtol=1e-7, atol=1e-7 * np.abs(here[2]).max())


@settings(max_examples=10)
@given(seed=seeds)
def test_renumbering_rows_changes_nothing(scene, seed):
    model, _, table, starts = scene
    shuffled = table.take(np.random.default_rng(seed).permutation(len(table)))
    assert np.allclose(costs(model, shuffled, starts), costs(model, table, starts), rtol=1e-11)


def test_twice_the_rows_or_twice_the_weight(scene):
    model, _, table, starts = scene
    twice = evidence.stack(table, table)
    assert np.allclose(costs(model, twice, starts), 2 * costs(model, table, starts), rtol=1e-11)
    assert np.allclose(costs(model, table.reweighted(2.0), starts), 2 * costs(model, table, starts), rtol=1e-11)


# ---- degenerate evidence ----


def all_finite(result):
    return all(np.isfinite(getattr(result, name)).all() for name in ("poses", "costs", "hessians"))


def test_no_rows_leave_the_starts_where_they_are(scene):
    model, _, _, starts = scene
    result = align(model, evidence.empty(), starts)
    assert np.allclose(result.poses, starts, atol=1e-12)
    assert (result.costs == 0).all()
    assert (result.hessians == 0).all()


def test_no_rows_and_a_prior_give_the_prior(scene):
    model, truth, _, starts = scene
    result = align(model, evidence.empty(), starts, Prior.isotropic(truth, 0.1, 0.01))
    assert np.allclose(result.poses, truth, atol=1e-6)
    assert np.allclose(result.hessians[0][3:, 3:], np.eye(3) * 1e4)


def test_no_starts(scene):
    model, _, table, _ = scene
    result = align(model, table, np.zeros((0, 4, 4)))
    assert result.poses.shape == (0, 4, 4)
    assert costs(model, table, np.zeros((0, 4, 4))).shape == (0,)


def test_points_of_one_plane_leave_its_motions_open():
    model = library.make("box")
    points, normals = model.sample_surface(4000, seed=0)
    half = 0.5 * np.ptp(model.vertices, axis=0)
    middle = np.abs(points - 0.5 * (model.vertices.min(axis=0) + model.vertices.max(axis=0))) < 0.7 * half
    top = (normals[:, 2] > 0.9) & middle[:, :2].all(axis=1)
    table = evidence.make(points[top][:150], 1e-3, VISION)
    start = poses.perturb(np.eye(4), [0.02, 0.01, 0.0, 0.0, 0.0, 0.002], model.centroid)
    result = align(model, table, start[None])
    assert all_finite(result)
    values = np.linalg.eigvalsh(result.hessians[0] / result.hessians[0].max())
    assert (values[:3] < 1e-3).all()  # slides and the turn about the normal
    moved = poses.difference(result.poses[0], start, model.centroid)
    # it slides a little while it is put flat, but does not run away along what is open
    assert np.abs(moved[[3, 4]]).max() < 0.5 * model.radius
    assert np.abs(moved[2]) < 0.1
    assert np.abs(poses.difference(result.poses[0], np.eye(4), model.centroid)[[0, 1, 5]]).max() < 2e-4


def test_a_sphere_has_no_rotation_to_find():
    model = library.make("sphere")
    points, normals = model.sample_surface(60, seed=0)
    table = evidence.make(points, 1e-3, TOUCH, normals=normals, sigma_normal=0.1)
    rng = np.random.default_rng(0)
    starts = poses.perturb(np.eye(4), rng.normal(size=(20, 6)) * ([1.0] * 3 + [0.01] * 3), model.centroid)
    result = align(model, table, starts)
    assert all_finite(result)
    middles = poses.apply(result.poses, model.centroid[None])[:, 0]
    assert np.abs(middles - model.centroid).max() < 3e-4


@pytest.mark.parametrize("kind", ["one point", "one point repeated", "a line", "the centre of the object", "far away"])
def test_hardly_any_evidence_gives_finite_answers(kind):
    model = library.make("mug")
    points = {
        "one point": np.array([[0.05, 0.0, 0.0]]),
        "one point repeated": np.tile([[0.05, 0.0, 0.0]], (30, 1)),
        "a line": np.linspace([-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], 30),
        "the centre of the object": model.centroid[None],
        "far away": np.array([[1e4, -1e4, 1e4], [1e6, 0, 0]]),
    }[kind]
    normals = np.tile([[0.0, 0.0, 1.0]], (len(points), 1))
    for table in (
        evidence.make(points, 1e-3, TOUCH),
        evidence.make(points, 1e-3, TOUCH, normals=normals, sigma_normal=0.1),
        evidence.make(points, 1e-3, VISION, gate_above=2.5, gate_below=5.0, rays=normals),
        evidence.outside(points, 1e-3, TOUCH, radius=0.01),
    ):
        result = align(model, table, np.eye(4)[None])
        assert all_finite(result)


def test_outside_rows_push_the_object_away():
    model = library.make("box")
    rng = np.random.default_rng(0)
    inside = model.centroid + rng.uniform(-0.3, 0.3, size=(20, 3)) * np.ptp(model.vertices, axis=0) + [0, 0, 0.03]
    table = evidence.outside(inside, 1e-3, TOUCH)
    result = align(model, table, np.eye(4)[None], settings=AlignSettings(iterations=80))
    assert result.costs[0] < 0.05 * costs(model, table, np.eye(4)[None])[0]
    outside = evidence.outside([[0.5, 0.0, 0.0], [0.0, -0.5, 0.0]], 1e-3, TOUCH)
    assert costs(model, outside, np.eye(4)[None])[0] == 0.0


@pytest.mark.parametrize("far", [0.05, 0.3])
def test_empty_space_left_out_while_it_is_far_is_not_forgotten(scene, far):
    """Wherever a descent ends, all rows have been heard: those that began far from the surface, too."""
    model, truth, table, _ = scene
    rng = np.random.default_rng(1)
    empty = poses.apply(truth, model.centroid + rng.uniform(-0.15, 0.15, size=(400, 3)))
    rows = evidence.stack(evidence.outside(empty, 2e-3, VISION, gate=4.0), table)
    delta = rng.normal(size=(40, 6)) * np.repeat([2.0 * far, far], 3)
    found = align(model, rows, poses.perturb(truth, delta, model.centroid))
    np.testing.assert_allclose(found.costs, costs(model, rows, found.poses), rtol=1e-7)
    for pose, hessian in zip(found.poses[:8], found.hessians):
        np.testing.assert_allclose(hessian, terms(model, rows, pose)[2], rtol=1e-5, atol=1e-6 * np.abs(hessian).max())


def test_a_contact_deep_inside_still_finds_a_way_out():
    model = library.make("box")
    table = evidence.make(model.centroid[None] + [[0.003, 0.002, 0.001]], 1e-3, TOUCH)
    result = align(model, table, np.eye(4)[None], settings=AlignSettings(iterations=60))
    assert result.costs[0] < 1e-3 * costs(model, table, np.eye(4)[None])[0]


# ---- the door ----


def test_what_is_not_finite_is_refused(scene):
    model, truth, table, starts = scene
    bad_pose = truth.copy()
    bad_pose[0, 3] = np.nan
    with pytest.raises(InputError, match="finite poses"):
        align(model, table, bad_pose[None])
    with pytest.raises(InputError, match="finite poses"):
        costs(model, table, bad_pose[None])
    for column in range(evidence.COLUMNS):
        rows = table.rows.copy()
        rows[3, column] = np.nan
        with pytest.raises(InputError, match="finite evidence"):
            align(model, Evidence(rows, table.sense), starts)
    for prior in (Prior(bad_pose, np.eye(6)), Prior(truth, np.full((6, 6), np.inf)), Prior(truth, np.eye(3))):
        with pytest.raises(InputError, match="prior"):
            align(model, table, starts, prior)
    with pytest.raises(InputError, match="columns, got shape"):
        align(model, Evidence(table.rows[:, :11], table.sense), starts)


@pytest.mark.parametrize("sigmas", [(0.0, 0.01), (0.1, -1.0), (np.nan, 0.01)])
def test_a_prior_needs_widths(sigmas):
    with pytest.raises(InputError, match="sigmas above 0"):
        Prior.isotropic(np.eye(4), *sigmas)


@pytest.mark.parametrize("threads", ["1", "2"])
def test_poses_with_evidence_of_their_own_move_as_each_alone(scene, monkeypatch, threads):
    model, truth, table, starts = scene
    monkeypatch.setenv("PALPATE_THREADS", threads)
    pixels, contacts = table.of(VISION), table.of(TOUCH)
    own = [pixels.take(np.arange(k, len(pixels), 2)) if k < 2 else evidence.empty() for k in range(3)]
    prior, how = Prior.isotropic(truth, 0.3, 0.03), AlignSettings(iterations=12)
    found = align_each(model, own, contacts, starts[:3], prior, how)
    for k, mine in enumerate(own):
        alone = align(model, evidence.stack(mine, contacts), starts[k : k + 1], prior, how)
        assert equal(alone, found.take(np.array([k])))
