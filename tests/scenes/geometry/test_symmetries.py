"""Symmetries: the closed forms against brute force over sampled members."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.geometry import poses
from scenes.geometry.symmetries import Axis, Symmetries

seeds = st.integers(0, 2**32 - 1)


def cyclic(order):
    turns = poses.exp_rotation(np.linspace(0, 2 * np.pi, order, endpoint=False)[:, None] * np.array([0.0, 0.0, 1.0]))
    return Symmetries(poses.make_poses(turns, np.zeros((order, 3))))


AXIS = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
GROUPS = {
    "square prism": cyclic(4),
    "cone": Symmetries.about_axis(AXIS, (0.01, 0.02, -0.03)),
    "cylinder": Symmetries.about_axis([0, 0, 1], (0.0, 0.01, 0.05), flip=True),
    "tilted cylinder": Symmetries.about_axis(AXIS, (0.01, 0.02, -0.03), flip=True),
}


def draw_pose(rng):
    return poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)) * 0.1)[0]


def angle_between(a, b):
    return float(poses.rotation_angle(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3]).min())


@pytest.mark.parametrize("name", GROUPS)
@given(seed=seeds)
def test_nearest_is_never_beaten_by_a_sampled_member(name, seed):
    group, rng = GROUPS[name], np.random.default_rng(seed)
    pose, reference = draw_pose(rng), draw_pose(rng)
    best = group.nearest(pose, reference)
    sampled = pose @ group.poses(steps=180)
    assert angle_between(best, reference) <= angle_between(sampled, reference) + 1e-9
    # and it is close to the best sample, as far as two degrees of sampling allow
    assert angle_between(best, reference) > angle_between(sampled, reference) - np.deg2rad(1.01)


@pytest.mark.parametrize("name", GROUPS)
@given(seed=seeds)
def test_nearest_is_an_equivalent_of_the_pose(name, seed):
    group, rng = GROUPS[name], np.random.default_rng(seed)
    pose, reference = draw_pose(rng), draw_pose(rng)
    member = poses.inverse(pose) @ group.nearest(pose, reference)
    points = rng.normal(size=(5, 3)) * 0.1
    moved = poses.apply(member, points)
    for axis in group.axes:
        # a rotation about the line, perhaps upside down: heights and distances from the line stay
        before, after = points - axis.point, moved - axis.point
        height, raised = before @ axis.direction, after @ axis.direction
        assert np.allclose(np.abs(height), np.abs(raised), atol=1e-12)
        assert np.allclose(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1), atol=1e-12)
    if not group.axes:
        assert np.abs(group.discrete - member).max(axis=(1, 2)).min() < 1e-12


@pytest.mark.parametrize("name", GROUPS)
@given(seed=seeds)
def test_an_equivalent_pose_has_no_error(name, seed):
    group, rng = GROUPS[name], np.random.default_rng(seed)
    reference = draw_pose(rng)
    members = group.poses(steps=17)
    pose = reference @ members[rng.integers(len(members))]
    assert np.allclose(group.nearest(pose, reference), reference, atol=1e-9)


@given(seed=seeds)
def test_a_sphere_has_no_rotation_error(seed):
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=3) * 0.05
    sphere = Symmetries(axes=tuple(Axis(centre, d) for d in np.eye(3)))
    assert sphere.is_spherical
    pose, reference = draw_pose(rng), draw_pose(rng)
    best = sphere.nearest(pose, reference)
    assert np.allclose(best[:3, :3], reference[:3, :3])
    assert np.allclose(poses.apply(best, centre[None]), poses.apply(pose, centre[None]), atol=1e-12)


@pytest.mark.parametrize("axes", [2, 3])
def test_samples_of_a_sphere_cover_all_rotations(axes):
    sphere = Symmetries(axes=tuple(Axis(np.zeros(3), d) for d in np.eye(3)[:axes]))
    samples = sphere.poses(steps=12)
    targets = poses.random_rotations(50, np.random.default_rng(0))
    worst = max(angle_between(samples, target[None]) for target in targets)
    assert worst < np.deg2rad(45)


def test_nearest_takes_stacks_of_poses(rng):
    group = GROUPS["tilted cylinder"]
    stack = np.array([draw_pose(rng) for _ in range(6)])
    reference = draw_pose(rng)
    together = group.nearest(stack, reference)
    assert np.allclose(together, [group.nearest(p, reference) for p in stack], atol=1e-14)
    assert np.array_equal(Symmetries.none().nearest(stack, reference), stack)


def test_what_a_group_is():
    assert Symmetries.none().is_trivial
    assert not GROUPS["cone"].is_trivial
    assert not GROUPS["cone"].is_spherical
    assert not cyclic(2).is_trivial
    assert GROUPS["cylinder"].poses(steps=10).shape == (20, 4, 4)
    assert np.allclose(GROUPS["cylinder"].poses(steps=10)[0], np.eye(4))


BALL = Symmetries(axes=(Axis(np.array([0.01, 0.0, 0.02]), AXIS), Axis(np.array([0.01, 0.0, 0.02]), np.eye(3)[0])))


@pytest.mark.parametrize("group", [Symmetries.none(), GROUPS["tilted cylinder"], BALL])
@given(seed=seeds)
def test_the_quotient_is_the_nearest_of_a_small_motion(group, seed):
    rng = np.random.default_rng(seed)
    pose, centre = draw_pose(rng), rng.normal(size=3) * 0.05
    delta = 1e-4 * rng.normal(size=6)
    nearest = group.nearest(poses.perturb(pose, delta, centre), pose)
    left = group.quotient(pose[:3, :3], centre) @ delta
    assert np.allclose(left, poses.difference(nearest, pose, centre), atol=1e-7)
