"""Grasp quality: closed forms, invariances, and contacts that cannot hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.synthesis import library
from touch.grasp_quality import (
    Quality,
    WrenchSettings,
    grasp_quality,
    largest_ball,
    margin,
    on_surface,
    primitive_wrenches,
)

ORIGIN = np.zeros(3)


def ball_contacts(count, seed):
    """Contacts on a unit sphere, normals tilted a little, spread enough to hold."""
    rng = np.random.default_rng(seed)
    points = poses.random_unit_vectors(count, rng)
    points -= 0.7 * points.mean(axis=0)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    normals = points + 0.15 * rng.normal(size=points.shape)
    return points, normals


# ---- closed forms


def test_cross_polytope_of_six_dimensions():
    ball = largest_ball(np.concatenate([np.eye(6), -np.eye(6)]))
    assert ball.radius == pytest.approx(1 / np.sqrt(6))
    assert ball.volume == pytest.approx(64 / 720)


def test_frictionless_tetrahedron_holds_forces_but_no_torque():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    wrenches = primitive_wrenches(corners, corners, ORIGIN, 1.0, WrenchSettings(friction=0.0))
    np.testing.assert_allclose(wrenches[..., 3:], 0, atol=1e-15)
    forces = np.unique(wrenches[..., :3].reshape(-1, 3).round(12), axis=0)
    ball = largest_ball(forces)
    assert ball.radius == pytest.approx(1 / 3)  # inscribed ball of a tetrahedron in the unit sphere
    assert ball.volume == pytest.approx(8 / (9 * np.sqrt(3)))
    whole = grasp_quality(corners, corners, ORIGIN, 1.0, WrenchSettings(friction=0.0))
    assert (whole.closure, whole.epsilon, whole.volume) == (False, 0.0, 0.0)
    assert "3 of 6 directions" in whole.why


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.3])
def test_three_contacts_on_a_disc(friction):
    # in the plane: two triangles of forces at torques of +friction and -friction; the lids are the nearest facets
    angle = 2 * np.pi * np.arange(3) / 3
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    wrenches = primitive_wrenches(points, points, ORIGIN, 1.0, WrenchSettings(friction, edges=4)).reshape(-1, 6)
    flat = wrenches[np.abs(wrenches[:, 2]) < 1e-9][:, [0, 1, 5]]
    assert len(flat) == 6
    ball = largest_ball(flat)
    assert ball.radius == pytest.approx(friction)
    assert abs(ball.weakest[2]) == pytest.approx(1.0)


@pytest.mark.parametrize(("friction", "radius"), [(0.5, 0.3), (0.8, 0.1), (0.3, 0.6)])
def test_two_opposed_soft_fingers_on_a_ball(friction, radius):
    points = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    hard = grasp_quality(points, points, ORIGIN, 1.0, WrenchSettings(friction))
    assert not hard.closure
    assert "5 of 6" in hard.why  # the turn about their line
    soft = grasp_quality(points, points, ORIGIN, 1.0, WrenchSettings(friction, edges=24, soft_radius=radius))
    assert soft.closure
    torsion = 2 / 3 * friction * radius

    def reach(x, corners):
        """Support function of the exact cones in direction x."""
        force, torque = np.split(x / np.linalg.norm(x), 2)
        out = []
        for side in (1.0, -1.0):
            turned = force[1:] + side * np.array([-torque[2], torque[1]]) * -1.0
            out.append(-side * force[0] + max(friction * np.linalg.norm(turned), torsion * abs(torque[0])))
        return max(out)

    rng = np.random.default_rng(0)
    precise = {"maxiter": 2000, "fatol": 1e-6, "xatol": 1e-6}
    starts = rng.normal(size=(6, 6))
    best = min(minimize(reach, x, (None,), method="Nelder-Mead", options=precise).fun for x in starts)
    assert soft.epsilon == pytest.approx(best, rel=1.5e-2)
    # the torsion alone bounds it
    assert soft.epsilon <= friction * torsion / np.hypot(friction, torsion) + 1e-9


def test_linf_of_opposed_pairs_is_l1_of_one_pair_each():
    # six frictionless pairs cannot be: instead, unit wrenches given directly
    wrenches = np.concatenate([np.eye(6), -np.eye(6)])[:, None]
    assert margin(wrenches, WrenchSettings(norm="l1")) == pytest.approx(1 / np.sqrt(6))
    assert margin(wrenches, WrenchSettings(norm="linf")) == pytest.approx(1.0)  # the cube of side 2


# ---- invariances and the two ways to the same number


@given(st.integers(0, 10**6), st.integers(3, 5))
@settings(derandomize=True, deadline=None, max_examples=15)
def test_moving_the_world_and_scaling_change_nothing(seed, count):
    points, normals = ball_contacts(count, seed)
    centre = 0.1 * np.random.default_rng(seed).normal(size=3)
    first = grasp_quality(points, normals, centre, 1.0)
    pose = poses.exp(np.random.default_rng(seed + 1).normal(size=6))
    moved = grasp_quality(poses.apply(pose, points), normals @ pose[:3, :3].T, poses.apply(pose, centre[None])[0], 1.0)
    scaled = grasp_quality(0.05 * points, normals, 0.05 * centre, 0.05)
    for other in (moved, scaled):
        assert other.closure == first.closure
        assert other.epsilon == pytest.approx(first.epsilon, abs=1e-8)
        assert other.volume == pytest.approx(first.volume, rel=1e-5, abs=1e-12)
        assert other.margin == pytest.approx(first.margin, abs=1e-8)


@given(st.integers(0, 10**6), st.integers(2, 5), st.sampled_from(["l1", "linf"]))
@settings(derandomize=True, deadline=None, max_examples=15)
def test_the_fast_margin_is_that_of_the_whole_hull(seed, count, norm):
    points, normals = ball_contacts(count, seed)
    how = WrenchSettings(norm=norm, soft_radius=0.2)
    whole = grasp_quality(points, normals, ORIGIN, 1.0, how)
    assert margin(primitive_wrenches(points, normals, ORIGIN, 1.0, how), how) == pytest.approx(whole.margin, abs=1e-7)


@given(st.integers(0, 10**6))
@settings(derandomize=True, deadline=None, max_examples=10)
def test_one_more_finger_never_holds_worse(seed):
    points, normals = ball_contacts(4, seed)
    three = grasp_quality(points[:3], normals[:3], ORIGIN, 1.0, WrenchSettings(soft_radius=0.1))
    four = grasp_quality(points, normals, ORIGIN, 1.0, WrenchSettings(soft_radius=0.1))
    assert four.margin >= three.margin - 1e-3  # pyramids turn towards the new contact
    both = [
        grasp_quality(points, normals, ORIGIN, 1.0, WrenchSettings(soft_radius=0.1, norm=norm)).epsilon
        for norm in ("l1", "linf")
    ]
    assert both[1] >= both[0] - 1e-9


def test_margin_outside_is_the_distance_to_the_hull():
    points = np.array([[1.0, 0, 0], [0.9, 0.3, 0], [0.9, -0.2, 0.3]])
    quality = grasp_quality(points, points, ORIGIN, 1.0)
    assert not quality.closure
    assert quality.epsilon == 0.0
    assert quality.margin < -0.3  # all push the same way
    flat = primitive_wrenches(points, points, ORIGIN, 1.0).reshape(-1, 6)
    weights = np.random.default_rng(0).dirichlet(np.full(len(flat), 0.2), size=20000)
    assert -quality.margin <= np.linalg.norm(weights @ flat, axis=1).min() + 1e-9


# ---- what cannot hold


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.array([[1.0, 0, 0]]),
        np.array([[1.0, 0, 0], [1.0, 0, 0]]),
        np.array([[1.0, 0, 0], [-1.0, 0, 0]]),
        np.array([[0.0, 0, 0]]),
    ],
)
def test_degenerate_contacts_have_zeros_and_a_verdict(points):
    normals = np.tile([1.0, 0, 0], (len(points), 1))
    for norm in ("l1", "linf"):
        quality = grasp_quality(points, normals, ORIGIN, 1.0, WrenchSettings(norm=norm))
        assert isinstance(quality, Quality)
        assert (quality.verdict, quality.epsilon, quality.volume) == ("no force closure", 0.0, 0.0)
        assert quality.why


def test_nonsense_is_refused_with_what_was_expected():
    point, normal = np.array([[1.0, 0, 0]]), np.array([[1.0, 0, 0]])
    with pytest.raises(InputError, match="as many normals as points"):
        grasp_quality(point, np.zeros((2, 3)), ORIGIN, 1.0)
    with pytest.raises(InputError, match="finite"):
        grasp_quality(point * np.nan, normal, ORIGIN, 1.0)
    with pytest.raises(InputError, match="normals"):
        grasp_quality(point, 0 * normal, ORIGIN, 1.0)
    with pytest.raises(InputError, match="length above 0"):
        grasp_quality(point, normal, ORIGIN, 0.0)
    for wrong in ({"friction": -1.0}, {"edges": 2}, {"norm": "l2"}, {"soft_radius": np.nan}):
        with pytest.raises(InputError):
            WrenchSettings(**wrong)


def test_a_thin_wall_is_touched_on_the_side_that_the_normal_leaves():
    glass = library.make("wine_glass")
    points, normals = glass.sample_surface(300, seed=2)
    inside = points - 0.0015 * normals  # noise pushes the contact through the wall
    foot, found = on_surface(glass, inside, normals)
    good = np.einsum("ni,ni->n", found, normals) > 0.7
    assert good.mean() > 0.95
    assert np.linalg.norm(foot - points, axis=1)[good].max() < 0.003
    unknown, _ = on_surface(glass, points, np.full_like(points, np.nan))
    np.testing.assert_allclose(unknown, points, atol=1e-5)
