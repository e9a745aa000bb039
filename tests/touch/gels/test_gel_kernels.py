"""The compiled parts of a gel's image against plain twins."""

from __future__ import annotations

import numpy as np
import pytest
from pressed_gels import flat_gel

from scenes.robot.digit import digit_gel
from touch.gels.skin.colour import _median_gap
from touch.gels.skin.colour_kernels import judge, most_frequent
from touch.gels.skin.kernels import (
    _by_slope,
    equations,
    face,
    facing,
    following,
    most_telling,
    relax,
    slopes_by_colours,
)
from touch.gels.skin.surfaces import fitted, slopes, slopes_of_waves, surface_of


@pytest.mark.parametrize("gel", [digit_gel((60, 80)), flat_gel(60, 2e-4)], ids=["curved, pinhole", "flat, parallel"])
def test_normals_have_their_slopes(gel):
    rng = np.random.default_rng(0)
    index = rng.choice(gel.width * gel.height, 50, replace=False)
    normal = np.concatenate([rng.uniform(-0.5, 0.5, size=(50, 2)), np.ones((50, 1))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lines, across = gel.lines
    found = np.zeros_like(normal)
    facing(np.stack(slopes(normal, gel, index)), lines.reshape(-1, 3)[index], across, found)
    np.testing.assert_allclose(found, normal, atol=1e-12)


def test_normals_by_colours_are_the_nearest_of_unit_length():
    from scipy.optimize import least_squares

    rng = np.random.default_rng(4)
    by_normal = np.eye(3) * 0.8 + 0.1 * rng.normal(size=(20, 3, 3))
    rest = np.tile([0.0, 0.0, 1.0], (20, 1))
    true = np.concatenate([rng.uniform(-0.4, 0.4, size=(20, 2)), np.ones((20, 1))], axis=1)
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    mixture = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    change = np.einsum("kci,ki->kc", mixture @ by_normal, true - rest) + 0.02 * rng.normal(size=(20, 3))
    found = rest.copy()
    face(mixture, by_normal, change, rest, 1e-3, 0.97, 30, found)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)

    # the plain twin, in angles
    def left(angles, k):
        tilt, about = angles
        normal = np.array([np.sin(tilt) * np.cos(about), np.sin(tilt) * np.sin(about), np.cos(tilt)])
        return [*(mixture @ by_normal[k] @ (normal - rest[k]) - change[k]), *(np.sqrt(1e-3) * normal[:2])]

    for k in range(20):
        start = np.arccos(found[k, 2]) + 0.05, np.arctan2(found[k, 1], found[k, 0]) + 0.1
        tilt, about = least_squares(left, start, args=(k,)).x
        twin = np.sin(tilt) * np.array([np.cos(about), np.sin(about)])
        np.testing.assert_allclose(found[k, :2], twin, atol=1e-3)


def colourful(count, seed=3):
    """Maps, seen changes, untouched normals and lines of so many pixels."""
    rng = np.random.default_rng(seed)
    gel = digit_gel((60, 80))
    index = np.sort(rng.choice(60 * 80, count, replace=False))
    rest = gel.untouched_normals.reshape(-1, 3)[index]
    lines, across = gel.lines
    by_normal = 0.8 * np.eye(3) + 0.2 * rng.normal(size=(count, 3, 3))
    return rng, gel, index, rest, lines.reshape(-1, 3)[index], across, by_normal


def test_slopes_by_colours_are_those_of_the_nearest_normals():
    rng, gel, _, _, _, _, _ = colourful(4)
    count = 60 * 80
    by_normal = np.tile(0.8 * np.eye(3), (count, 1, 1)) + 0.1
    by_depth, depth = rng.normal(size=(count, 3)), np.full(count, 1e-3)
    # neighbours differ little, as those of an image do
    seen = np.tile(np.linspace(-0.2, 0.2, count)[:, None], (1, 3)).astype(np.float32)
    mixture, drift = np.eye(3) + 0.1 * rng.normal(size=(3, 3)), 0.01
    index = np.sort(rng.choice(count, 600, replace=False))
    lines, across = gel.lines
    rest = gel.untouched_normals.reshape(-1, 3)
    out = np.zeros((2, count), dtype=np.float32)
    unmixed = np.linalg.inv(mixture)
    flat = lines.reshape(-1, 3)
    slopes_by_colours(
        seen, unmixed, drift, by_normal, by_depth, depth, rest, flat, across, index, 60, 1e-3, 0.97, 8, 6, out
    )
    change = ((1.0 + seen.astype(np.float64)) / (1.0 + drift) - 1.0) @ unmixed.T - by_depth * depth[:, None]
    normal = rest[index].copy()
    face(np.eye(3), by_normal[index], change[index], rest[index], 1e-3, 0.97, 30, normal)
    twin = np.stack(slopes(normal, gel, index)) - np.stack(slopes(rest[index], gel, index))
    np.testing.assert_allclose(out[:, index], twin, atol=2e-5)
    others = np.setdiff1d(np.arange(count), index)
    assert (out[:, others] == 0.0).all()


def test_colours_by_slopes_are_the_derivative():
    _, _, _, rest, lines, across, by_normal = colourful(6)
    for p in range(6):
        base = -(across @ rest[p]) / (rest[p] @ lines[p])
        found = np.zeros((3, 2))
        _by_slope(by_normal[p], *rest[p], lines[p], across, found)
        for i in range(2):
            moved = np.zeros((2, 3))
            for row, sign in enumerate((1.0, -1.0)):
                along = base.copy()
                along[i] += sign * 1e-4
                facing(along[:, None], lines[p : p + 1], across, moved[row : row + 1])
            twin = by_normal[p] @ (moved[0] - moved[1]) / 2e-4
            np.testing.assert_allclose(found[:, i], twin, rtol=1e-3, atol=1e-3)


def test_equations_of_the_lamps_are_those_of_arrays():
    count = 40
    rng, _, index, rest, lines, across, by_normal = colourful(count)
    tilt = rest + 0.2 * rng.normal(size=(count, 3)) * [1.0, 1.0, 0.0]
    normal = tilt / np.linalg.norm(tilt, axis=1, keepdims=True)
    level = normal + 0.05 * rng.normal(size=(count, 3)) * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    q, by_depth, depth = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), rng.random(count)
    mixture = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    model, fields = np.zeros((count, 3)), np.zeros((2, 10, 60 * 80), dtype=np.float32)
    following(q, mixture, by_normal, by_depth, depth, rest, normal, level, lines, across, index, model, fields)
    twin = np.einsum("pci,pi->pc", by_normal, level - rest) + by_depth * depth[:, None]
    np.testing.assert_allclose(model, twin, atol=1e-12)
    ways = np.zeros((count, 3, 10))
    for row in range(3):
        ways[:, row, 3 * row : 3 * row + 3] = model
    ways[:, :, 9] = 1.0 + q
    own, after = np.zeros((count, 3, 2)), np.zeros((count, 3, 2))
    for p in range(count):
        _by_slope(mixture @ by_normal[p], *normal[p], lines[p], across, own[p])
        _by_slope(mixture @ by_normal[p], *level[p], lines[p], across, after[p])
    square = np.swapaxes(own, 1, 2) @ own
    square[:, [0, 1], [0, 1]] += 1e-3 * np.einsum("pii->p", square)[:, None] + 1e-12
    follow = -np.linalg.solve(square, np.swapaxes(own, 1, 2) @ ways)
    np.testing.assert_allclose(fields[:, :, index].transpose(2, 0, 1), follow, rtol=1e-4, atol=1e-3)

    bent, corrected = rng.normal(size=(2, 10, 60 * 80)), rng.normal(size=(count, 3))
    information, gradient = np.zeros((10, 10)), np.zeros(10)
    equations(
        q, corrected, mixture, by_normal, level, model, lines, across, index, bent, 3.0, 0.5, information, gradient
    )
    left = corrected - model @ mixture.T
    jacobian = -ways - np.einsum("pcs,skp->pck", after, bent[:, :, index])
    heavy = 3.0 / (1.0 + (left**2).sum(axis=1) / 0.25)
    np.testing.assert_allclose(gradient, np.einsum("p,pck,pc->k", heavy, jacobian, left), rtol=1e-9)
    np.testing.assert_allclose(information, np.einsum("p,pci,pck->ik", heavy, jacobian, jacobian), rtol=1e-9)


