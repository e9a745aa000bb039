"""Rigid transforms against pytransform3d, and the identities that define them."""

import numpy as np
import pytest
import pytransform3d.rotations as reference_rotations
import pytransform3d.transformations as reference
from hypothesis import given
from hypothesis import strategies as st
from pytransform3d.batch_rotations import matrices_from_quaternions

from scenes.errors import InputError
from scenes.geometry import poses, rotation_kernels

unit = st.floats(-1.0, 1.0, allow_nan=False)
vectors = st.tuples(unit, unit, unit).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def direction(seed):
    return poses.random_unit_vectors(1, np.random.default_rng(seed))[0]


@st.composite
def rotation_vectors(draw):
    """Four regimes: uniform angles, small tangents, within 1e-7 of the identity, within 1e-7 of half a turn."""
    axis = direction(draw(seeds))
    share = draw(st.floats(0.0, 1.0))
    regime = draw(st.sampled_from(["uniform", "tangent", "identity", "half turn"]))
    angle = {
        "uniform": share * 3.1,
        "tangent": 1e-3 * share,
        "identity": 1e-7 * share,
        "half turn": np.pi - 1e-7 * share,
    }[regime]
    return angle * axis


@st.composite
def twists(draw):
    return np.concatenate([draw(rotation_vectors()), draw(vectors)])


@st.composite
def transforms(draw):
    return poses.exp(draw(twists()))


def same_rotation_vector(a, b, tolerance):
    """Half a turn about an axis is half a turn about its opposite."""
    if np.linalg.norm(a) > 3.0 and a @ b < 0:
        b = b - 2 * np.pi * b / np.linalg.norm(b)
    return np.allclose(a, b, rtol=0, atol=tolerance)


@given(transforms())
def test_inverse_undoes(pose):
    assert np.allclose(poses.inverse(pose) @ pose, np.eye(4), atol=1e-14)
    assert np.allclose(poses.inverse(pose), reference.invert_transform(pose), atol=1e-14)


@given(transforms(), transforms(), transforms())
def test_composition(a, b, c):
    assert np.allclose((a @ b) @ c, a @ (b @ c), atol=1e-13)
    assert np.allclose(poses.inverse(a @ b), poses.inverse(b) @ poses.inverse(a), atol=1e-13)
    points = c[:3, :3]
    assert np.allclose(poses.apply(a @ b, points), poses.apply(a, poses.apply(b, points)), atol=1e-13)


@given(twists())
def test_exp_is_the_exponential_of_the_reference(twist):
    ours = poses.exp(twist)
    assert np.isfinite(ours).all()
    assert np.allclose(ours[:3, :3].T @ ours[:3, :3], np.eye(3), atol=1e-14)
    # its reference is a matrix exponential of the full 4x4, without branches
    from scipy.linalg import expm

    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = poses.skew(twist[:3]), twist[3:]
    assert np.allclose(ours, expm(matrix), atol=1e-13)


@given(twists())
def test_log_inverts_exp(twist):
    back = poses.log(poses.exp(twist))
    assert np.isfinite(back).all()
    assert same_rotation_vector(twist[:3], back[:3], 1e-11)
    assert np.allclose(poses.exp(back), poses.exp(twist), atol=1e-11)


def test_a_turn_by_more_than_numbers_hold_is_none():
    """One vector as many of them: no error from deep inside."""
    with np.errstate(all="ignore"):
        many = poses.exp_rotation(np.full((1, 3), 1e200))[0]
    assert np.isnan(poses.exp_rotation([1e200, 1e200, 1e200])).all()
    assert np.isnan(many).all()


@given(rotation_vectors())
def test_log_keeps_relative_digits_near_the_identity(vector):
    back = poses.log_rotation(poses.exp_rotation(vector))
    assert same_rotation_vector(vector, back, max(1e-22, 3e-15 * min(1.0, np.linalg.norm(vector) * 1e3)))


@given(st.tuples(seeds, st.floats(0.0, 3.0), vectors))
def test_log_agrees_with_the_reference(drawn):
    seed, angle, move = drawn
    pose = poses.exp(np.concatenate([angle * direction(seed), move]))
    theirs = reference.exponential_coordinates_from_transform(pose)
    assert np.allclose(poses.log(pose), theirs, atol=1e-6)


