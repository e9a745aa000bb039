"""A hand's surface at its joints, against Open3D's closest points and rays on the same mesh."""

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import region_rays
from scenes.geometry.cameras import Camera
from scenes.geometry.surface import Surface
from scenes.robot import posed_kernels as kernels
from scenes.robot.posed import LEAF, PosedHand

CAMERA = Camera(600.0, 610.0, 321.3, 238.7, 640, 480)


@pytest.fixture
def both(exact_frame, rng):
    """A hand at other joints than those of its plan, and the mesh that it is then."""
    joints = {name: value + 0.3 * rng.normal() for name, value in exact_frame.joints.items()}
    vertices, faces, _ = exact_frame.hand.mesh(joints)
    return PosedHand(exact_frame.hand, joints), Surface(vertices, faces)


def around(surface, rng, count):
    low, high = surface.bounds
    return rng.uniform(low - 0.02, high + 0.02, size=(count, 3))


def test_closest_points_are_the_same(both, rng):
    hand, surface = both
    points = around(surface, rng, 3000)
    distance, gradient, _ = surface.closest(points)
    found, along = hand.closest(points)
    assert (found < 0).any()
    np.testing.assert_allclose(np.abs(found), np.abs(distance), atol=2e-7)
    # links lie in each other: there single precision may meet another of two faces, whose side is another
    assert (np.sign(found) != np.sign(distance)).mean() < 2e-3
    same = (np.sign(found) == np.sign(distance)) & (np.abs(distance) > 1e-4)
    assert (np.abs(along - gradient)[same].max(axis=1) > 1e-3).mean() < 2e-3  # as near to two places
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0, atol=1e-9)


def test_what_is_asked_near_is_told_near_only(both, rng):
    hand, surface = both
    points = around(surface, rng, 3000)
    whole, along = hand.closest(points)
    found, gradient = hand.closest(points, within=0.01)
    near = np.abs(whole) < 0.01
    assert near.any()
    assert not near.all()
    # the order of the search is another, and of two triangles that share an edge either may be met
    np.testing.assert_allclose(found[near], whole[near], rtol=0, atol=1e-12)
    np.testing.assert_allclose(gradient[near], along[near], rtol=0, atol=1e-6)
    assert (found[~near] == 0.01).all()
    assert (gradient[~near] == 0.0).all()
    assert np.array_equal(hand.is_within(points, 0.01), near)
    assert np.array_equal(hand.may_be_within(points, 0.01), surface.may_be_within(points, 0.01))
    assert hand.may_be_within(points, 0.01)[near].all()
    assert hand.closest(np.zeros((0, 3)))[1].shape == (0, 3)


def test_points_on_the_surface_have_its_normals(both, rng):
    hand, _ = both
    corners = hand.vertices[hand.faces]
    weights = rng.dirichlet(np.ones(3), size=len(corners))
    points = np.einsum("nk,nkd->nd", weights, corners)
    distance, gradient = hand.closest(points)
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    # a few lie on two links' faces
    assert (np.sum(gradient * normals, axis=1) > 1 - 1e-9).mean() > 0.98


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("box", [(0, 0, 640, 480), (201, 100, 480, 301), (0, 0, 5, 5)])
def test_it_is_drawn_as_rays_meet_it(both, rng, box, step):
    hand, surface = both
    middle = 0.5 * (surface.bounds[0] + surface.bounds[1])
    # ahead of the camera; partly beside the image; with the camera in the midst of it
    for ahead in ([0.0, 0.0, 0.5], [0.25, -0.1, 0.4], [0.0, 0.0, 0.02]):
        pose = poses.make_pose(poses.exp_rotation(rng.normal(size=3)), np.zeros(3))
        pose[:3, 3] = np.array(ahead) - pose[:3, :3] @ middle
        depth = hand.depth(CAMERA, pose, box, step)
        rays = region_rays(CAMERA, box)[::step, ::step]
        inverse = poses.inverse(pose)
        flat = rays.reshape(-1, 3)
        met = surface.cast(np.broadcast_to(inverse[:3, 3], flat.shape), flat @ inverse[:3, :3].T)
        met = met.reshape(rays.shape[:2])
        assert depth.shape == met.shape
        # single precision tells some pixels of outlines, and folds of it, otherwise
        there = np.isfinite(depth) & np.isfinite(met)
        assert (np.isfinite(depth) != np.isfinite(met)).mean() < 1e-3
        assert (np.abs(depth[there] - met[there]) > 1e-5).mean() < 1e-3 if there.any() else True


def test_the_gap_is_that_of_the_nearest_point(both, rng):
    hand, surface = both
    points = around(surface, rng, 200)
    for some in (points, points[:1], points[7:9]):
        np.testing.assert_allclose(hand.gap(some), np.abs(surface.closest(some)[0]).min(), atol=2e-7)
    assert hand.gap(points[:0]) == np.inf


def test_a_run_is_sorted_like_numpys_stable_argsort():
    rng = np.random.default_rng(5)
    for count in (1, 2, 3, 7, 64, 501):
        low, high = sorted(rng.integers(0, count + 1, 2))
        keys, order = rng.integers(0, 9, count).astype(np.float64), rng.permutation(count)
        expected_keys, expected = keys.copy(), order.copy()
        turn = np.argsort(keys[low:high], kind="stable")
        expected_keys[low:high], expected[low:high] = keys[low:high][turn], order[low:high][turn]
        kernels._sort_run(order, low, high, keys, np.zeros(count), np.zeros(count, dtype=np.int64))
        np.testing.assert_array_equal(order, expected)
        np.testing.assert_array_equal(keys, expected_keys)


def test_a_plan_parts_links_first_and_holds_every_triangle_once():
    rng = np.random.default_rng(6)
    group = np.sort(rng.integers(0, 6, 200))
    centres, middles = rng.normal(size=(200, 3)), rng.normal(size=(6, 3))
    order, right, start, count = np.arange(200), *np.zeros((3, 400), dtype=np.int64)
    nodes = kernels.plan(centres, group, middles, LEAF, order, right, start, count)
    assert sorted(order) == list(range(200))
    leaves = [(start[node], count[node]) for node in range(nodes) if count[node]]
    assert sum(many for _, many in leaves) == 200
    assert max(many for _, many in leaves) <= LEAF
    for first, many in leaves:
        assert len(set(group[order[first : first + many]])) == 1
    runs = 1 + int((np.diff(group[order]) != 0).sum())
    assert runs == len(set(group))


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.5), (-0.25, 0.1, 0.4), (0.0, 0.0, 0.02), (3.0, 0.0, 0.5)])
def test_beside_the_box_that_it_is_within_nothing_is_drawn(both, rng, shift):
    hand, _ = both
    whole, pose = (0, 0, CAMERA.width, CAMERA.height), poses.make_pose(poses.random_rotations(1, rng)[0], shift)
    drawn, box = hand.depth(CAMERA, pose, whole), hand.box_within(CAMERA, pose, whole)
    if box is None:
        assert not np.isfinite(drawn).any()
        return
    part = slice(box[1], box[3]), slice(box[0], box[2])
    np.testing.assert_allclose(hand.depth(CAMERA, pose, box), drawn[part], rtol=1e-12)
    drawn[part] = np.inf
    assert not np.isfinite(drawn).any()
