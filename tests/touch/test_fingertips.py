"""Fingertips of every shape: contacts recovered from their wrenches, and what is no contact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.geometry import poses
from touch.wrenches.fingertips import SoftSkin, tip_contacts
from touch.wrenches.sphere import sphere_contact

seeds = st.integers(0, 2**32 - 1)
RADII = np.array([0.008, 0.010, 0.014])


def hull():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return np.array(ball.vertices) * RADII, np.array(ball.faces)


VERTICES, FACES = hull()
SURFACES = {
    "sphere": {"sphere": {"radius": 0.01}},
    "ellipsoid": {"ellipsoid": {"radii": RADII.tolist()}},
    "cylinder": {"cylinder": {"radius": 0.009, "length": 0.03}},
    "mesh": {"mesh": {"vertices": VERTICES, "faces": FACES}},
}


def on_surface(kind, count, rng):
    """Points and outward normals on a fingertip."""
    u = poses.random_unit_vectors(count, rng)
    if kind == "sphere":
        return 0.01 * u, u
    if kind == "ellipsoid":
        normal = u / RADII
        return u * RADII, normal / np.linalg.norm(normal, axis=1, keepdims=True)
    if kind == "cylinder":
        u[:, 2] = 0.0
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        return 0.009 * u + np.outer(rng.uniform(-0.014, 0.014, count), [0, 0, 1]), u
    corners = VERTICES[FACES[rng.integers(len(FACES), size=count)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weights = rng.dirichlet([1.0, 1.0, 1.0], size=count)
    return np.einsum("nk,nkd->nd", weights, corners), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def press(point, normal, rng, friction=0.5, torsion=0.002):
    across = np.cross(normal, poses.random_unit_vectors(len(point), rng))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = rng.uniform(0.3, 8.0, size=(len(point), 1))
    force = size * (-normal + friction * rng.uniform(size=(len(point), 1)) * across)
    moment = size[:, 0] * rng.uniform(-torsion, torsion, size=len(point))
    return force, np.cross(point, force) + moment[:, None] * normal, moment


@pytest.mark.parametrize("kind", SURFACES)
@given(seed=seeds)
def test_the_contact_is_recovered(kind, seed):
    rng = np.random.default_rng(seed)
    point, normal = on_surface(kind, 30, rng)
    force, torque, moment = press(point, normal, rng, torsion=0.0005)
    found = tip_contacts(force, torque, SURFACES[kind])
    assert found.valid.all()
    # what is found explains the wrench, whichever of the solutions it is
    again = np.cross(found.points, force) + found.moments[:, None] * found.normals
    slack = 1e-7 if kind != "mesh" else 1e-12
    assert np.abs(again - torque).max() < slack
    right = np.linalg.norm(found.points - point, axis=1) < 1e-6
    # adjoining faces of a mesh can both explain one wrench
    assert right.mean() > (0.8 if kind == "mesh" else 0.99)
    assert np.allclose(found.normals[right], normal[right], atol=1e-4)
    assert np.allclose(found.moments[right], moment[right], atol=1e-7)
    assert np.allclose(found.friction + force * 0, force + found.pressing[:, None] * found.normals)


def test_an_ellipsoid_with_equal_radii_is_the_sphere(rng):
    point, normal = on_surface("sphere", 500, rng)
    force, torque, _ = press(point, normal, rng)
    force += 0.05 * rng.normal(size=force.shape)
    ball = sphere_contact(force, torque, 0.01)
    found = tip_contacts(force, torque, {"ellipsoid": {"radii": [0.01] * 3}})
    both = ball[2] & found.valid
    assert both.mean() > 0.98
    assert np.linalg.norm(ball[0] - found.points, axis=1)[both].max() < 1e-6


@pytest.mark.parametrize("kind", SURFACES)
def test_a_soft_layer_is_indented_by_the_normal_force(kind, rng):
    layer = SoftSkin(stiffness=8000.0, thickness=0.002)
    point, normal = on_surface(kind, 200, rng)
    force, _, _ = press(point, normal, rng)
    depth = -np.einsum("ni,ni->n", force, normal) / layer.stiffness
    if kind == "ellipsoid":  # the pressed surface is the ellipsoid with shorter radii
        u = point / RADII
        shorter = RADII - depth[:, None]
        point, normal = u * shorter, u / shorter
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        layer_force = -np.einsum("ni,ni->n", force, normal)
        depth = layer_force / layer.stiffness
        point = u * (RADII - depth[:, None])
    else:
        point = point - depth[:, None] * normal
    found = tip_contacts(force, np.cross(point, force), SURFACES[kind], layer)
    hard = tip_contacts(force, np.cross(point, force), SURFACES[kind])
    error = np.linalg.norm(found.points - point, axis=1)[found.valid]
    assert found.valid.mean() > 0.9
    assert np.median(error) < 3e-5
    assert np.median(error) < 0.2 * np.median(np.linalg.norm(hard.points - point, axis=1)[hard.valid])


@pytest.mark.parametrize("kind", SURFACES)
@pytest.mark.parametrize(
    ("force", "torque"),
    [
        ([0, 0, 0], [0, 0, 0]),
        ([0.001, 0, 0], [0, 0, 0]),
        ([np.nan, 0, 0], [0, 0, 0]),
        ([1, 0, 0], [0, 0.2, 0]),  # a lever arm of twenty centimetres
        ([1, 0, 0], [0, np.inf, 0]),
    ],
)
def test_what_is_no_contact(kind, force, torque):
    found = tip_contacts(force, torque, SURFACES[kind])
    assert not found.valid[0]
    assert np.isfinite(found.points).all()
    assert np.isfinite(found.normals).all()


def test_a_cylinder_has_flat_ends():
    found = tip_contacts([[0.1, 0.0, -2.0]], [np.cross([0.003, 0.002, 0.015], [0.1, 0.0, -2.0])], SURFACES["cylinder"])
    assert found.valid[0]
    assert np.allclose(found.points[0], [0.003, 0.002, 0.015], atol=1e-12)
    assert np.allclose(found.normals[0], [0, 0, 1])


@pytest.mark.parametrize("kind", SURFACES)
@given(seed=seeds)
def test_any_finite_wrench_gives_finite_numbers_and_valid_ones_press(kind, seed):
    rng = np.random.default_rng(seed)
    force = rng.normal(size=(50, 3)) * 10.0 ** rng.uniform(-6, 4)
    torque = rng.normal(size=(50, 3)) * 10.0 ** rng.uniform(-8, 3)
    found = tip_contacts(force, torque, SURFACES[kind])
    for array in (found.points, found.normals, found.moments, found.pressing, found.friction):
        assert np.isfinite(array).all()
    assert (found.pressing[found.valid] > 0).all()


def test_bad_surfaces_are_named():
    with pytest.raises(InputError, match="got mesh"):
        tip_contacts([[0, 0, 1]], [[0, 0, 0]], {"mesh": {"file": "tip.stl"}})
    with pytest.raises(InputError, match="above 0"):
        SoftSkin.parse({"stiffness": -1.0})
    assert SoftSkin.parse({"thickness": 0.002}) is None
