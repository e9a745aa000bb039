"""Contacts to benchmark with: scattered over an object or where a hand's fingertips touched it, noise, errors, limits.

Angles in radians, lengths in metres. A trial is a truth (4, 4), noisy contacts in its frame, and a rough start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Prior, align, costs, terms
from scenes.evidence.modes import Mode, covariance_of
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis.noise.presets import TouchNoise, observe_contacts

Array = NDArray[np.float64]

# T1 section 4.3: sigma of points (m) and normals (rad).
NOISES = {
    "none": TouchNoise(point=0.0, normal=0.0),
    "0.9 mm, 5°": TouchNoise(point=0.9e-3, normal=float(np.deg2rad(5.0))),
    "1.8 mm, 10°": TouchNoise(point=1.8e-3, normal=float(np.deg2rad(10.0))),
}
# T1's success: closer than 1 cm and 15 degrees.
CLOSE = (float(np.deg2rad(15.0)), 0.010)
# Its coarse start: 33.2 mm and 16 degrees.
START = (float(np.deg2rad(16.0)), 0.0332)


@dataclass(frozen=True)
class Trial:
    """truth and start (4, 4) contacts_frame_from_object; contacts with their noise."""

    truth: Array
    contacts: Contacts
    start: Array


@cache
def grasp_contacts(name: str, seed: int) -> Contacts | None:
    """Exact contacts (object frame) of a simulated five-finger grasp of a library object; None when none was found."""
    from scenes.synthesis import library
    from scenes.synthesis.grasping.grasps import plan_grasp
    from scenes.synthesis.hands import five_finger_hand

    try:
        grasp = plan_grasp(five_finger_hand(), library.make(name), seed=seed)
    except InputError:
        return None
    return grasp.contacts.moved(se3.inverse(grasp.hand_from_object))


def trials(
    model: ObjectModel, contacts: int, noise: TouchNoise, count: int, seed: int, grasps: int = 0
) -> Iterator[Trial]:
    """`count` trials of so many contacts: scattered evenly over the surface, or with `grasps` > 0 those of that many
    simulated grasps with at least so many touching fingers, in turn.
    """
    grasped = (grasp_contacts(model.name, s) for s in range(grasps))
    held = [one for one in grasped if one is not None and len(one) >= contacts]
    if grasps and not held:
        return
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        if held:
            whole = held[i % len(held)]
            exact = whole.take(np.sort(rng.choice(len(whole), contacts, replace=False)))
        else:
            exact = Contacts(*model.sample_surface(contacts, seed=int(rng.integers(2**31))))
        truth = se3.make_pose(se3.random_rotations(1, rng)[0], rng.normal(size=3) * 0.1)
        felt = observe_contacts(exact.moved(truth), noise, rng)
        yield Trial(truth, felt, se3.displaced(truth, *START, model.centroid, rng))


def start_prior(start: Array) -> Prior:
    """The start (4, 4) as a Gaussian whose mean error is T1's."""
    # mean length of three standard normal numbers
    mean = 2.0 * np.sqrt(2.0 / np.pi)
    return Prior.isotropic(start, START[0] / mean, START[1] / mean)


def errors(model: ObjectModel, pose: Array, truth: Array) -> tuple[float, float]:
    """Rotation (rad) and displacement of the centroid (m), modulo the object's symmetries."""
    delta = se3.difference(model.symmetries.nearest(pose, truth), truth, model.centroid)
    return float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:]))


def is_close(error: tuple[float, float]) -> bool:
    """T1's success."""
    return error[0] < CLOSE[0] and error[1] < CLOSE[1]


def is_optimal(model: ObjectModel, contacts: Contacts, pose: Array, truth: Array, prior: Prior | None = None) -> bool:
    """Whether the contacts (and prior) speak for the estimate at least as much as for the truth: the search did its
    part.
    """
    estimate, best = costs(model, tables.from_contacts(contacts), np.array([pose, truth]), prior)
    return bool(estimate <= best + 1e-6)


def from_truth(model: ObjectModel, contacts: Contacts, truth: Array) -> Array:
    """The minimum next to the truth (4, 4): what an oracle that starts there makes of the same contacts."""
    return align(model, tables.from_contacts(contacts), truth[None]).poses[0]


# Samples of the surface that the exact likelihood of a contact is summed over, and how many poses stand for a mode.
SURFACE_SAMPLES, MODE_SAMPLES = 120_000, 64


@cache
def _surface_tree(model: ObjectModel) -> tuple[Array, Any]:
    from scipy.spatial import cKDTree

    points, normals = model.sample_surface(SURFACE_SAMPLES, seed=1)
    return normals, cKDTree(points)


