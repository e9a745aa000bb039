"""The published contact methods: their costs against plain NumPy, and each finding an object from clean contacts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Prior
from scenes.evidence.modes import ModeSettings, displaced
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.answers import contact_index
from touch.localization import METHODS, localize
from touch.published.optimisers import costs as published
from touch.published.optimisers import gradient_descent, levenberg_marquardt, monte_carlo
from touch.published.optimisers.direct import BoxSettings, objective

seeds = st.integers(0, 2**32 - 1)
MINE = ("gradient-descent", "levenberg-marquardt", "monte-carlo", "direct", "annealing")


@pytest.fixture(scope="module")
def block():
    return library.make("l_block")


def felt(model, count, seed):
    rng = np.random.default_rng(seed)
    truth = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3) * 0.1)
    points, normals = model.sample_surface(count, seed=seed)
    return truth, Contacts(points, normals, 5e-4, np.deg2rad(2.0)).moved(truth)


def error(model, pose, truth):
    delta = poses.difference(model.symmetries.nearest(pose, truth), truth, model.centroid)
    return np.rad2deg(np.linalg.norm(delta[:3])), 1e3 * np.linalg.norm(delta[3:])


@given(seeds)
def test_rotation_by_quaternion(seed):
    rng = np.random.default_rng(seed)
    q, v = rng.normal(size=4), rng.normal(size=3)
    q /= np.linalg.norm(q)
    assert np.allclose(published.rotate(q, *v), Rotation.from_quat(q[[1, 2, 3, 0]]).apply(v))


@settings(max_examples=20)
@given(seed=seeds, weight=st.sampled_from([0.0, 20.0]))
def test_region_costs_are_equation_3_5(seed, weight):
    rng = np.random.default_rng(seed)
    f, u = rng.normal(size=(3, 3)), poses.random_unit_vectors(3, rng)
    cloud, normals = rng.normal(size=(30, 3)), poses.random_unit_vectors(30, rng)
    first = np.array([0, 10, 14, 30])
    x = np.concatenate([rng.normal(size=4), 0.1 * rng.normal(size=3)])
    out = np.zeros(3)
    published.region_costs(x, f, u, first, cloud, normals, weight, out)
    turn = Rotation.from_quat(x[[1, 2, 3, 0]])
    for k in range(3):
        part = slice(first[k], first[k + 1])
        distance = ((turn.apply(f[k]) + x[4:] - cloud[part]) ** 2).sum(axis=1)
        angle = np.abs(1 - normals[part] @ turn.apply(u[k]))
        assert out[k] == pytest.approx((distance + weight * angle).min())


def test_surface_cost_is_equation_4_1(block, rng):
    truth, contacts = felt(block, 6, 1)
    q, t = rng.normal(size=4), 0.01 * rng.normal(size=3)
    q /= np.linalg.norm(q)
    local = contacts.moved(poses.inverse(truth))
    f = local.points - block.centroid
    field = block.field
    found = published.surface_cost(
        field.values, field.origin, field.spacing, block.centroid, f, local.normals, 0.1, q, t
    )
    turn = Rotation.from_quat(q[[1, 2, 3, 0]])
    distance, gradient = field.distance_and_gradient(turn.apply(f) + block.centroid + t)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    cosine = (turn.apply(local.normals) * gradient).sum(axis=1)
    assert found == pytest.approx((np.abs(distance) + 0.1 * (1 - cosine)).sum())
    # and the pose that such a candidate stands for moves the contacts by it
    pose = published.pose_of(q, t, block.centroid, block.centroid, truth)
    again = poses.apply(poses.inverse(pose), contacts.points)
    assert np.allclose(again, turn.apply(f) + block.centroid + t, atol=1e-12)


def test_regions_hold_what_is_near_and_enough(block):
    truth, contacts = felt(block, 4, 2)
    regions = published.regions_about(block, contacts, truth)
    sizes = np.diff(regions.first)
    assert (sizes >= 60).all()
    for k in range(4):
        part = regions.cloud[regions.first[k] : regions.first[k + 1]]
        reach = np.linalg.norm(part - regions.contacts[k], axis=1).max()
        assert reach <= 1.5 + 1e-9 or sizes[k] == 60


@pytest.mark.parametrize("seed", [0, 2, 32])
def test_a_descent_that_diverges_ends_at_finite_numbers(seed):
    # at the published rate each step overshoots the last, until single precision cannot hold its square
    corners = np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]])
    model = ObjectModel("tetrahedron", corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    contacts = Contacts(*model.sample_surface(9, seed=seed))
    found = localize(model, contacts, seed=seed, method="gradient-descent")
    assert np.isfinite(found.pose).all()
    assert np.isfinite(found.index)
    assert found.verdict != "ok"


def test_a_step_that_cannot_be_normalised_is_not_taken():
    step = np.array([1.0, 0, 0, 0, 5.0, 0, 0])
    assert gradient_descent.is_within(step, 5.0)
    assert not gradient_descent.is_within(step, 4.0)
    for place, value in ((0, 0.0), (0, np.nan), (1, np.inf), (6, np.nan)):
        wrong = step.copy()
        wrong[place] = value
        assert not gradient_descent.is_within(wrong, 5.0)


@pytest.mark.parametrize("refine", [gradient_descent.refine, levenberg_marquardt.refine])
def test_local_methods_bring_the_contacts_nearer(block, refine):
    before, after = [], []
    for seed in range(12):
        truth, contacts = felt(block, 4, seed)
        start = poses.displaced(truth, 0.15, 0.008, block.centroid, np.random.default_rng(seed))
        pose, used = refine(block, contacts, start, seed)
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        assert used <= 200
        before.append(contact_index(block, contacts, start))
        after.append(contact_index(block, contacts, pose))
    assert np.mean(after) < 0.7 * np.mean(before)


def test_levenberg_marquardt_stops_where_it_stands_when_all_fits(block):
    truth, contacts = felt(block, 4, 0)
    pose, _ = levenberg_marquardt.refine(block, contacts, truth)
    assert contact_index(block, contacts, pose) < 1e-3


@pytest.mark.parametrize("method", MINE)
def test_each_method_refines_a_good_prior(block, method):
    truth, contacts = felt(block, 6, 3)
    start = poses.displaced(truth, 0.05, 0.003, block.centroid, np.random.default_rng(0))
    found = localize(block, contacts, seed=0, method=method, prior=Prior.isotropic(start, 0.05, 0.003))
    assert found.method == method
    assert found.index < 0.7e-3 if method != "gradient-descent" else 2e-3
    assert np.isfinite(found.covariance).all()
    assert error(block, found.pose, truth)[0] < 8.0


@pytest.mark.parametrize("method", MINE)
def test_the_same_seed_gives_the_same_bits(block, method):
    _, contacts = felt(block, 5, 4)
    prior = Prior.isotropic(poses.displaced(np.eye(4), 0.1, 0.01, block.centroid, np.random.default_rng(0)), 0.1, 0.01)
    first, second = (localize(block, contacts, seed=7, method=method, prior=prior) for _ in range(2))
    assert np.array_equal(first.pose, second.pose)


def test_monte_carlo_finds_an_object_without_a_prior(block):
    good = 0
    for seed in range(4):
        truth, contacts = felt(block, 8, 10 + seed)
        small = monte_carlo.MonteCarloSettings(
            particles=40_000, initial=10_000, runs=2, space_rotation=0.5, space_translation=0.06, everywhere=True
        )
        found, costs, made = monte_carlo.search(block, contacts, seed, settings=small)
        assert np.all(np.diff(costs) >= 0)
        assert made <= 80_000
        rotation, position = error(block, found[0], truth)
        good += rotation < 15 and position < 10
    assert good >= 2


def test_roulette_draws_by_weight_from_the_end():
    weights = np.array([1.0, 2.0, 3.0, 4.0])
    draws = [monte_carlo._draw_from_end(weights, 4, r) for r in np.linspace(0, 9.999, 10_001)]
    assert np.bincount(draws) / len(draws) == pytest.approx(weights / 10, abs=1e-3)
    assert draws[0] == 3  # little is wanted: the last particle has it


def test_initial_quaternions_are_uniform_or_straight():
    rng, q = np.random.default_rng(0), np.zeros(4)
    mean = np.zeros((4, 4))
    for _ in range(4000):
        monte_carlo._uniform_quaternion(rng, q)
        assert np.linalg.norm(q) == pytest.approx(1.0)
        mean += np.outer(q, q) / 4000
    assert np.allclose(mean, np.eye(4) / 4, atol=0.02)
    for _ in range(50):
        monte_carlo._straight_quaternion(rng, q)
        assert np.round(np.rad2deg(2 * np.arccos(min(1.0, abs(q[0]))))) in (0, 90, 180)


def test_poses_inside_the_hand_are_discarded(block):
    truth, _ = felt(block, 6, 5)
    inside = tables.outside(poses.apply(truth, block.centroid[None]), 0.001, tables.TOUCH)
    beside = tables.outside(poses.apply(truth, block.centroid[None] + [0.5, 0, 0]), 0.001, tables.TOUCH)
    hits = [
        monte_carlo.collides(block, truth[None], rows, monte_carlo.MonteCarloSettings())[0] for rows in (inside, beside)
    ]
    # the centroid of an angle may lie in its corner, outside the object
    depth = block.field.distance(block.centroid[None])[0]
    assert hits == [depth < -0.004, False]


def test_the_box_of_a_global_optimiser_is_centred_on_the_prior(block):
    truth, contacts = felt(block, 5, 6)
    cost, bounds, pose = objective(block, contacts, Prior.isotropic(truth, 0.1, 0.01), BoxSettings())
    assert np.allclose(pose(np.zeros(6)), truth)
    assert cost(np.zeros(6)) < 1e-3
    assert np.allclose(np.array(bounds)[:, 1], [0.3] * 3 + [0.03] * 3, rtol=0.02)


def test_the_box_of_a_global_optimiser_has_the_axes_of_the_prior(block):
    """Wide along the contacts' z only, about a pose that has turned z to its own x."""
    _, contacts = felt(block, 5, 6)
    start = poses.make_pose(poses.exp_rotation([0.0, np.pi / 2, 0.0]))
    prior = Prior(start, np.linalg.inv(np.diag([0.1**2] * 3 + [0.001**2, 0.001**2, 0.03**2])))
    _, bounds, pose = objective(block, contacts, prior, BoxSettings())
    high = np.array(bounds)[:, 1]
    along = int(np.argmax(high[3:]))
    moved = pose(np.concatenate([np.zeros(3), 0.5 * high[3 + along] * np.eye(3)[along]]))
    step = moved[:3, 3] - start[:3, 3]
    assert abs(step[2]) > 0.03
    assert np.abs(step[:2]).max() < 1e-9


@pytest.mark.parametrize("method", ["mupf", "scaling-series", "particle-filter", "direct"])
def test_a_prior_may_leave_directions_open(block, method):
    truth, contacts = felt(block, 5, 6)
    open_in_place = Prior(truth, np.diag([100.0, 100.0, 100.0, 0.0, 0.0, 0.0]))
    found = localize(block, contacts, method=method, seed=0, prior=open_in_place)
    assert np.isfinite(found.pose).all()


def test_a_filters_answer_is_not_listed_beside_itself(block):
    apart = ModeSettings().merge_share * block.radius
    for seed in range(4):
        _, contacts = felt(block, 20, seed)
        modes = localize(block, contacts, method="mupf", seed=seed).modes
        rest = np.array([mode.pose for mode in modes[1:]]).reshape(-1, 4, 4)
        assert (displaced(block, rest, modes[0].pose) >= apart).all()


def test_unknown_methods_are_named(block):
    _, contacts = felt(block, 3, 0)
    with pytest.raises(InputError, match="multistart, gradient-descent"):
        localize(block, contacts, method="guess")
    assert set(MINE) < set(METHODS)
