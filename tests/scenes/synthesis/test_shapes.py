"""Mesh generators against bodies of known volume, area and distance."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.synthesis import shapes


def closed(mesh):
    body = trimesh.Trimesh(*mesh, process=False)
    assert body.is_watertight
    assert body.is_winding_consistent
    return body


@settings(max_examples=20, deadline=None)
@given(st.floats(0.005, 0.1), st.floats(0.01, 0.2), st.integers(8, 200))
def test_a_revolved_rectangle_is_a_prism(radius, height, segments):
    body = closed(shapes.revolve([(0, 0), (radius, 0), (radius, height), (0, height)], segments))
    area = 0.5 * segments * radius**2 * np.sin(2 * np.pi / segments)
    assert body.volume == pytest.approx(area * height, rel=1e-9)


def test_a_hollow_profile_encloses_its_wall_only():
    profile = [(0, 0), (0.04, 0), (0.04, 0.1), (0.035, 0.1), (0.035, 0.005), (0, 0.005)]
    body = closed(shapes.revolve(profile, 400))
    expected = np.pi * (0.04**2 * 0.1 - 0.035**2 * 0.095)
    assert body.volume == pytest.approx(expected, rel=1e-3)


def test_an_extruded_angle_has_its_volume():
    outline = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (0, 2)]
    assert closed(shapes.extrude(outline, 0.5)).volume == pytest.approx(2.0)


def test_bad_profiles_are_refused():
    with pytest.raises(InputError, match="axis to the axis"):
        shapes.revolve([(0.1, 0), (0.1, 1), (0, 1)])
    with pytest.raises(InputError, match="above 0"):
        shapes.revolve([(0, 0), (0.1, 0), (0.0, 0.5), (0.1, 1), (0, 1)])


@settings(max_examples=12, deadline=None)
@given(st.floats(0.02, 0.05), st.tuples(*[st.floats(-0.003, 0.003)] * 3), st.floats(0.003, 0.006))
def test_implicit_sphere_lies_on_the_sphere(radius, centre, spacing):
    mesh = shapes.mesh_implicit(
        lambda p: np.linalg.norm(p - np.array(centre), axis=1) - radius, [-0.07] * 3, [0.07] * 3, spacing
    )
    body = closed(mesh)
    assert body.euler_number == 2
    assert np.abs(np.linalg.norm(body.vertices - centre, axis=1) - radius).max() < 1e-6
    assert body.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.06)


def test_implicit_surface_outside_its_box_is_refused():
    with pytest.raises(InputError, match="leaves it"):
        shapes.mesh_implicit(lambda p: np.linalg.norm(p, axis=1) - 0.05, [-0.04] * 3, [0.06] * 3, 0.005)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_capsule_box_and_cylinder_distances(seed):
    """Against sphere tracing's own definition: the distance to a dense sample of the zero set."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.1, 0.1, (40, 3))
    start, end = rng.uniform(-0.05, 0.05, (2, 3))
    along = np.linspace(0, 1, 4001)[:, None] * (end - start) + start
    brute = np.linalg.norm(points[:, None] - along[None], axis=2).min(axis=1) - 0.01
    np.testing.assert_allclose(shapes.capsule(points, start, end, 0.01), brute, atol=1e-5)
    box = trimesh.creation.box(extents=(0.08, 0.06, 0.04))
    exact = -trimesh.proximity.signed_distance(box, points)
    sharp = shapes.rounded_box(points, [0, 0, 0], [0.04, 0.03, 0.02], 0.0)
    np.testing.assert_allclose(sharp, exact, atol=1e-9)
    radial, height = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
    outside = np.hypot(np.maximum(radial - 0.03, 0), np.maximum(height - 0.05, 0))
    inside = np.minimum(np.maximum(radial - 0.03, height - 0.05), 0)
    cylinder = shapes.rounded_cylinder(points, [0, 0, -0.05], [0, 0, 0.05], 0.03, 0.0)
    np.testing.assert_allclose(cylinder, outside + inside, atol=1e-9)


def test_smooth_union_is_a_union_away_from_the_seam_and_never_outside_it():
    rng = np.random.default_rng(4)
    a, b = rng.uniform(-0.1, 0.1, (2, 1000))
    joined = shapes.smooth_union([a, b], 0.01)
    assert (joined <= np.minimum(a, b)).all()
    far = np.abs(a - b) > 0.01
    np.testing.assert_array_equal(joined[far], np.minimum(a, b)[far])
    assert np.min(joined - np.minimum(a, b)) >= -0.0025 - 1e-15


def test_ellipsoid_is_zero_on_its_surface_with_unit_slope():
    directions = poses.random_unit_vectors(200, np.random.default_rng(0))
    radii = np.array([0.03, 0.05, 0.02])
    surface = directions * radii
    normal = surface / radii**2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(shapes.ellipsoid(surface, [0, 0, 0], radii), 0.0, atol=1e-15)
    np.testing.assert_allclose(shapes.ellipsoid(surface + 1e-6 * normal, [0, 0, 0], radii), 1e-6, rtol=1e-3)