def test_log_of_many_random_poses_agrees_with_the_reference():
    rng = np.random.default_rng(0)
    rotations = poses.random_rotations(300, rng)
    stack = poses.make_poses(rotations, rng.normal(size=(300, 3)))
    ours = poses.log(stack)
    theirs = np.array([reference.exponential_coordinates_from_transform(p) for p in stack])
    near_pi = np.linalg.norm(ours[:, :3], axis=1) > 3.1
    assert np.allclose(ours[~near_pi], theirs[~near_pi], atol=1e-9)


@given(rotation_vectors(), rotation_vectors())
def test_quaternions_round_trip_and_agree_with_the_reference(a, b):
    rotation = poses.exp_rotation(a) @ poses.exp_rotation(b)
    q = poses.to_quaternion(rotation)
    assert np.isfinite(q).all()
    assert q[0] >= 0
    assert np.allclose(poses.from_quaternion(q), rotation, atol=1e-13)
    assert np.allclose(matrices_from_quaternions(q[None])[0], rotation, atol=1e-13)
    assert np.allclose(poses.from_quaternion(-3 * q), rotation, atol=1e-13)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_about_the_axes_have_no_singular_quaternion(axis):
    rotation = poses.exp_rotation(np.pi * axis)
    assert np.allclose(np.abs(poses.to_quaternion(rotation)[1:]), axis, atol=1e-15)
    assert poses.rotation_angle(rotation) == pytest.approx(np.pi, abs=1e-15)


@given(rotation_vectors())
def test_rotation_angle(vector):
    assert poses.rotation_angle(poses.exp_rotation(vector)) == pytest.approx(np.linalg.norm(vector), abs=4e-15)


@given(transforms(), twists())
def test_adjoint_moves_a_twist_through_a_pose(pose, twist):
    left = pose @ poses.exp(twist) @ poses.inverse(pose)
    assert np.allclose(left, poses.exp(poses.adjoint(pose) @ twist), atol=1e-11)
    assert np.allclose(poses.adjoint(pose), reference.adjoint_from_transform(pose), atol=1e-14)


@given(transforms(), twists(), vectors)
def test_difference_inverts_perturb(pose, delta, centre):
    moved = poses.perturb(pose, delta, centre)
    back = poses.difference(moved, pose, centre)
    assert same_rotation_vector(delta[:3], back[:3], 1e-11)
    assert np.allclose(back[3:], delta[3:], atol=1e-13)
    assert np.allclose(poses.perturb(pose, back, centre), moved, atol=1e-11)


@given(transforms(), rotation_vectors(), vectors, vectors)
def test_perturb_turns_about_the_centre(pose, turn, move, centre):
    moved = poses.perturb(pose, np.concatenate([turn, move]), centre)
    assert np.allclose(poses.apply(moved, centre[None]), poses.apply(pose, centre[None]) + move, atol=1e-13)


@given(seeds, st.floats(0.0, 3.1), st.floats(0.0, 1.0))
def test_displaced_by_exactly_the_asked_amount(seed, angle, distance):
    rng = np.random.default_rng(seed)
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    centre = rng.normal(size=3)
    delta = poses.difference(poses.displaced(pose, angle, distance, centre, rng), pose, centre)
    assert np.linalg.norm(delta[:3]) == pytest.approx(angle, abs=1e-12)
    assert np.linalg.norm(delta[3:]) == pytest.approx(distance, abs=1e-12)


def test_functions_take_batches():
    rng = np.random.default_rng(1)
    twist = rng.normal(size=(4, 5, 6))
    stack = poses.exp(twist)
    assert stack.shape == (4, 5, 4, 4)
    for i in np.ndindex(4, 5):
        assert np.allclose(stack[i], poses.exp(twist[i]), atol=1e-15)  # one rotation is made without arrays
        assert np.allclose(poses.log(stack)[i], poses.log(stack[i]), atol=1e-14)
        assert np.allclose(poses.adjoint(stack)[i], poses.adjoint(stack[i]), atol=1e-15)
        assert np.allclose(poses.inverse(stack)[i], poses.inverse(stack[i]), atol=1e-15)
    assert poses.apply(stack[0], rng.normal(size=(7, 3))).shape == (5, 7, 3)


