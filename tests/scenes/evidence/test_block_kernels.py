"""Rows in blocks against plain NumPy and against one row at a time."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from scenes.evidence import block_kernels as blocks
from scenes.evidence import kernels
from scenes.evidence import row_kernels as rows
from scenes.evidence import table as tables
from scenes.evidence.align import lattice_of
from scenes.geometry import lattice, poses
from scenes.synthesis import library


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def unit(rng, count):
    rays = rng.normal(size=(count, 3))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def seen(rng, count, silent=False):
    """Rows of pixels around a mug, some far outside its lattice; or of empty space."""
    points, rays = rng.normal(0, 0.06, (count, 3)), unit(rng, count)
    if silent:
        return tables.outside(points, 2e-3, tables.VISION, rng.uniform(0, 0.01, count), gate=4.0).rows
    gates = rng.choice([2.0, 3.0, tables.NO_GATE], count)
    return tables.make(
        points,
        rng.uniform(1e-3, 5e-3, count),
        tables.VISION,
        weight=rng.uniform(0, 1, count),
        gate_above=gates,
        rays=rays,
    ).rows


def laid(table, silent=False):
    prepared = rows.prepare(table, 0.0, 0.0)
    out = blocks.blocks_of(len(table))
    return out, blocks.lay_blocks(prepared, silent, out)


def room():
    return np.zeros((2, blocks.ROOM)), np.zeros((2, blocks.LENGTH), dtype=np.int32)


def at(pose, model):
    return np.ascontiguousarray(pose[:3, :3]), pose[:3, :3] @ model.centroid + pose[:3, 3]


def test_the_exponential_and_the_logarithm_are_numpys():
    t = np.linspace(0.0, rows.NOTHING, 5001)
    assert [rows.decay(x) for x in t] == pytest.approx(np.exp(-t), rel=1e-13)
    e = np.linspace(0.0, 1.0, 5001)
    assert [rows.log_above_one(x) for x in e] == pytest.approx(np.log1p(e), rel=1e-14, abs=1e-300)


@pytest.mark.parametrize("count", [1, 7, 8, 63, 64, 65, 200])
@pytest.mark.parametrize("huber", [0.0, 1.5])
def test_costs_are_those_of_one_row_at_a_time(mug, rng, count, huber):
    table = seen(rng, count)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(0, 0.02, 3))
    block, found = laid(table)
    assert found == count
    sums = np.zeros(blocks.SUMS)
    got = blocks.block_terms(lattice_of(mug), block, found, huber, *at(pose, mug), True, *room(), sums)
    plain = blocks.block_terms(lattice_of(mug), block, found, huber, *at(pose, mug), False, *room(), np.zeros(1))
    assert plain == got
    total, gradient, hessian = 0.0, np.zeros(6), np.zeros((6, 6))
    for row in table:
        local = poses.apply(poses.inverse(pose), row[None, :3])[0]
        d, *g = lattice.seen_distance_at(*lattice_of(mug)[:4], *local, *(row[3:6] @ pose[:3, :3]))
        gate = row[9] if d > 0 else row[10]
        loss, belongs = rows.robust((d / row[6]) ** 2, gate, rows.loss_floor(gate), huber)
        along, away = pose[:3, :3] @ g / row[6], row[:3] - at(pose, mug)[1]
        jac = np.concatenate([np.cross(along, away), -along])
        total += 0.5 * row[8] * loss
        gradient += row[8] * belongs * d / row[6] * jac
        hessian += row[8] * belongs * np.outer(jac, jac)
    assert got == pytest.approx(total, rel=1e-11)
    ours, matrix = np.zeros(6), np.zeros((6, 6))
    blocks.add_sums(sums, matrix, ours)
    assert ours == pytest.approx(gradient, rel=1e-9, abs=1e-9 * np.abs(gradient).max())
    assert matrix == pytest.approx(hessian, rel=1e-9, abs=1e-9 * np.abs(hessian).max())


@pytest.mark.parametrize("reach", [0.0, 0.02])
def test_empty_space_near_a_pose_is_what_numpy_finds_near(mug, rng, reach):
    table, field = seen(rng, 150, silent=True), mug.field
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(0, 0.02, 3))
    block, count = laid(table, silent=True)
    near = blocks.blocks_of(count)
    found, lever = blocks.near_blocks(lattice_of(mug), block, count, *at(pose, mug), reach, *room(), near)
    local = poses.apply(poses.inverse(pose), table[:, :3])
    grid = [o + field.spacing * np.arange(n) for o, n in zip(field.origin, field.values.shape)]
    inside = np.clip(local, field.origin, [axis[-1] for axis in grid])
    distance = RegularGridInterpolator(grid, field.values.astype(float))(inside)
    distance += np.linalg.norm(local - inside, axis=1)
    is_near = distance <= reach + table[:, 11]
    assert 0 < found == is_near.sum() < count
    listed = [near[k // blocks.LENGTH, blocks.PX + k % blocks.LENGTH] for k in range(found)]
    assert listed == table[is_near, 0].tolist()
    assert lever == pytest.approx(np.linalg.norm(table[~is_near, :3] - at(pose, mug)[1], axis=1).max())


def test_rows_are_sorted_by_what_they_say(rng):
    table = np.concatenate([seen(rng, 70), seen(rng, 9, silent=True), seen(rng, 3)])
    (_, speaking), (silent, quiet) = laid(table), laid(table, silent=True)
    assert (speaking, quiet) == (73, 9)
    # whole lanes: the last one is filled up with what weighs nothing
    weights = silent[0, blocks.WEIGHTS : blocks.WEIGHTS + 16]
    assert (weights[:9] > 0).all()
    assert not weights[9:].any()


@pytest.mark.parametrize("huber", [0.0, 1.5])
@pytest.mark.parametrize("count", [1, 64, 500])
def test_silent_rows_are_weighed_where_they_are_inside_alone(mug, rng, count, huber):
    block, found = laid(seen(rng, count, silent=True), silent=True)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(0, 0.02, 3))
    whole, some, held = np.zeros(blocks.SUMS), np.zeros(blocks.SUMS), np.zeros(blocks.BLOCK)
    told = lattice_of(mug), block, found, huber, *at(pose, mug)
    every = blocks.block_terms(*told, True, *room(), whole)
    inside = kernels.silent_terms(*told, True, *room(), held, some)
    alone = kernels.silent_terms(*told, False, *room(), held, np.zeros(1))
    assert inside == alone == pytest.approx(every, rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(some, whole, rtol=1e-9, atol=1e-9 * max(np.abs(whole).max(), 1.0))
