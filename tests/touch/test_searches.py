"""Published searches over contacts: compiled steps against plain NumPy twins, then whether they find the object."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.evidence.align import Prior
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.localization import METHODS, localize
from touch.published import contact_icp
from touch.published.particles import memory_unscented_particle_filter as unscented
from touch.published.particles import particle_filters, scaling_series
from touch.published.particles import unscented_kernels as kernels
from touch.published.particles.memory_unscented_particle_filter import (
    UnscentedParticleFilter,
    UnscentedSettings,
    scattered_order,
)
from touch.published.particles.resampling import normalised, systematic

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def block():
    return library.make("l_block")


@pytest.fixture(scope="module")
def touched(block):
    """Exact contacts all over the block, and where the block is."""
    rng = np.random.default_rng(4)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], [0.3, -0.2, 0.5])
    return Contacts(poses.apply(pose, block.sample_surface(24, seed=2)[0])), pose


def random_covariance(rng, angle=0.1, distance=0.01):
    a = rng.normal(size=(6, 6))
    scale = np.array([angle] * 3 + [distance] * 3)
    return (a @ a.T / 6 + np.eye(6)) * scale * scale[:, None]


def twin_update(model, point, sigma, alpha, kappa, beta, pose, covariance):
    """T2 eq. 4.9 and algorithm 1 in plain NumPy: sigma points, predicted contacts, gain."""
    n = 6
    lam = alpha**2 * (n + kappa) - n
    root = np.linalg.cholesky((n + lam) * covariance)
    deltas = np.concatenate([np.zeros((1, n)), root.T, -root.T])
    mean_weights = np.full(13, 0.5 / (n + lam))
    mean_weights[0] = lam / (n + lam)
    covariance_weights = mean_weights.copy()
    covariance_weights[0] += 1 - alpha**2 + beta
    moved = poses.perturb(pose, deltas, model.centroid)
    predicted = []
    for one in moved:
        local = poses.apply(poses.inverse(one), point[None])
        field = model.field
        local = np.clip(local, field.origin, field.origin + field.spacing * (np.array(field.values.shape) - 1))
        for _ in range(4):
            d, g = field.distance_and_gradient(local)
            local = local - d[:, None] * g / max(float(np.linalg.norm(g)), kernels.SHORTEST_GRADIENT)
            if abs(d[0]) < field.spacing or abs(float(np.sum(g**2)) - 1.0) < kernels.STRAIGHT:
                break
        predicted.append(poses.apply(one, local)[0])
    predicted = np.array(predicted)
    mean = mean_weights @ predicted
    centred = predicted - mean
    s = (covariance_weights[:, None] * centred).T @ centred + sigma**2 * np.eye(3)
    cross = (covariance_weights[:, None] * deltas).T @ centred
    gain = cross @ np.linalg.inv(s)
    delta = gain @ (point - mean)
    return poses.perturb(pose, delta, model.centroid), covariance - gain @ s @ gain.T


@given(seeds)
@settings(max_examples=25)
def test_update_agrees_with_its_twin(seed):
    model = library.make("l_block")
    rng = np.random.default_rng(seed)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3) * 0.1)
    covariance = random_covariance(rng)
    point = poses.apply(pose, model.sample_surface(1, seed=seed % 1000)[0])[0] + rng.normal(size=3) * 0.01
    alpha, kappa, beta = 1.0, 2.0, 30.0
    rotation = pose[:3, :3].copy()
    middle = pose[:3, :3] @ model.centroid + pose[:3, 3]
    after = covariance.copy()
    scaling = np.array([np.sqrt(8.0), 1 / 16, 0.25, 0.25 + beta])
    field = model.field
    kernels.unscented_update(
        field.values,
        field.origin,
        field.spacing,
        model.centroid,
        point,
        0.004**2,
        scaling,
        rotation,
        middle,
        after,
        np.zeros((6, 6)),
        np.tile(np.eye(3), (9, 1, 1)),
        np.zeros((13, 3)),
        np.zeros((20, 6)),
    )
    expected, expected_covariance = twin_update(model, point, 0.004, alpha, kappa, beta, pose, covariance)
    np.testing.assert_allclose(rotation, expected[:3, :3], atol=1e-7)
    np.testing.assert_allclose(middle, expected[:3, :3] @ model.centroid + expected[:3, 3], atol=1e-8)
    np.testing.assert_allclose(after, expected_covariance, atol=1e-9)
    assert np.linalg.eigvalsh(after).min() > -1e-12


@given(seeds)
@settings(max_examples=15)
def test_mixture_density_agrees_with_scipy(seed):
    from scipy.special import logsumexp
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(seed)
    rotations = poses.random_rotations(5, rng)
    middles = rng.normal(size=(5, 3)) * 0.05
    covariances = np.array([random_covariance(rng, 0.6, 0.05) for _ in range(5)])
    weights = np.log(rng.random(5))
    out = np.zeros(5)
    kernels.mixture_density(rotations, middles, covariances, weights, rotations, middles, out)
    for j in range(5):
        terms = []
        for i in range(5):
            delta = np.concatenate([poses.log_rotation(rotations[j] @ rotations[i].T), middles[j] - middles[i]])
            terms.append(weights[i] + multivariate_normal(cov=covariances[i]).logpdf(delta))
        assert out[j] - 3 * np.log(2 * np.pi) == pytest.approx(logsumexp(terms), abs=1e-6)


@given(seeds)
def test_closest_points_lie_on_the_surface(seed):
    model = library.make("l_block")
    rng = np.random.default_rng(seed)
    points, normals = model.sample_surface(20, seed=seed % 1000)
    field = model.field
    # outside: inside a block, near the medial axis, no point is the one nearest
    found = points + 0.01 * np.abs(rng.normal(size=(20, 1))) * normals
    kernels.closest_points(field.values, field.origin, field.spacing, found, np.zeros(20))
    # beside edges the lattice rounds: a cell or two
    assert np.abs(model.surface.closest(found)[0]).max() < 2 * field.spacing


@given(seeds, st.integers(1, 60))
def test_systematic_resampling_draws_in_proportion(seed, count):
    rng = np.random.default_rng(seed)
    logs = rng.normal(size=12) * 3
    chosen = systematic(logs, count, rng)
    expected = normalised(logs) * count
    drawn = np.bincount(chosen, minlength=12)
    assert drawn.sum() == count
    assert (np.abs(drawn - expected) < 1 + 1e-9).all()


def test_weights_without_any_hope_are_even():
    np.testing.assert_allclose(normalised(np.full(4, -np.inf)), 0.25)


@given(seeds)
def test_scattered_order_is_a_permutation_that_reaches_far_first(seed):
    points = np.random.default_rng(seed).normal(size=(15, 3))
    order = scattered_order(points)
    assert sorted(order) == list(range(15))
    away = np.linalg.norm(points - points[order[0]], axis=1)
    assert order[1] == int(np.argmax(away))


def test_repeated_points_have_an_order_too():
    assert sorted(scattered_order(np.zeros((4, 3)))) == [0, 1, 2, 3]


@pytest.mark.parametrize(("method", "reach"), [("mupf", 3e-3), ("scaling-series", 5e-4)])
def test_global_searches_reach_the_surface(block, touched, method, reach):
    contacts, _ = touched
    found = localize(block, contacts, seed=1, method=method)
    assert found.index < reach
    assert found.method == method
    assert found.verdict in ("ok", "ambiguous")
    assert sum(mode.weight for mode in found.modes) == pytest.approx(1.0)
    np.testing.assert_allclose(found.pose, found.modes[0].pose, atol=1e-12)
    np.testing.assert_allclose(found.pose[:3, :3] @ found.pose[:3, :3].T, np.eye(3), atol=1e-9)


def test_scaling_series_finds_the_pose(block, touched):
    contacts, truth = touched
    found = localize(block, contacts, seed=3, method="scaling-series")
    delta = poses.difference(found.pose, truth, block.centroid)
    assert np.linalg.norm(delta[:3]) < 0.03
    assert np.linalg.norm(delta[3:]) < 1e-3


def test_annealed_filter_reaches_the_surface(block, touched):
    contacts, _ = touched
    assert particle_filters.annealed(block, contacts, seed=0).index < 4e-3


def test_plain_filter_is_the_worst(block, touched):
    contacts, _ = touched
    small = particle_filters.ParticleFilterSettings(particles=500)
    plain = particle_filters.plain(block, contacts, seed=0, settings=small)
    assert plain.index > localize(block, contacts, seed=0, method="mupf").index


@pytest.mark.parametrize("method", ["mupf", "upf", "scaling-series", "icp", "particle-filter"])
def test_same_seed_same_bits(block, touched, method):
    contacts = touched[0].take(np.arange(8))
    first = localize(block, contacts, seed=7, method=method)
    second = localize(block, contacts, seed=7, method=method)
    np.testing.assert_array_equal(first.pose, second.pose)


def test_threads_do_not_change_bits(block, touched, monkeypatch):
    contacts = touched[0].take(np.arange(8))
    wide = localize(block, contacts, seed=7, method="mupf")
    monkeypatch.setenv("PALPATE_THREADS", "1")
    np.testing.assert_array_equal(localize(block, contacts, seed=7, method="mupf").pose, wide.pose)


@pytest.mark.parametrize("method", ["mupf", "scaling-series", "icp"])
def test_a_prior_is_where_the_search_starts(block, touched, method):
    contacts, truth = touched
    rng = np.random.default_rng(0)
    prior = Prior.isotropic(poses.displaced(truth, 0.15, 0.006, block.centroid, rng), 0.1, 0.004)
    found = localize(block, contacts, seed=0, method=method, prior=prior)
    delta = poses.difference(found.pose, truth, block.centroid)
    assert np.linalg.norm(delta[:3]) < 0.25
    assert found.index < 3e-3


def test_icp_never_moves_away(block, touched):
    contacts, truth = touched
    rng = np.random.default_rng(2)
    start = poses.displaced(truth, 0.3, 0.02, block.centroid, rng)
    pose, used = contact_icp.refine(block, contacts.points, start)

    def mean(at):
        return np.abs(block.surface.closest(poses.apply(poses.inverse(at), contacts.points))[0]).mean()

    assert mean(pose) <= mean(start)
    assert used > 1
    exact, _ = contact_icp.refine(block, contacts.points, truth)
    np.testing.assert_allclose(exact, truth, atol=1e-6)


@given(seeds)
def test_rigid_fit_inverts_a_motion(seed):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(6, 3))
    motion = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))
    np.testing.assert_allclose(contact_icp.rigid_fit(source, poses.apply(motion, source)), motion, atol=1e-9)


def test_recursion_estimates_after_every_contact(block, touched):
    contacts, _ = touched
    search = UnscentedParticleFilter(block, contacts.points[0], 0, UnscentedSettings(window=10))
    indices = []
    for n in scattered_order(contacts.points):
        search.update(contacts.points[n])
        pose = search.estimate()
        distance = block.surface.closest(poses.apply(poses.inverse(pose), contacts.points))[0]
        indices.append(np.abs(distance).mean())
    assert np.isfinite(indices).all()
    assert indices[-1] < 0.3 * indices[0]


def test_drawing_from_the_proposal_runs_as_printed(block, touched):
    contacts, _ = touched
    search = UnscentedParticleFilter(block, contacts.points[0], 0, UnscentedSettings(window=10, sampled=True))
    for point in contacts.points[:4]:
        search.update(point)
    assert np.isfinite(search.estimate()).all()


def test_bounded_particles(block):
    rng = np.random.default_rng(0)
    limits = scaling_series.ScalingSettings(fewest=500, most=900)
    centres = np.tile(np.eye(4), (150, 1, 1))
    cover = scaling_series._cover(block, centres, 0.01, limits, rng)
    assert 500 <= len(cover) <= 900
    moved = poses.difference(cover, np.eye(4), block.centroid)
    size = np.sqrt((moved[:, :3] ** 2).sum(axis=1) * block.radius**2 + (moved[:, 3:] ** 2).sum(axis=1))
    assert size.max() <= 0.01 * (1 + 1e-9)
    survivors = scaling_series._survivors(np.tile(np.eye(4), (5000, 1, 1)), np.zeros(5000), limits, rng)
    assert len(survivors) <= 900 // limits.per_neighbourhood


@pytest.mark.parametrize(("window", "particles"), [(0, 700), (None, 700), (5, 1)])
def test_a_filter_that_cannot_work_is_refused(block, window, particles):
    with pytest.raises(InputError, match="expected a window"):
        UnscentedParticleFilter(block, np.zeros(3), 0, UnscentedSettings(window=window, particles=particles))


def test_a_contact_that_is_not_finite_is_refused(block):
    search = UnscentedParticleFilter(block, np.zeros(3))
    with pytest.raises(InputError, match="finite contact"):
        search.update([0.0, np.nan, 0.0])


def test_every_method_by_name_exists():
    from importlib import import_module

    for where in METHODS.values():
        module, _, function = where.partition(":")
        assert callable(getattr(import_module(module), function))


def test_a_filter_reads_a_lattice_that_fits_a_cache_and_loses_nothing_by_it(block, touched):
    contacts, _ = touched
    thin = unscented.UnscentedSettings(lattice=0.005)
    whole = unscented.UnscentedSettings(lattice=0.0)
    lattice, spacing = unscented._thinned_lattice(block, thin.lattice)
    assert spacing <= 0.005
    assert lattice.nbytes < 0.2 * block.field.values.nbytes
    index = [
        np.mean([unscented.localize(block, contacts, seed, settings=how).index for seed in range(4)])
        for how in (thin, whole)
    ]
    assert index[0] < 1.3 * index[1] + 5e-4