def test_surfaces_of_waves_fit_slopes_best():
    rng = np.random.default_rng(5)
    shape = 6, 8
    fields = rng.normal(size=(2, 3, *shape))
    waves = fitted(fields)
    assert abs(surface_of(waves).mean(axis=(1, 2))).max() < 1e-12
    # the plain twin: least squares over all amplitudes but the mean
    columns = []
    for one in range(1, shape[0] * shape[1]):
        alone = np.zeros(shape[0] * shape[1])
        alone[one] = 1.0
        columns.append(slopes_of_waves(alone.reshape(shape)).ravel())
    design = np.array(columns).T
    for k in range(3):
        twin = np.linalg.lstsq(design, fields[:, k].ravel(), rcond=None)[0]
        np.testing.assert_allclose(waves[k].ravel()[1:], twin, atol=1e-9)
    # slopes are the surface's own: no loss for what bends over a few pixels
    v, u = np.mgrid[0:20, 0:24].astype(np.float64)
    bump = np.exp(-((u - 12.0) ** 2 + (v - 9.0) ** 2) / (2.0 * 1.5**2))
    true = np.stack([-(u - 12.0) / 1.5**2 * bump, -(v - 9.0) / 1.5**2 * bump])
    np.testing.assert_allclose(slopes_of_waves(fitted(true)), true, atol=0.01)
    np.testing.assert_allclose(surface_of(fitted(true)) - bump, -bump.mean(), atol=0.01)


