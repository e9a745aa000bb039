"""Rotations at and near 0 and pi, a million composed steps, poses 10 km from the origin. Metres, radians."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, apart, at_most, is_rigid, is_sound, need, refuses
from scenes.evidence.align import Prior, align, terms
from scenes.evidence.table import empty, from_contacts
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library

Array = NDArray[np.float64]

CASES = Cases()

# Angles about which formulas divide by nothing: 0, and pi where the axis is lost in the antisymmetric part.
ANGLES = (0.0, 5e-324, 1e-300, 1e-160, 1e-16, 1e-12, 1e-9, 1e-8, 9.9e-5, 1e-4, 1.1e-4, 1e-3, 0.1, 1.0, 2.0, 3.0)
BELOW_PI = (0.0, 1e-16, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2)
FAR = 1e4


def _vectors() -> Array:
    """Rotation vectors (n, 3) of all those angles about axes, diagonals and random directions."""
    rng = np.random.default_rng(0)
    corners = np.array(
        [[x, y, z] for x in (-1.0, 0, 1) for y in (-1.0, 0, 1) for z in (-1.0, 0, 1) if (x, y, z) != (0, 0, 0)]
    )
    axes = np.concatenate([corners / np.linalg.norm(corners, axis=1, keepdims=True), se3.random_unit_vectors(40, rng)])
    angles = np.array([*ANGLES, *(np.pi - below for below in BELOW_PI)])
    return (axes[:, None] * angles[:, None]).reshape(-1, 3)


@CASES("rotations", "off orthonormal")
def nearest_rotation_of_a_mirror() -> float:
    """Noisy matrices go to a rotation; mirrors and flat ones are refused."""
    rng = np.random.default_rng(5)
    turned = se3.random_rotations(50, rng)
    flat, mirrors = turned * [1.0, 1.0, 0.0], turned * [1.0, 1.0, -1.0]
    for matrix in (*mirrors, *flat):
        refuses(partial(se3.project_to_rotation, matrix), "a mirror or a flat matrix")
    matrices = turned + 0.1 * rng.normal(size=turned.shape)
    return is_rigid(se3.make_poses(se3.project_to_rotation(matrices), np.zeros((len(matrices), 3))))


@CASES("rotations", "worst error of exp and log, rad")
def exp_and_log_near_0_and_pi() -> float:
    """log(exp(v)) is v, at pi perhaps the other way round; exp is a rotation; angles are exact."""
    vectors = _vectors()
    rotations = se3.exp_rotation(vectors)
    is_rigid(se3.make_poses(rotations, np.zeros((len(vectors), 3))), "exp")
    back = se3.log_rotation(rotations)
    need(np.isfinite(back).all(), "log: not finite")
    there, opposite = (np.linalg.norm(back - sign * vectors, axis=1) for sign in (1.0, -1.0))
    at_pi = np.linalg.norm(vectors, axis=1) > np.pi - 1e-7
    angle = np.abs(se3.rotation_angle(rotations) - np.linalg.norm(vectors, axis=1))
    at_most(angle, 1e-14 * 100, "rotation_angle")
    return at_most(np.where(at_pi, np.minimum(there, opposite), there), 1e-12, "log(exp(v)) - v")


@CASES("rotations", "worst relative error of the angle")
def angles_keep_their_digits_when_tiny() -> float:
    """A turn of 1e-12 rad is not 0 and not 1e-8."""
    angles = np.array([1e-300, 1e-100, 1e-15, 1e-12, 1e-9, 1e-6])
    rotations = se3.exp_rotation(angles[:, None] * np.array([0.6, 0.0, 0.8]))
    got = se3.log_rotation(rotations)[:, 2] / 0.8  # a norm would lose 1e-300 when it squares it
    return at_most(np.abs(got - angles) / angles, 1e-9, "angle")


@CASES("rotations", "worst error of SE(3) exp and log")
def twists_near_0_and_pi() -> float:
    """SE(3): log(exp(x)) is x with translations of 1 mm to 1 km."""
    vectors = _vectors()
    vectors = vectors[np.linalg.norm(vectors, axis=1) < np.pi - 1e-7]
    worst = 0.0
    for length in (1e-3, 1.0, 1e3):
        twists = np.concatenate([vectors, length * np.tile([0.3, -0.9, 0.4], (len(vectors), 1))], axis=1)
        back = se3.log(se3.exp(twists))
        worst = max(worst, at_most(np.abs(back[:, 3:] - twists[:, 3:]) / length, 1e-9, f"translation of {length} m"))
        at_most(np.abs(back[:, :3] - twists[:, :3]), 1e-9, "rotation")
    return worst


@CASES("rotations", "worst error of perturb and difference")
def perturbations_near_0_and_pi() -> float:
    """difference() undoes perturb() about any pose and centre."""
    vectors = _vectors()
    vectors = vectors[np.linalg.norm(vectors, axis=1) < np.pi - 1e-7]
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(3):
        pose = se3.make_pose(se3.random_rotations(1, rng)[0], rng.normal(size=3))
        centre = rng.normal(size=3) * 0.1
        delta = np.concatenate([vectors, rng.normal(size=vectors.shape) * 0.1], axis=1)
        back = se3.difference(se3.perturb(pose, delta, centre), pose, centre)
        worst = max(worst, at_most(np.abs(back - delta), 1e-9, "difference(perturb(x)) - x"))
    return worst


@CASES("rotations", "worst relative error of the prior's gradient")
def prior_half_a_turn_away() -> float:
    """A prior up to pi away: cost, gradient and Hessian stay finite, and the gradient is that of the cost."""
    model = library.make("l_block")
    prior = Prior.isotropic(np.eye(4), 0.2, 0.02)
    worst = 0.0
    for angle in (0.0, 1e-9, 1e-4, 9.9e-4, 1.1e-3, 1.0, np.pi - 1e-2, np.pi - 1e-6, np.pi - 1e-9, np.pi):
        pose = se3.perturb(np.eye(4), [0.6 * angle, 0, 0.8 * angle, 0.01, 0, 0], model.centroid)
        cost, gradient, hessian = terms(model, empty(), pose, prior)
        need(np.isfinite(cost) and np.isfinite(gradient).all() and np.isfinite(hessian).all(), f"angle {angle}")
        at_most(np.abs(hessian - hessian.T), 1e-9 * np.abs(hessian).max(), "asymmetry of the Hessian")
        if angle > np.pi - 1e-4:
            continue  # the cost has a cusp there: no gradient to compare with
        step = 1e-6
        numeric = np.zeros(6)
        for i in range(6):
            delta = np.zeros(6)
            delta[i] = step
            ahead, behind = (
                terms(model, empty(), se3.perturb(pose, s * delta, model.centroid), prior)[0] for s in (1, -1)
            )
            numeric[i] = (ahead - behind) / (2 * step)
        worst = max(worst, at_most(np.abs(gradient - numeric) / (1 + np.abs(numeric)), 1e-3, f"gradient at {angle}"))
    return worst


@CASES("rotations", "worst error of the pose, rad", over=(0.0, 1e-9, 1e-4, np.pi - 1e-9, np.pi))
def objects_turned_by(angle: float) -> float:
    """The aligner finds an object that is turned by 0 or pi about any axis, from 10 degrees and 1 cm away."""
    model = library.make("l_block")
    contacts = Contacts(*model.sample_surface(30, seed=2), 1e-4, 0.02)
    rng = np.random.default_rng(3)
    worst = 0.0
    for axis in np.concatenate([np.eye(3), se3.random_unit_vectors(3, rng)]):
        truth = se3.make_pose(se3.exp_rotation(angle * axis), [0.1, -0.2, 0.5])
        starts = np.array([se3.displaced(truth, np.deg2rad(10), 0.01, model.centroid, rng) for _ in range(8)])
        found = align(model, from_contacts(contacts.moved(truth)), starts)
        is_rigid(found.poses, "aligned")
        best = found.poses[int(np.argmin(found.costs))]
        worst = max(worst, at_most(apart(model, best, truth)[0], 0.02, f"about {axis.round(2)}"))
    return worst


@CASES("composition", "off orthonormal after 1e5 steps")
def increments_stay_rigid(blocks: int = 10) -> float:
    """10^4 products of small turns and moves a block: no drift out of SE(3)."""
    rng = np.random.default_rng(4)
    pose, worst = np.eye(4), 0.0
    for _ in range(blocks):
        steps = se3.exp(rng.normal(size=(10_000, 6)) * 1e-2)
        for step in steps:
            pose = step @ pose
        need(np.isfinite(pose).all(), "not finite")
        gram = pose[:3, :3].T @ pose[:3, :3]
        worst = max(worst, float(np.abs(gram - np.eye(3)).max()))
    is_rigid(se3.check_pose(pose))
    return at_most(worst, 1e-10, "off orthonormal")


@CASES("composition", "off orthonormal after 1e6 steps", slow=True)
def a_million_increments_stay_rigid() -> float:
    """10^6 of them."""
    return increments_stay_rigid(100)


@CASES("composition", "worst distance from the identity")
def increments_and_their_inverses_cancel() -> float:
    """10^4 steps there and back."""
    rng = np.random.default_rng(5)
    steps = se3.exp(rng.normal(size=(10_000, 6)) * 0.1)
    pose = np.eye(4)
    for step in steps:
        pose = pose @ step
    for step in se3.inverse(steps)[::-1]:
        pose = pose @ step
    return at_most(np.abs(pose - np.eye(4)).max(), 1e-7, "there and back")


@CASES("composition", "off orthonormal after 200 alignments")
def alignment_after_alignment_stays_rigid() -> float:
    """What one alignment returns is the start of the next, 200 times, each pushed off its minimum."""
    model = library.make("l_block")
    rows = from_contacts(Contacts(*model.sample_surface(12, seed=1), 1e-3, 0.1))
    rng = np.random.default_rng(6)
    poses, worst = np.eye(4)[None], 0.0
    for _ in range(200):
        pushed = se3.perturb(poses, rng.normal(size=6) * ([0.05] * 3 + [2e-3] * 3), model.centroid)
        poses = align(model, rows, pushed).poses
        worst = max(worst, is_rigid(poses))
    return worst


def _contacts_far_away(model: ObjectModel, shift: Array) -> tuple[Contacts, Array]:
    truth = se3.make_pose(se3.exp_rotation(np.array([0.4, -1.0, 0.3])), shift + np.array([0.1, 0.0, 0.6]))
    return Contacts(*model.sample_surface(25, seed=4), 1e-3, 0.1).moved(truth), truth


@CASES("far away", "distance from the same near the origin, m")
def contacts_ten_kilometres_away() -> float:
    """Touch alone, 10 km from the origin of its frame: as near the truth as at the origin."""
    from touch.localization import localize

    model = library.make("l_block")
    shift = FAR * np.array([1.0, -0.5, 0.3])
    near, _ = _contacts_far_away(model, np.zeros(3))
    far, far_truth = _contacts_far_away(model, shift)
    first, second = localize(model, near, seed=0), localize(model, far, seed=0)
    is_sound(second)
    need(first.verdict == second.verdict == "ok", f"verdicts {first.verdict}, {second.verdict}")
    at_most(apart(model, second.pose, far_truth)[1], 5e-4, "error")
    return at_most(np.abs(second.pose[:3, 3] - shift - first.pose[:3, 3]).max(), 1e-6, "moved by the shift")


@CASES("far away", "distance from the same near the origin, m")
def a_robot_ten_kilometres_from_its_world() -> float:
    """The world's origin is 10 km off, the camera sees the object before it: the estimate is as if it were not."""
    from fusion.estimation.estimate import estimate

    model = library.make("l_block")
    felt, truth = _contacts_far_away(model, np.zeros(3))
    answers = []
    for shift in (np.zeros(3), FAR * np.array([1.0, -0.5, 0.3])):
        world_from_camera = se3.make_pose(se3.exp_rotation(np.array([0.2, 0.1, -0.7])), shift)
        frame = Frame(0, camera_from_world=se3.inverse(world_from_camera), contacts=felt.moved(world_from_camera))
        answers.append(estimate(frame, model))
    is_sound(answers[1])
    at_most(apart(model, answers[1].pose, truth)[1], 5e-4, "error")
    return at_most(apart(model, answers[1].pose, answers[0].pose)[1], 1e-6, "moved")


