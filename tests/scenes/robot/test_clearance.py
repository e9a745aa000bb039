"""What compiled loops leave out changes no distance: NumPy over all samples, pieces and joints says the same."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scenes.geometry import lattice, poses
from scenes.robot.fingers import Clearance, close, find_fingers
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.closing import EXACT_BELOW, ExactClosing, _points_to_links
from scenes.synthesis.grasping.placement import PlacementSettings, across_palm, open_hand
from scenes.synthesis.gripper import parallel_gripper
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make

# Rounding of a metre: another order of sums, where a processor cannot round a product and a sum at once.
EXACT = 1e-13
SPACING = 0.006


@pytest.fixture(scope="module")
def hand() -> Hand:
    return five_finger_hand()


@pytest.fixture
def held(hand, rng):
    """Postures of a hand around a mug, some of them in it."""
    model = make("mug")
    clearance = Clearance(hand, model, SPACING)
    placed, q = across_palm(clearance, 6, rng, PlacementSettings())
    return model, clearance, placed, q + rng.uniform(0.0, 0.5, q.shape)


def all_links(hand: Hand, values):
    """hand_from_link (l, 4, 4) of values of all moving joints, one joint after the other (Rodrigues)."""
    out = [np.eye(4)]
    for i, joint in enumerate(hand.robot.joints):
        local = joint.parent_from_joint.copy()
        if joint.name in hand._moving_names:
            value = values[hand._moving_names[joint.name]]
            if joint.kind == "prismatic":
                local[:3, 3] += local[:3, :3] @ (value * joint.axis)
            else:
                local[:3, :3] = local[:3, :3] @ poses.exp_rotation(value * np.asarray(joint.axis))
        out.append(out[hand._parents[i]] @ local)
    return np.array(out)


@pytest.mark.parametrize("maker", [five_finger_hand, parallel_gripper])
def test_links_are_where_each_joint_puts_them(maker, rng):
    hand = maker()
    q = rng.uniform(-0.6, 1.2, (4, len(hand.joint_names)))
    found = hand.link_poses(q.reshape(2, 2, -1))
    assert found.shape == (2, 2, len(hand.link_names), 4, 4)
    for one, frames in zip(q, found.reshape(4, -1, 4, 4)):
        values = one @ hand._coupling.T + hand._coupling_offset
        np.testing.assert_allclose(frames, all_links(hand, values), rtol=0, atol=EXACT)
        np.testing.assert_array_equal(frames, hand.link_poses(one))


def test_a_block_bounds_the_distances_in_it(rng):
    field = make("mug").field
    low, high, last, origin, spacing = field.blocks
    ends = origin + spacing * (np.array(field.values.shape) - 1.0)
    edge = rng.integers(0, field.values.shape, (500, 3)) * spacing + origin
    points = np.concatenate([rng.uniform(origin - 0.1, ends + 0.1, (5000, 3)), edge, edge + 1e-5, ends[None]])
    bounds = np.array([lattice.bounds_at(low, high, last, origin, spacing, *point) for point in points])
    distance = field.distance(points)
    assert (bounds[:, 0] <= distance + 1e-9).all()
    assert (bounds[:, 1] >= distance - 1e-9).all()
    assert np.mean(bounds[:, 1] - bounds[:, 0]) < 4 * lattice.BLOCK * spacing


def all_samples(clearance: Clearance, q, placed):
    """Clearance of links (n, l) from every sample and every point of the tips' cores."""
    frames = poses.inverse(placed)[:, None] @ clearance.hand.link_poses(q)
    links = np.full(frames.shape[:2], np.inf)
    for begin, end, row in zip(clearance._starts, clearance._starts[1:], clearance._links):
        for n in range(len(q)):
            own = poses.apply(frames[n, row], clearance._points[begin:end])
            links[n, row] = clearance.model.field.distance(own).min()
    tips = np.zeros((len(q), len(clearance.fingers)))
    for f, finger in enumerate(clearance.fingers):
        for n in range(len(q)):
            core = poses.apply(frames[n, finger.tip_link], clearance._cores[f])
            tips[n, f] = clearance.model.field.distance(core).min() - finger.tip.rounding
        links[:, finger.tip_link] = np.minimum(links[:, finger.tip_link], tips[:, f])
    return links, tips