def test_random_rotations_are_uniform():
    # for uniform rotations the angle's density is (1 - cos a) / pi: the mean angle is pi / 2 + 2 / pi
    angles = poses.rotation_angle(poses.random_rotations(40_000, np.random.default_rng(2)))
    assert angles.mean() == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.01)
    assert np.linalg.norm(poses.random_rotations(40_000, np.random.default_rng(3)).mean(axis=0)) < 0.03


@given(rotation_vectors(), st.floats(0.0, 5e-5), seeds)
def test_check_pose_mends_round_off_only(vector, size, seed):
    pose = poses.make_pose(poses.exp_rotation(vector), [1.0, 2.0, 3.0])
    rough = pose.copy()
    rough[:3, :3] += size * 0.3 * np.random.default_rng(seed).uniform(-1, 1, size=(3, 3))
    clean = poses.check_pose(rough)
    assert np.allclose(clean[:3, :3].T @ clean[:3, :3], np.eye(3), atol=1e-14)
    reference_rotations.check_matrix(clean[:3, :3])
    assert np.allclose(clean, pose, atol=2 * size + 1e-15)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p[:3], r"4x4 transform, got shape \(3, 4\)"),
        (lambda p: np.where(np.eye(4) == 1, np.nan, p), "4 not finite"),
        (lambda p: p + np.eye(4)[3][:, None] * 0.1, "last row"),
        (lambda p: np.diag([1.001, 1.001, 1.001, 1.0]) @ p, "off orthonormal by 0.002"),
        (lambda p: np.diag([-1.0, 1.0, 1.0, 1.0]) @ p, "mirrored"),
    ],
)
def test_check_pose_refuses(spoil, message):
    pose = poses.make_pose(poses.exp_rotation([0.1, 0.2, 0.3]), [0.0, 1.0, 2.0])
    with pytest.raises(InputError, match=f"start: .*{message}"):
        poses.check_pose(spoil(pose), "start")


def test_one_rotation_is_what_it_is_among_many():
    rng = np.random.default_rng(5)
    vectors = rng.normal(size=(200, 3)) * np.geomspace(1e-9, 3.1, 200)[:, None]
    turns = poses.exp_rotation(vectors)
    for vector, turn, quaternion in zip(vectors, turns, poses.to_quaternion(turns)):
        assert np.allclose(poses.exp_rotation(vector), turn, atol=2e-15)
        assert np.allclose(poses.to_quaternion(turn), quaternion, atol=2e-15)
    half = poses.exp_rotation(np.pi * np.eye(3))
    assert np.allclose([poses.to_quaternion(turn) for turn in half], poses.to_quaternion(half), atol=1e-15)


@given(seeds)
def test_what_rounding_bent_is_straightened(seed):
    rng = np.random.default_rng(seed)
    exact = poses.random_rotations(5, rng)
    bent = exact + 1e-8 * rng.normal(size=exact.shape)
    found = poses.straightened(bent)
    assert np.abs(np.swapaxes(found, 1, 2) @ found - np.eye(3)).max() < 1e-14
    np.testing.assert_allclose(found, poses.project_to_rotation(bent), atol=1e-14)


@pytest.mark.parametrize("shapes", [((), ()), ((), (5,)), ((5,), (5,)), ((4, 1), (4, 3)), ((3,), ()), ((0,), (0,))])
def test_many_poses_move_and_differ_as_plain_arrays_have_it(shapes):
    rng = np.random.default_rng(3)
    held, moved = shapes
    pose = poses.exp(rng.normal(size=(*held, 6)))
    delta, centre = rng.normal(size=(*moved, 6)), rng.normal(size=3)
    found = poses.perturb(pose, delta, centre)
    rotation = poses.exp_rotation(delta[..., :3]) @ pose[..., :3, :3]
    middle = pose[..., :3, :3] @ centre + pose[..., :3, 3] + delta[..., 3:]
    assert found.shape == (*np.broadcast_shapes(held, moved), 4, 4)
    assert np.allclose(found[..., :3, :3], rotation, atol=1e-14)
    assert np.allclose(found[..., :3, 3], middle - rotation @ centre, atol=1e-13)
    assert (found[..., 3, :] == [0.0, 0.0, 0.0, 1.0]).all()
    back = poses.difference(found, pose, centre)
    turned = poses.log_rotation(rotation @ np.swapaxes(pose[..., :3, :3], -1, -2))
    assert np.allclose(back[..., :3], turned, atol=1e-12)
    assert np.allclose(back[..., 3:], np.broadcast_to(delta[..., 3:], back[..., 3:].shape), atol=1e-13)


