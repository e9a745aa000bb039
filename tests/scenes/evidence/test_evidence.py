"""The table of evidence: columns, selections, changes of frame, refusals."""

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.evidence import table as evidence
from scenes.evidence.table import NO_GATE, TOUCH, VISION
from scenes.geometry import poses
from scenes.recordings.frames import Contacts


def test_columns_hold_what_was_given(rng):
    points, normals = rng.normal(size=(4, 3)), poses.random_unit_vectors(4, rng)
    normals[2] = np.nan
    table = evidence.make(
        points, [1e-3, 2e-3, 3e-3, 4e-3], TOUCH, normals=normals, sigma_normal=0.1, weight=0.5, gate_above=3.0
    )
    assert np.array_equal(table.points, points)
    assert np.array_equal(table.rows[:, evidence.SIGMA], [1e-3, 2e-3, 3e-3, 4e-3])
    assert np.array_equal(table.rows[:, evidence.SIGMA_NORMAL], [0.1, 0.1, 0.0, 0.1])
    assert np.array_equal(table.rows[2, evidence.NORMAL], np.zeros(3))
    assert np.array_equal(table.rows[0, evidence.NORMAL], normals[0])
    assert (table.rows[:, evidence.GATE_ABOVE] == 3.0).all()
    assert (table.rows[:, evidence.GATE_BELOW] == NO_GATE).all()
    assert (table.rows[:, evidence.FACING] == 0).all()
    assert np.isfinite(table.rows).all()
    assert (table.sense == TOUCH).all()


def test_pixels_carry_their_viewing_ray(rng):
    rays = poses.random_unit_vectors(3, rng)
    table = evidence.make(rng.normal(size=(3, 3)), 1e-3, VISION, rays=rays)
    assert np.array_equal(table.rows[:, evidence.NORMAL], rays)
    assert (table.rows[:, evidence.FACING] == 1).all()
    assert (table.rows[:, evidence.SIGMA_NORMAL] == 0).all()


def test_outside_rows_are_silent_outside(rng):
    table = evidence.outside(rng.normal(size=(3, 3)), 2e-3, TOUCH, radius=[0.0, 0.01, 0.02], gate=5.0)
    assert (table.rows[:, evidence.GATE_ABOVE] == 0).all()
    assert (table.rows[:, evidence.GATE_BELOW] == 5.0).all()
    assert np.array_equal(table.rows[:, evidence.OFFSET], [0.0, 0.01, 0.02])


def test_contacts_with_and_without_normals(rng):
    normals = np.vstack([poses.random_unit_vectors(2, rng), [[np.nan] * 3]])
    contacts = Contacts(rng.normal(size=(3, 3)), normals, [1e-3, 2e-3, 3e-3], 0.2)
    table = evidence.from_contacts(contacts, gate=4.0)
    assert np.array_equal(table.rows[:, evidence.SIGMA_NORMAL] > 0, [True, True, False])
    assert np.array_equal(table.rows[:, evidence.SIGMA], contacts.sigma_point)
    without = evidence.from_contacts(contacts, use_normals=False)
    assert (without.rows[:, evidence.SIGMA_NORMAL] == 0).all()
    assert len(evidence.from_contacts(Contacts(np.zeros((0, 3))))) == 0


def test_selections_are_copies(rng):
    table = evidence.stack(
        evidence.make(rng.normal(size=(3, 3)), 1e-3, VISION), evidence.make(rng.normal(size=(2, 3)), 1e-3, TOUCH)
    )
    assert len(table) == 5
    assert len(table.of(VISION)) == 3
    assert np.array_equal(table.take([4, 0]).points, table.points[[4, 0]])
    heavier = table.reweighted(2.0)
    wider = table.with_sigma(5e-3, TOUCH)
    part = table.take(np.ones(5, dtype=bool))
    part.rows[:] = 7.0
    assert (table.rows[:, evidence.WEIGHT] == 1.0).all()
    assert (heavier.rows[:, evidence.WEIGHT] == 2.0).all()
    assert np.array_equal(wider.rows[:, evidence.SIGMA], [1e-3] * 3 + [5e-3] * 2)
    assert len(evidence.stack(evidence.empty(), table)) == 5
    assert evidence.empty().rows.shape == (0, evidence.COLUMNS)


def test_moving_turns_points_and_normals_and_back(rng):
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    table = evidence.make(
        rng.normal(size=(6, 3)), 1e-3, TOUCH, normals=poses.random_unit_vectors(6, rng), sigma_normal=0.1
    )
    moved = table.moved(pose)
    assert np.allclose(moved.points, poses.apply(pose, table.points))
    assert np.allclose(moved.rows[:, evidence.NORMAL], table.rows[:, evidence.NORMAL] @ pose[:3, :3].T)
    assert np.allclose(moved.moved(poses.inverse(pose)).rows, table.rows, atol=1e-14)


def test_refusals(rng):
    points = rng.normal(size=(3, 3))
    spoilt = points.copy()
    spoilt[1, 0] = np.nan
    with pytest.raises(InputError, match="finite points, got 1 bad rows"):
        evidence.make(spoilt, 1e-3, TOUCH)
    for sigma in (0.0, -1e-3, np.nan):
        with pytest.raises(InputError, match="sigma above 0"):
            evidence.make(points, sigma, TOUCH)
