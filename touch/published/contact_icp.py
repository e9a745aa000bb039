"""Iterative Closest Point on contacts: the batch baseline of T2 section 4.4.3 (Besl, McKay, IEEE T-PAMI 1992).

Every contact is paired with the nearest point of the object's surface and the rigid motion between the pairs is solved
in closed form (Arun, Huang, Blostein 1987). Local: it ends in the nearest minimum of where it starts. Metres.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.published.answers import localization

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactIcpSettings:
    """When it stops. Values by judgement."""

    # Pairings with nearest points, at most.
    iterations: int = 100
    # Mean distance falling by less than this share ends the work.
    tolerance: float = 1e-5
    # An index above this (m) is not a match; T2 saw no convergence without a prior.
    believed_sigma: float = 0.01


def rigid_fit(source: Array, target: Array) -> Array:
    """(4, 4) transform that takes points source (n, 3) nearest to target (n, 3) in the least-squares sense."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    rotation = se3.nearest_rotation((target - b).T @ (source - a))
    return se3.make_pose(rotation, b - rotation @ a)


def refine(
    model: ObjectModel, points: Array, start: Array, settings: ContactIcpSettings | None = None
) -> tuple[Array, int]:
    """Pose (4, 4) contacts_frame_from_object reached from `start`, and the iterations it took."""
    settings = settings or ContactIcpSettings()
    object_from_contacts = se3.inverse(start)
    before = np.inf
    for iteration in range(settings.iterations):
        moved = se3.apply(object_from_contacts, points)
        distance, _, foot = model.surface.closest(moved)
        mean = float(np.abs(distance).mean())
        if before - mean <= settings.tolerance * mean:
            return se3.inverse(object_from_contacts), iteration
        before = mean
        object_from_contacts = rigid_fit(points, foot)
    return se3.inverse(object_from_contacts), settings.iterations


def localize(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: ContactIcpSettings | None = None,
) -> Localization:
    """Localise by ICP from the prior's mean, else from one random rotation at the contacts' mean. Extra rows move
    no fit: they weigh modes, and narrow covariances.
    """
    settings = settings or ContactIcpSettings()
    model.surface  # noqa: B018  (building the search tree is not part of the search's time)
    begin = time.perf_counter()
    if prior is not None:
        start = prior.pose
    else:
        rotation = se3.random_rotations(1, np.random.default_rng(seed))[0]
        start = se3.make_pose(rotation, contacts.points.mean(axis=0) - rotation @ model.centroid)
    pose, _ = refine(model, contacts.points, start, settings)
    return localization(model, contacts, pose, pose[None], settings.believed_sigma, begin, "icp", prior, extra)
