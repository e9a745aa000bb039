"""What contacts say of an object, whatever its pose and their noise: density, evidence, and normals that help."""

import numpy as np
import pytest

from scenes.evidence import table as tables
from scenes.evidence.align import align
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.identity.evidence import EvidenceSettings, about_minima, by_first_contact
from touch.identity.noise import ContactNoiseSettings, Noise
from touch.identity.noise_kernels import log_likelihoods
from touch.recognition import identify

NAMES = ("l_block", "box", "cylinder", "pencil")


@pytest.fixture(scope="module")
def models():
    return [library.make(name) for name in NAMES]


def touched(model, count, noise, seed, turned=0.0, sign=1.0, told=None):
    """Contacts anywhere on the model, their normals turned by `turned` (rad) an axis, and the pose."""
    rng = np.random.default_rng(seed)
    points, normals = model.sample_surface(count, seed=seed)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], 0.3 * rng.normal(size=3))
    felt = poses.apply(pose, points + noise * rng.normal(size=points.shape))
    normals = sign * (normals + turned * rng.normal(size=normals.shape)) @ pose[:3, :3].T
    return Contacts(felt, normals, told), pose


def summed(distances, along, known, scales, normals, worths, beliefs, power):
    """The kernel's twin."""
    away = distances[..., None]
    point = np.where(away < 0, 0.5 / scales[0], 0.5 / scales * np.exp(-np.maximum(away, 0.0) / scales))
    sharp, meaningless, sign = normals.T
    turned = 2 * sharp / (1 - np.exp(-2 * sharp)) * np.exp(sharp * (sign * along[..., None] - 1))
    direction = np.where(known[:, None], (1 - meaningless) * turned + meaningless, 1.0)
    share, density = worths.T
    true = point[:, :, :, None, None] * direction[:, :, None, None, :]
    each = (1 - share)[:, None] * true + (share * density)[:, None]
    logs = beliefs + power * np.log(each).sum(axis=1)
    return np.logaddexp.reduce(logs.reshape(len(logs), -1), axis=1)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 40])
def test_the_kernel_is_its_twin(rng, count):
    distances, along = 0.01 * rng.random((5, count)), rng.uniform(-1, 1, size=(5, count))
    distances[0, 0], distances[1] = -1.0, 0.3
    known = rng.random(count) < 0.6
    normals = np.array([(120.0, 0.05, 1.0), (5.0, 0.3, -1.0)])
    worths = np.array([(0.02, 10.0), (0.4, 10.0)])
    beliefs = np.log(rng.random((3, 2, 2)))
    told = (np.geomspace(5e-4, 0.015, 3), normals, worths, beliefs)
    out = np.zeros(5)
    log_likelihoods(distances, along, known, *told, 0.7, out)
    np.testing.assert_allclose(out, summed(distances, along, known, *told, 0.7), rtol=1e-9)


def test_a_normal_that_means_nothing_says_nothing(models):
    """Drawing poses to meet a normal is drawing otherwise, no belief in it: weights make up for it."""
    contacts, _ = touched(models[0], 5, 0.001, 3)
    mute = EvidenceSettings(draws=60000, judged=20000, noise=ContactNoiseSettings(meaningless=(1.0,)))
    bare = Contacts(contacts.points)
    with_them, without = (
        np.mean(
            [
                by_first_contact(models[0], Noise(c, 1.0, mute.noise), np.random.default_rng(k), None, mute)
                for k in range(3)
            ]
        )
        for c in (contacts, bare)
    )
    assert with_them == pytest.approx(without, abs=0.3)


@pytest.mark.parametrize("name", ["l_block", "cylinder"])
def test_both_ways_to_sum_over_poses_agree(models, name):
    """Of four points: by draws on the surface, and by draws about minima, the same nats."""
    model = models[NAMES.index(name)]
    contacts, _ = touched(models[0], 4, 0.002, 5)
    contacts = Contacts(contacts.points, sigma_point=0.004)
    noise, settings = Noise(contacts, 1.0), EvidenceSettings(draws=200000, judged=50000, about=4000)
    starts = poses.make_poses(poses.random_rotations(1000, np.random.default_rng(1)), np.zeros((1000, 3)))
    starts[:, :3, 3] = contacts.points.mean(axis=0) - starts[:, :3, :3] @ model.centroid
    found = align(model, tables.from_contacts(contacts), starts)
    found = found.take(np.argsort(found.costs, kind="stable")[:400])
    drawn = by_first_contact(model, noise, np.random.default_rng(2), None, settings)
    about = about_minima(model, noise, found.poses, found.hessians, np.random.default_rng(2), None, settings)
    assert drawn == pytest.approx(about, abs=1.0)


@pytest.mark.parametrize(("turned", "sign"), [(0.05, 1.0), (0.35, 1.0), (0.05, -1.0)])
def test_normals_help_however_they_are_turned(models, turned, sign):
    """Fine ones, rough ones that nobody calls rough, and a driver's that point inward: never less sure than without."""
    share = {True: [], False: []}
    for seed in range(3):
        contacts, _ = touched(models[1], 9, 0.001, seed, turned, sign)
        for some in (contacts, Contacts(contacts.points)):
            found = identify(models, some, seed)
            told = {one.name: one.likelihood for one in found.candidates}["box"]
            share[bool(some.has_normal.any())].append(np.log(max(told, 1e-9)))
    assert np.mean(share[True]) > np.mean(share[False]) - 0.1


def test_many_rough_normals_hide_no_object(models):
    """They had been worth five degrees each, and cost the object hundreds of nats."""
    contacts, _ = touched(models[0], 40, 0.002, 4, turned=0.35)
    found = identify(models, contacts, 0)
    assert found.best == "l_block"
    assert found.none < 0.2


def test_noise_of_many_contacts_in_one_place_is_no_other_object(models):
    """Fingertips of many contacts each: how far off one lies is no smooth function of where it lies."""
    rng = np.random.default_rng(2)
    model = models[0]
    tips, _ = model.sample_surface(5, seed=4)
    patches = np.repeat(tips, 12, axis=0) + 0.003 * rng.normal(size=(60, 3))
    distance, gradient = model.field.distance_and_gradient(patches)
    points = patches - distance[:, None] * gradient + 0.0018 * rng.normal(size=(60, 3))
    assert identify([model], Contacts(points), 0).none < 0.2


def test_a_sigma_told_wrong_by_two_is_no_other_object(models):
    for told in (0.0006, 0.0024):
        contacts, _ = touched(models[2], 40, 0.0012, 6, told=told)
        found = identify(models, Contacts(contacts.points, sigma_point=contacts.sigma_point), 0)
        assert found.best == "cylinder"
        assert found.none < 0.1
