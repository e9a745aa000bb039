"""What the lines across an outline say together, compiled, against NumPy."""

import numpy as np

from vision.contour import kernels


def test_misfit_agrees_with_its_twin(rng):
    off, weight = rng.normal(0.0, 2.0, 60), rng.uniform(0.0, 2.0, 60)
    weight[::7] = 0.0
    share, alone, block = np.full(60, 0.25), np.full(60, 0.5), rng.integers(0, 12, 60)
    told = weight > 0.0
    by_line = max(np.median((weight / share * off**2)[told]) * 2.198, 1.0)
    told_by, pulls = (np.bincount(block, 2.0 * weight * value, minlength=12) for value in (np.ones(60), off))
    told_by, pulls = told_by / by_line, pulls / by_line
    total = (pulls**2 / told_by).sum()
    apart = max(0.0, total - 7) / (told_by.sum() - (told_by**2).sum() / told_by.sum())
    found, information = np.zeros(3), np.zeros(12)
    kernels.misfit(off, weight, share, alone, block, 5, found, information)
    np.testing.assert_allclose(found, [by_line, apart, 7])
    np.testing.assert_allclose(information, told_by)
    for used in (weight, np.zeros(60)):  # as many as are fitted tell nothing, and no line neither
        found, information = np.zeros(3), np.zeros(12)
        kernels.misfit(off, used, share, alone, block, 12, found, information)
        np.testing.assert_allclose(found, [by_line if used is weight else 1.0, 0.0, 0.0])


def test_lines_are_tempered_as_by_numpy(rng):
    off, weight, share = rng.normal(0.0, 2.0, 60), rng.uniform(0.0, 2.0, 60), rng.uniform(0.1, 0.5, 60)
    alone, block = rng.uniform(0.2, 1.0, 60), rng.integers(0, 12, 60)
    found, information, again, same = np.zeros(3), np.zeros(12), np.zeros(3), np.zeros(12)
    kernels.misfit(off, weight, share, alone, block, 5, again, same)
    apart = (3.0 * 0.04 + again[2] * again[1]) / (3.0 + again[2])
    expected = alone / again[0] / (1.0 + apart * same)[block]
    now, weighed = share.copy(), weight.copy()
    kernels.temper(off, weighed, now, alone, block, 5, (0.04, 3.0), found, information)
    np.testing.assert_allclose(now, expected)
    np.testing.assert_allclose(weighed, weight * expected / share)
    assert np.array_equal(found, again)
    assert np.array_equal(information, same)


def test_what_lines_share_is_marginalised_as_by_numpy(rng):
    rows, weight, left = rng.normal(size=(40, 10)), rng.uniform(0.0, 2.0, 40), rng.normal(size=40)
    known, early = np.diag(rng.uniform(0.5, 2.0, 4)), rng.normal(size=4)
    whole, pull = (rows * weight[:, None]).T @ rows, rows.T @ (weight * left)
    shared, cross = whole[6:, 6:] + known, whole[:6, 6:]
    expected = -np.linalg.solve(shared, pull[6:] + early)
    gradient, hessian, common = np.zeros(6), np.zeros((6, 6)), np.zeros(4)
    kernels.marginalise(rows, weight, left, known, early, gradient, hessian, common)
    np.testing.assert_allclose(common, expected)
    np.testing.assert_allclose(gradient, pull[:6] + cross @ expected, atol=1e-9)
    np.testing.assert_allclose(hessian, whole[:6, :6] - cross @ np.linalg.solve(shared, cross.T), atol=1e-9)


def test_lines_are_weighed_and_summed_as_by_numpy(rng):
    log_p = rng.normal(size=(30, 26))
    log_p -= np.log(np.exp(log_p).sum(axis=1, keepdims=True))
    rows, moved, share = rng.normal(size=(30, 9)), 0.5 * rng.normal(size=9), rng.uniform(0.1, 1.0, 30)
    expected, mean, precision = rows @ moved, np.zeros(30), np.zeros(30)
    kernels.sites(log_p, -12.5, expected, 2.5, mean, precision)
    variance = 1.0 / np.maximum(precision, 1e-6) + 0.25**2
    off = mean - expected
    odds = 0.01 * np.sqrt(2.0 * np.pi * variance) * np.exp(np.minimum(0.5 * off**2 / variance, 50.0))
    left, weight = np.zeros(30), np.zeros(30)
    kernels.weigh(log_p, -12.5, rows, moved, (2.5, 0.25, 0.01), share, left, weight)
    np.testing.assert_allclose(left, rows[:, :6] @ moved[:6] - mean, atol=1e-9)
    np.testing.assert_allclose(weight, np.where(precision > 0, share / variance / (1.0 + odds), 0.0), rtol=1e-9)
    whole, pull = np.zeros((9, 9)), np.zeros(9)
    kernels.sum_up(rows, weight, left, whole, pull)
    np.testing.assert_allclose(whole, (rows * weight[:, None]).T @ rows, atol=1e-12)
    np.testing.assert_allclose(pull, rows.T @ (weight * left), atol=1e-9)


def test_channels_that_are_alike_are_grey(rng):
    image = np.repeat(rng.integers(0, 256, (12, 15, 1), dtype=np.uint8), 3, axis=2)
    assert kernels.is_grey(image)
    assert kernels.is_grey(image[::2, ::3])
    for channel in range(3):
        coloured = image.copy()
        coloured[7, 9, channel] ^= 1
        assert not kernels.is_grey(coloured)
        assert kernels.is_grey(coloured[::2])


def test_places_across_lines_are_those_of_plain_arrays(rng):
    places, normals, low = rng.uniform(20.0, 90.0, (30, 2)), rng.normal(size=(30, 2)), np.array([3, 8])
    columns, rows = np.zeros((2, 30, 9), dtype=np.float32)
    kernels.places_across(places, normals, -4, low, columns, rows)
    expected = places[:, None] + np.arange(-4, 5)[None, :, None] * normals[:, None] - low
    np.testing.assert_array_equal(np.stack([columns, rows], axis=-1), expected.astype(np.float32))
