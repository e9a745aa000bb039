"""Hypotheses from pairs of contacts: exact pairs come back exactly, motion and mirror images are told apart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.evidence import point_pairs
from scenes.evidence.point_pairs import (
    PairSettings,
    PairTable,
    built_pair_table,
    cell_keys,
    cells_around,
    draw_from_cells,
    match_pairs,
    pair_table,
)
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library


@pytest.fixture(scope="module")
def table():
    return PairTable(library.make("drill"), PairSettings(points=120))


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_matching_a_pair_with_itself_gives_the_motion(seed):
    rng = np.random.default_rng(seed)
    points, normals = rng.normal(size=(2, 3)), poses.random_unit_vectors(2, rng)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))
    moved = Contacts(points, normals).moved(truth)
    rotations, origins = np.zeros((1, 3, 3)), np.zeros((1, 3))
    zero, one = np.array([0]), np.array([1])
    match_pairs(points, normals, zero, one, moved.points, moved.normals, zero, one, rotations, origins)
    assert np.allclose(rotations[0], truth[:3, :3], atol=1e-9)
    assert np.allclose(origins[0], truth[:3, 3], atol=1e-9)


def test_opposite_directions_are_no_special_case():
    points = np.array([[0.0, 0, 0], [0.0, 0, 1]])
    normals = np.array([[1.0, 0, 0], [1.0, 0, 0]])
    rotations, origins = np.zeros((1, 3, 3)), np.zeros((1, 3))
    zero, one = np.array([0]), np.array([1])
    match_pairs(points, normals, zero, one, -points, normals, zero, one, rotations, origins)
    assert np.allclose(rotations[0] @ [0, 0, 1], [0, 0, -1])
    assert np.allclose(rotations[0] @ [1, 0, 0], [1, 0, 0])


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_invariants_do_not_move_but_mirror(table, seed):
    rng = np.random.default_rng(seed)
    p1, p2 = rng.normal(size=(2, 5, 3))
    n1, n2 = poses.random_unit_vectors(5, rng), poses.random_unit_vectors(5, rng)
    r = poses.random_rotations(1, rng)[0]
    before = table.invariants(p1, n1, p2, n2)
    assert np.allclose(before, table.invariants(p1 @ r.T + 1.0, n1 @ r.T, p2 @ r.T + 1.0, n2 @ r.T), atol=1e-9)
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored = table.invariants(p1 * flip, n1 * flip, p2 * flip, n2 * flip)
    assert np.allclose(mirrored[:, :4], before[:, :4])
    assert np.allclose(mirrored[:, 4], -before[:, 4])


def test_the_truth_is_among_the_hypotheses(table, rng):
    pick = [3, 40, 90]
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.1, 0.2, 0.3])
    contacts = Contacts(table.points[pick], table.normals[pick]).moved(truth)
    rotations, origins = table.hypotheses(contacts, 300)
    off = np.linalg.norm(rotations - truth[:3, :3], axis=(1, 2)) + np.linalg.norm(origins - truth[:3, 3], axis=1)
    assert off.min() < 1e-9


def test_without_normals_or_room_there_are_none(table):
    assert len(table.hypotheses(Contacts(np.eye(3)), 100)[0]) == 0
    together = Contacts(np.zeros((3, 3)), np.eye(3))
    assert len(table.hypotheses(together, 100)[0]) == 0


def test_the_table_is_kept_as_long_as_the_object():
    model = library.make("l_block")
    assert pair_table(model) is pair_table(model) is built_pair_table(model)


def test_a_hundred_thousand_contacts_are_not_paired_all():
    model = library.make("l_block")
    table = PairTable(model)
    many = Contacts(*model.sample_surface(100_000, seed=0))
    rotations, origins = table.hypotheses(many, 200)  # 5e9 pairs would fill the memory
    assert 100 < len(rotations) == len(origins) <= 200
    assert np.isfinite(rotations).all()


def test_cells_are_numbered_as_plain_arrays_number_them(table, rng):
    some = rng.uniform(-8.0, 50.0, size=(200, 5))
    some[:20, 1:] = rng.uniform(-4.0, 4.0, size=(20, 4))
    keys = np.zeros(len(some), np.int64)
    cell_keys(some, keys)
    along = np.clip(np.trunc(some[:, 0]), 0, 39)
    slopes = np.clip(np.floor(some[:, 1:]) + 6, 0, 11)
    expected = along * 12**4 + slopes @ (12.0 ** np.arange(3, -1, -1))
    np.testing.assert_array_equal(keys, expected.astype(int))
    order, begin = table.cells
    assert begin[-1] == len(order) == len(table.first)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(order)))


def test_draws_of_a_pair_are_pairs_that_look_alike(table, rng):
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], [0.1, 0.2, 0.3])
    moved = Contacts(table.points, table.normals).moved(truth)
    first, second = table.first[:400:20], table.second[:400:20]
    rotations, origins = table.drawn(moved.points, moved.normals, first, second, 50, np.random.default_rng(3))
    again = table.drawn(moved.points, moved.normals, first, second, 50, np.random.default_rng(3))
    np.testing.assert_array_equal(rotations, again[0])
    assert 0 < len(rotations) == len(origins) <= 50 * len(first)
    # they lay the object near where it is, some of them on it
    off = np.linalg.norm(rotations - truth[:3, :3], axis=(1, 2)) + np.linalg.norm(origins - truth[:3, 3], axis=1)
    assert off.min() < 0.1
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-9)


def test_pairs_that_look_like_none_of_the_object_give_none(table):
    points, normals = np.array([[0.0, 0, 0], [100.0, 0, 0]]), np.array([[0.0, 0, 1], [0.0, 0, 1]])
    rotations, origins = table.drawn(points, normals, np.array([0]), np.array([1]), 5, np.random.default_rng(0))
    assert rotations.shape == (0, 3, 3)
    assert origins.shape == (0, 3)


def test_draws_are_what_plain_arrays_draw(table, rng):
    some = rng.integers(len(table.first), size=30)
    pairs = (part[of[some]] for of in (table.first, table.second) for part in (table.points, table.normals))
    invariants, drawn = np.vstack([table.invariants(*pairs), rng.uniform(-3.0, 30.0, (10, 5))]), rng.random((40 * 7, 5))
    drawn = 2.0 * drawn - 1.0
    keys, expected = np.zeros((2, len(drawn)), np.int64)
    cells_around(invariants, 0.5, drawn, 0.8, keys)
    cell_keys((np.repeat(invariants, 7, axis=0) + 0.5 * drawn) / 0.8, expected)
    np.testing.assert_array_equal(keys, expected)
    (order, begin), share, out = table.cells, rng.random(len(keys)), np.zeros((2, len(keys)), np.int64)
    met = draw_from_cells(table.cells, keys, share, 7, out)
    held = begin[keys + 1] - begin[keys]
    there = np.flatnonzero(held)
    assert 0 < met == len(there) < len(keys)
    np.testing.assert_array_equal(out[0, :met], there // 7)
    np.testing.assert_array_equal(out[1, :met], order[begin[keys[there]] + (share[there] * held[there]).astype(int)])


def test_draws_are_the_same_on_any_number_of_threads(table, monkeypatch):
    monkeypatch.setattr(point_pairs, "ENOUGH", 10)
    first, second = table.first[::50], table.second[::50]
    drawn = []
    for threads in ("1", "3"):
        monkeypatch.setenv("PALPATE_THREADS", threads)
        drawn.append(table.drawn(table.points, table.normals, first, second, 5, np.random.default_rng(1)))
    np.testing.assert_array_equal(drawn[0][0], drawn[1][0])
    np.testing.assert_array_equal(drawn[0][1], drawn[1][1])