def test_relaxation_solves_the_equations():
    rng = np.random.default_rng(6)
    shape = 9, 12
    free = rng.random(shape) < 0.7
    held = rng.normal(size=shape)
    found = np.where(free, 0.0, held)
    relax(found, free, 0.2, 1.5, 500, 1e-12)
    for r, c in zip(*np.nonzero(free)):
        near = [(r + dr, c + dc) for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        values = [found[a] for a in near if 0 <= a[0] < shape[0] and 0 <= a[1] < shape[1]]
        assert found[r, c] * len(values) - sum(values) == pytest.approx(0.2, abs=1e-9)
    np.testing.assert_array_equal(found[~free], held[~free])


def test_the_most_frequent_difference_is_that_of_untouched_pixels():
    rng = np.random.default_rng(7)
    still = np.array([0.011, -0.02, 0.004]) + 0.002 * rng.normal(size=(300, 3))
    values = np.concatenate([still, rng.uniform(-0.3, 0.3, size=(700, 3))]).astype(np.float32)
    found = most_frequent(values, 0.05, 5, 0.03)
    # the plain twin, from there: the mean about it is itself
    near = values[(np.abs(values - found) < 0.1 / 13).all(axis=1)]
    np.testing.assert_allclose(found, near.mean(axis=0), atol=2e-4)
    np.testing.assert_allclose(found, [0.011, -0.02, 0.004], atol=1e-3)
    assert (most_frequent(values[300:], 0.05, 5, 0.03) == 0.0).all()
    assert (most_frequent(np.full((9, 3), np.float32(0.4)), 0.05, 5, 0.03) == 0.0).all()


def test_differences_are_judged_by_their_noise():
    rng = np.random.default_rng(8)
    blurred, level = (rng.random((5, 7, 3)).astype(np.float32) for _ in range(2))
    drift, noise = np.array([0.1, -0.2, 0.3]), np.array([0.5, 1.0, 2.0])
    smooth, size, counts = np.zeros_like(blurred), *np.zeros((2, 5, 7), dtype=np.float32)
    judge(blurred, level, drift, noise, smooth, size, counts)
    twin = blurred - drift * level
    np.testing.assert_allclose(smooth, twin, atol=1e-6)
    np.testing.assert_allclose(size, np.sqrt(((twin / noise) ** 2).sum(axis=2)), rtol=1e-5)
    np.testing.assert_allclose(counts, np.sqrt((twin**2).sum(axis=2)), rtol=1e-5)
    rows = np.rint(40.0 * rng.normal(size=(6, 9, 3))).astype(np.float32)
    for step in (1, 2):
        after = rows[:, 1::step]
        twin = np.median(np.abs(after - rows[:, :-1:step][:, : after.shape[1]]).reshape(-1, 3), axis=0)
        np.testing.assert_allclose(_median_gap(rows, step), twin)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_most_telling_rows_are_those_by_which_the_determinant_grows_most(seed):
    rng = np.random.default_rng(seed)
    jac = rng.normal(size=(60, 6)) * [1.0, 1.0, 0.2, 0.1, 1.0, 1.0]
    start = np.array([3, 20, 41])
    information = jac[start].T @ jac[start] + 1e-3 * np.eye(6)
    chosen = np.concatenate([start, np.zeros(9, dtype=np.int64)])
    most_telling(jac, np.linalg.inv(information), chosen, len(start))
    assert len(set(chosen.tolist())) == len(chosen)

    for place in range(len(start), len(chosen)):  # the plain twin, by determinants
        free = np.setdiff1d(np.arange(60), chosen[:place])
        grown = [np.linalg.slogdet(information + np.outer(jac[n], jac[n]))[1] for n in free]
        assert chosen[place] == free[int(np.argmax(grown))]
        information += np.outer(jac[chosen[place]], jac[chosen[place]])
