"""Contacts to benchmark with: scattered over an object or where a hand's fingertips touched it, noise, errors, limits.

Angles in radians, lengths in metres. A trial is a truth (4, 4), noisy contacts in its frame, and a rough start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenes import evidence as tables
from scenes import poses as se3
from scenes.alignment.batch import Prior, align, costs, terms
from scenes.errors import InputError
from scenes.frames import Contacts
from scenes.noise import TouchNoise, observe_contacts
from scenes.objects import ObjectModel

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
    from scenes import library
    from scenes.grasping import plan_grasp
    from scenes.hand_generation import five_finger_hand

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

    from scenes import shapes
    from scenes.symmetries import Symmetries

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