@CASES("far away", "difference of the distances, m")
def a_mesh_ten_kilometres_from_its_origin() -> float:
    """A scan in map coordinates: the lattice is centred, so distances are those of the mesh at home."""
    model = library.make("l_block")
    shift = FAR * np.array([1.0, -0.5, 0.3])
    there = ObjectModel.from_mesh(model.vertices + shift, model.faces, "far")
    points = model.sample_surface(2000, seed=0)[0] + np.random.default_rng(0).normal(size=(2000, 3)) * 0.005
    at_most(np.abs(there.centroid - shift - model.centroid), 1e-6, "centroid")
    at_most(abs(there.volume / model.volume - 1), 1e-6, "volume")
    difference = there.field.distance(points + shift) - model.field.distance(points)
    exact = there.surface.closest(points + shift)[0] - model.surface.closest(points)[0]
    at_most(np.abs(exact).max(), 1e-5, "exact distances")
    return at_most(np.abs(difference).max(), 5e-5, "distances")


@CASES("far away", "error of the pose, m")
def a_far_mesh_is_found() -> float:
    """Touch alone on that mesh; the centroid, not the mesh's origin, is what covariances speak of."""
    from touch.localization import localize

    home = library.make("l_block")
    shift = FAR * np.array([1.0, -0.5, 0.3])
    model = ObjectModel.from_mesh(home.vertices + shift, home.faces, "far")
    truth = se3.make_pose(translation=-shift) @ np.eye(4)
    contacts = Contacts(*home.sample_surface(25, seed=4), 1e-3, 0.1)
    found = localize(model, contacts, seed=0)
    is_sound(found)
    need(found.verdict == "ok", f"verdict {found.verdict}")
    return at_most(apart(model, found.pose, truth)[1], 5e-4, "error")
