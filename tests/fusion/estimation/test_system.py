"""The joint solution's system: what is laid out where it starts, and what is looked at beside."""

from dataclasses import replace

import numpy as np
import pytest
from joint_twin import made_problem

from fusion.estimation.solve.joint import settle
from fusion.estimation.solve.kernels import number_blocks, surface_met
from fusion.estimation.solve.settings import Level
from fusion.estimation.solve.system import FIXED
from scenes.evidence.table import NORMAL, POINT


@pytest.mark.parametrize("count", [1, 7, 400])
def test_blocks_of_the_image_are_numbered_without_gaps(rng, count):
    uv, index = rng.uniform(0.0, 300.0, (2 * count, 2)), rng.permutation(2 * count)[:count]
    some, block = uv[index], np.zeros(count, dtype=np.int64)
    side = max(5.0, float(np.sqrt(np.prod(np.ptp(some, axis=0) + 1.0) / 16.0)))
    squares = np.floor((some - some.min(axis=0)) / side).astype(np.int64)
    found = number_blocks(uv, index, 16.0, 5.0, block)
    np.testing.assert_array_equal(block, np.unique(squares, axis=0, return_inverse=True)[1].ravel())
    assert found == block.max() + 1


def test_which_way_the_surface_faces_pixels_is_as_by_arrays(drill, rng):
    problem, pose = made_problem(drill, rng, prior=False, noise=0.0002)
    rows, rotation = problem.seen.rows, pose[:3, :3].copy()
    middle = rotation @ drill.centroid + pose[:3, 3]
    is_pixel, normals, cosines = rng.random(len(rows)) < 0.8, np.zeros((len(rows), 3)), np.zeros(len(rows))
    surface_met(problem.lattice, rows, is_pixel, rotation, middle, normals, cosines)
    local, rays = (rows[:, POINT] - middle) @ rotation + drill.centroid, rows[:, NORMAL] @ rotation
    _, g = drill.field.seen_distance_and_gradient(local, rays, np.ones(len(rows), dtype=bool))
    met = g / np.linalg.norm(g, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, np.where(is_pixel[:, None], met, 0.0), atol=1e-12)
    np.testing.assert_allclose(cosines, np.where(is_pixel, -np.sum(met * rays, axis=1), 0.0), atol=1e-12)


def test_what_a_smooth_bias_may_be_is_told_without_going_there(drill, rng):
    """As the terms without a bias have it; what was last worked out stays so."""
    problem, pose = made_problem(drill, rng, prior=False, noise=0.0002)
    rows = problem.seen.rows.copy()
    rows[:, :3] *= 1.0 + 0.006 * np.sin(rows[:, :1] / 0.02)  # millimetres along the rays, up and down across the image
    problem = replace(problem, seen=replace(problem.seen, rows=rows))
    settled = settle(problem, pose, Level())
    system = settled.system
    system.terms(settled.pose, settled.unknown)
    before, misfit = system.mesh_variance(), system.misfit()
    either = system.mesh_or_bias(settled.pose, settled.unknown)
    assert (system.mesh_variance(), system.misfit()) == (before, misfit)
    unbiased = settled.unknown.copy()
    unbiased[FIXED:] = 0.0
    system.terms(settled.pose, unbiased)
    assert system.mesh_variance() == either != before
