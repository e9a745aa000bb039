"""Another shape or noise: what contacts leave over, as odds."""

import numpy as np
import pytest

from touch.misfit import log_odds_of_another

DIAMETER, NOISE = 0.1, (1e-4, 0.015)


def around(rng, count):
    """Places on a ball of 5 cm and their normals."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return 0.05 * normals, normals


def odds(points, normals, residuals):
    return log_odds_of_another(points, normals, residuals, DIAMETER, NOISE)[0]


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_shape_and_a_shape_is_no_noise(seed):
    rng = np.random.default_rng(seed)
    points, normals = around(rng, 100)
    noise = 0.001 * rng.normal(size=100)
    assert odds(points, normals, noise) < 0.0
    wave = 0.003 * np.sin(points @ [100.0, 80.0, 60.0] + seed)
    assert odds(points, normals, noise + wave) > 4.0
    # a fifth of them far off, here and there: false contacts, not another object
    wild = noise + np.where(rng.random(100) < 0.2, 0.03 * np.abs(rng.normal(size=100)), 0.0)
    assert odds(points, normals, wild) < 2.0


@pytest.mark.parametrize("count", [1, 3, 6])
def test_what_a_pose_can_fit_tells_nothing(rng, count):
    points, normals = around(rng, count)
    assert odds(points, normals, 0.005 * rng.normal(size=count)) == pytest.approx(0.0, abs=5.0)
    assert np.isfinite(odds(points, normals, np.zeros(count)))


def test_a_turn_or_a_shift_of_the_object_is_no_misfit(rng):
    points, normals = around(rng, 60)
    points = points * [1.0, 0.6, 0.3]
    noise = 0.0005 * rng.normal(size=60)
    moved = np.cross(np.full(points.shape, [0.02, -0.01, 0.03]), points) + np.array([0.001, 0.0, -0.002])
    assert odds(points, normals, noise + np.sum(normals * moved, axis=1)) == pytest.approx(
        odds(points, normals, noise), abs=1.5
    )


def test_the_same_places_felt_again_and_again_are_finite(rng):
    points, normals = (np.repeat(x, 30, axis=0) for x in around(rng, 1))
    assert np.isfinite(odds(points, normals, np.zeros(30)))


def test_a_relative_that_most_contacts_fit_exactly_is_still_another(rng):
    """All but one end of a tool is the same: those contacts there are no false ones."""
    points, normals = around(rng, 100)
    end = points[:, 2] > 0.03
    assert 10 < end.sum() < 40
    noise = 2e-4 * rng.normal(size=100)
    assert odds(points, normals, noise + np.where(end, 0.006, 0.0)) > 3.0
    # as many, anywhere
    assert odds(points, normals, noise + rng.permutation(np.where(end, 0.006, 0.0))) < 1.5


@pytest.mark.parametrize("seed", range(3))
def test_false_contacts_among_true_ones_are_no_other_object(seed):
    """As far off as a finger that touched something else, one in five: they are told by their neighbours."""
    rng = np.random.default_rng(seed)
    points, normals = around(rng, 150)
    noise = 0.001 * rng.normal(size=150)
    wild = noise + np.where(rng.random(150) < 0.2, rng.uniform(0.008, 0.04, size=150), 0.0)
    assert odds(points, normals, wild) < 0.0
    # together in one place they are a shape
    there = points[:, 0] > 0.03
    assert odds(points, normals, noise + np.where(there, 0.015, 0.0)) > 5.0


def test_what_is_plainly_another_is_told_by_fewer_contacts(rng):
    points, normals = around(rng, 60)
    noise = 0.0005 * rng.normal(size=60)
    another, plainly = log_odds_of_another(points, normals, noise, DIAMETER, NOISE)
    assert plainly < another < 0.0
    wave = 0.0008 * np.sin(points @ [100.0, 80.0, 60.0])
    another, plainly = log_odds_of_another(points, normals, noise + wave, DIAMETER, NOISE)
    assert plainly < another - 2.0
    wave = 0.006 * np.sin(points @ [100.0, 80.0, 60.0])
    assert min(log_odds_of_another(points, normals, noise + wave, DIAMETER, NOISE)) > 5.0