def test_samples_left_out_are_not_the_nearest(held):
    _, clearance, placed, q = held
    links, tips = clearance.links_and_tips(q, placed)
    wanted, tips_wanted = all_samples(clearance, q, placed)
    np.testing.assert_allclose(links, wanted, rtol=0, atol=EXACT)
    np.testing.assert_allclose(tips, tips_wanted, rtol=0, atol=EXACT)
    assert (links < 0).any()
    assert (links > 0.01).any()
    least = clearance.least(clearance.hand.link_poses(q), placed)
    np.testing.assert_allclose(least, wanted.min(axis=1), rtol=0, atol=EXACT)
    moved = np.zeros(links.shape, dtype=bool)
    moved[:, clearance.fingers[0].tip_link] = True
    some, _ = clearance.links_and_tips(q, placed, moved)
    np.testing.assert_array_equal(some[moved], links[moved])
    assert (some >= links).all()


def test_fingers_that_stand_still_keep_their_distance(held, hand):
    _, clearance, placed, q = held
    speed = np.zeros(q.shape)
    for finger in clearance.fingers[::2]:
        speed[:, list(finger.closing)] = 1.0
    ends, links, _ = close(clearance, placed, np.clip(q - 0.5, *hand.limits.T), speed)
    np.testing.assert_allclose(links, all_samples(clearance, ends, placed)[0], rtol=0, atol=EXACT)


def least_in_pieces(hand: Hand, rows, frames, points):
    """Least distance of points from the convex pieces of links, of each those in its box."""
    smallest = np.inf
    for row in rows:
        local = (points - frames[row, :3, 3]) @ frames[row, :3, :3]
        for shape in list(hand.robot.links.values())[row]:
            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            low, high = shape.vertices.min(axis=0) - 0.002, shape.vertices.max(axis=0) + 0.002
            inside = local[((local > low) & (local < high)).all(axis=1)]
            if len(inside) and mesh.is_convex:
                offsets = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center)
                smallest = min(smallest, (inside @ mesh.face_normals.T - offsets).max(axis=1).min())
    return smallest


@pytest.mark.parametrize("count", [0, 1, 2, 40, 3000])
def test_points_against_convex_pieces(hand, rng, count):
    frames = hand.link_poses(open_hand(hand, 1, rng, PlacementSettings())[0])
    points = rng.uniform([-0.05, -0.06, -0.05], [0.2, 0.06, 0.08], (count, 3))
    for rows in (tuple(range(len(hand.link_names))), (3,), ()):
        wanted = least_in_pieces(hand, rows, frames, points)
        assert _points_to_links(hand, rows, frames, points) == pytest.approx(wanted, abs=EXACT)
        assert _points_to_links(hand, rows, frames, points, 0.001) == pytest.approx(min(wanted, 0.001), abs=EXACT)


def test_fine_samples_left_out_are_not_the_nearest(held, hand):
    model, _, placed, q = held
    exact = ExactClosing(hand, model, 0.003, 1e-3)
    rows = [finger.links for finger in find_fingers(hand)]
    for pose, one in zip(placed, q):
        frames = poses.inverse(pose) @ hand.link_poses(one)
        for own in rows:
            samples = np.concatenate([poses.apply(frames[row], exact._pieces[row]) for row in own])
            rough = model.field.distance(samples)
            near = np.abs(rough) < EXACT_BELOW
            wanted = rough[~near].min(initial=np.inf)
            if near.any():
                fine = model.surface.closest(samples[near])[0]
                fine = np.where(np.abs(rough[near]) > 3e-4, np.copysign(fine, rough[near]), fine)
                wanted = min(wanted, fine.min())
            assert exact._sample_clearance(frames, own) == pytest.approx(wanted, abs=1e-9)