def test_poses_taken_apart_and_put_together_for_kernels():
    rng = np.random.default_rng(4)
    stack, centroid = poses.exp(rng.normal(size=(6, 6))), rng.normal(size=3)
    rotations, middles, out = np.zeros((6, 3, 3)), np.zeros((6, 3)), np.zeros((6, 4, 4))
    assert rotation_kernels.split(stack, centroid, rotations, middles)
    assert np.array_equal(rotations, stack[:, :3, :3])
    assert np.allclose(middles, poses.apply(stack, centroid[None])[:, 0], atol=1e-14)
    rotation_kernels.joined(rotations + 1e-9, middles, centroid, out)
    straight = poses.straightened(rotations + 1e-9)
    assert np.allclose(out[:, :3, :3], straight, atol=1e-15)
    assert np.allclose(out[:, :3, 3], middles - straight @ centroid, atol=1e-14)
    assert np.array_equal(out[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (6, 1)))
    stack[3, 1, 2] = np.nan
    assert not rotation_kernels.split(stack, centroid, rotations, middles)


def test_covariances_in_other_axes_and_about_other_points():
    """Against perturbed poses themselves, which are moved and measured there."""
    rng = np.random.default_rng(5)
    root = 1e-3 * rng.normal(size=(6, 6))
    pose, move = poses.exp(rng.normal(size=6)), poses.exp(rng.normal(size=6))
    centroid = np.array([0.03, -0.02, 0.05])
    deltas = rng.normal(size=(40000, 6)) @ root.T
    drawn = poses.perturb(pose, deltas, centroid)
    covariance = np.cov(deltas.T)
    moved = np.cov(poses.difference(move @ drawn, move @ pose, centroid).T)
    np.testing.assert_allclose(poses.turned_covariance(covariance, move), moved, rtol=1e-6, atol=1e-12)
    about_origin = np.cov(poses.difference(drawn, pose, np.zeros(3)).T)
    shifted = poses.shifted_covariance(covariance, -pose[:3, :3] @ centroid)
    np.testing.assert_allclose(shifted, about_origin, atol=3e-3 * np.abs(about_origin).max())
    several = poses.turned_covariance(np.stack([covariance, covariance]), move)
    np.testing.assert_allclose(several[1], poses.turned_covariance(covariance, move))
    with pytest.raises(InputError, match=r"offset: expected an array of shape \(3,\), got shape \(4,\)"):
        poses.shifted_covariance(covariance, np.zeros(4))


@pytest.mark.parametrize(
    ("rotation", "translation", "told"),
    [
        ([0.1, 0.2, 0.3], None, r"rotation: expected an array of shape \(3, 3\) \(from_quat.* got shape \(3,\)"),
        ([1.0, 0, 0, 0], None, r"rotation: expected .*, got shape \(4,\)"),
        (None, np.eye(3), r"translation: expected an array of shape \(3,\), got shape \(3, 3\)"),
        (None, 0.3, r"translation: expected .*, got shape \(\)"),
    ],
)
def test_a_pose_is_made_of_a_matrix_and_a_place(rotation, translation, told):
    """Three angles were taken for three equal rows."""
    with pytest.raises(InputError, match=told):
        poses.make_pose(rotation, translation)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 1.0, -1.0]), "expected a determinant of 1, got 0 or below: is an axis mirrored"),
        (np.zeros((3, 3)), "expected a determinant of 1, got 0 or below"),
        (1e3 * np.eye(3), r"expected lengths kept within a factor of 2, got 1e\+03 to 1e\+03"),
        (np.full((3, 3), np.nan), r"expected finite matrices \(..., 3, 3\)"),
        (np.eye(4), r"expected finite matrices \(..., 3, 3\), got float64 of shape \(4, 4\)"),
    ],
)
def test_what_no_rounding_makes_is_no_rotation(matrix, message):
    with pytest.raises(InputError, match=message):
        poses.project_to_rotation(matrix)
    np.testing.assert_allclose(poses.project_to_rotation(1.02 * np.eye(3)), np.eye(3), atol=1e-15)