def log_likelihood(model: ObjectModel, contacts: Contacts, poses: Array) -> Array:
    """(b,) log likelihoods of scattered contacts at poses (b, 4, 4), up to one constant, as the trials draw them.

    Any point of the surface may have been touched: the noise's density is summed over the whole of it, where an
    estimator looks only at the nearest point. sigma_point and sigma_normal must be above 0.
    """
    normals, tree = _surface_tree(model)
    inverses = np.array([se3.inverse(pose) for pose in poses])
    points = se3.apply(inverses, contacts.points)
    total = np.zeros(len(poses))
    for k in range(len(contacts)):
        sigma, sigma_normal = contacts.sigma_point[k], contacts.sigma_normal[k]
        normal = inverses[:, :3, :3] @ contacts.normals[k]
        away, near = tree.query(points[:, k], k=64, distance_upper_bound=4.5 * sigma)
        there = np.isfinite(away)
        cosine = np.einsum("bki,bi->bk", normals[np.where(there, near, 0)], normal)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        log = -0.5 * (np.where(there, away, 0.0) / sigma) ** 2 - 0.5 * (angle / sigma_normal) ** 2
        # a floor: no contact may rule a pose out alone by more than the samples can tell
        total += np.maximum(np.logaddexp.reduce(np.where(there, log, -np.inf), axis=1), -60.0)
    return total


def likeliest(model: ObjectModel, contacts: Contacts, modes: Sequence[Mode], truth: Array) -> Array:
    """Pose (4, 4) of the mode to which the exact likelihood of the contacts gives most, the truth's own among them.

    What no estimator can beat by more than chance: it knows how the contacts were drawn and which poses to weigh up.
    """
    near = from_truth(model, contacts, truth)
    information = terms(model, tables.from_contacts(contacts), near)[2]
    rng = np.random.default_rng(0)
    best, chosen = -np.inf, near
    for pose, covariance in [(m.pose, m.covariance) for m in modes] + [(near, covariance_of(model, information))]:
        values, vectors = np.linalg.eigh(covariance)
        draws = rng.normal(size=(MODE_SAMPLES, 6)) * np.sqrt(np.maximum(values, 0.0))
        draws[0] = 0.0
        fit = float(log_likelihood(model, contacts, se3.perturb(pose, draws @ vectors.T, model.centroid)).max())
        if fit > best:
            best, chosen = fit, pose
    return chosen


def bound(model: ObjectModel, contacts: Contacts, truth: Array) -> tuple[float, float]:
    """Cramér-Rao bound at the truth: RMS rotation (rad) and displacement (m); infinite when a direction is free.

    Inverse of the Fisher information, the Gauss-Newton Hessian of the contacts at the truth; a turn about the
    object's axis of symmetry is no error and is left out.
    """
    information = terms(model, tables.from_contacts(contacts), truth)[2]
    keep = np.eye(6)
    if model.symmetries.is_spherical:
        keep = keep[:, 3:]
    elif model.symmetries.axes:
        axis = truth[:3, :3] @ model.symmetries.axes[0].direction
        keep = np.concatenate([np.linalg.svd(axis[None])[2][1:], np.zeros((2, 3))], axis=1).T
        keep = np.concatenate([keep, np.eye(6)[:, 3:]], axis=1)
    reduced = keep.T @ information @ keep
    scale = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    normed = reduced / scale / scale[:, None]
    if np.linalg.eigvalsh(normed)[0] < 1e-9:
        return float("inf"), float("inf")
    covariance = keep @ (np.linalg.inv(normed) / scale / scale[:, None]) @ keep.T
    return float(np.sqrt(np.trace(covariance[:3, :3]))), float(np.sqrt(np.trace(covariance[3:, 3:])))


def cube(side: float = 0.06) -> ObjectModel:
    """T1's cube: edges of 6 cm, its 24 rotations as symmetries."""
    from itertools import permutations, product

    from scenes.geometry.symmetries import Symmetries
    from scenes.synthesis import shapes

    half = 0.5 * side
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    vertices, faces = shapes.extrude(corners, side)
    turns = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            rotation = np.zeros((3, 3))
            rotation[range(3), order] = signs
            if np.linalg.det(rotation) > 0:
                turns.append(rotation)
    turns.sort(key=lambda r: -float(np.trace(r)))
    model = ObjectModel.from_mesh(vertices, faces, name="cube")
    centre = model.centroid
    members = [se3.make_pose(r, centre - r @ centre) for r in turns]
    model.symmetries = replace(Symmetries.none(), discrete=np.array(members))
    return model
