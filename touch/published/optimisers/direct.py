"""DIRECT (Jones, Perttunen, Stuckman 1993; Gablonsky and Kelley 2001) on the compiled cost of T1 eq. 4.1, as in T1
table 5.2: scipy's implementation over a box of rotation vectors and positions, then one polish.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.multistart import refine_contacts
from touch.published.answers import conclude
from touch.published.optimisers.costs import pose_of, surface_cost

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoxSettings:
    """The box that a global optimiser searches, and its work. Values by judgement."""

    # Half widths without a prior: rotation vectors (rad) and the object's place about the contacts' mean, in radii.
    angle: float = float(np.pi)
    share: float = 1.0
    # With a prior: so many of its standard deviations.
    sigmas: float = 3.0
    # Cost evaluations, and w_n of eq. 4.1 (m).
    evaluations: int = 40_000
    normal_weight: float = 0.1


def objective(
    model: ObjectModel, contacts: Contacts, prior: Prior | None, settings: BoxSettings
) -> tuple[Callable[[Array], float], list[tuple[float, float]], Callable[[Array], Array]]:
    """Cost of x (6,) = (rotation vector, position), its bounds, and x -> pose (4, 4) contacts_frame_from_object."""
    start = se3.make_pose() if prior is None else prior.pose
    local = contacts.moved(se3.inverse(start))
    pivot = local.points.mean(axis=0) if prior is None else model.centroid
    points, normals = np.ascontiguousarray(local.points - pivot), np.nan_to_num(local.normals)
    field, centroid = model.field, model.centroid
    if prior is None:
        half = np.array([settings.angle] * 3 + [settings.share * model.radius] * 3)
    else:
        # contacts are turned and moved as the prior's pose sees them: the box has the object's axes
        own = np.kron(np.eye(2), start[:3, :3])
        half = settings.sigmas * np.sqrt(np.diag(own.T @ covariance_of(model, prior.information) @ own))
        half[:3] = np.minimum(half[:3], settings.angle)

    def cost(x: Array) -> float:
        angle = float(np.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]))
        q = np.array([np.cos(0.5 * angle), 0.0, 0.0, 0.0])
        q[1:] = x[:3] * (np.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5)
        weight = settings.normal_weight
        return float(
            surface_cost(field.values, field.origin, field.spacing, centroid, points, normals, weight, q, x[3:])
        )

    def pose(x: Array) -> Array:
        q = se3.to_quaternion(se3.exp_rotation(x[:3]))
        return pose_of(q, x[3:], centroid, pivot, start)

    return cost, [(-h, h) for h in half], pose


def localize(
    model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None, extra: Evidence | None
) -> Localization:
    """The method behind `touch.localize(method="direct")`; deterministic, the seed changes nothing."""
    from scipy.optimize import direct

    model.field  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    settings = BoxSettings()
    cost, bounds, pose = objective(model, contacts, prior, settings)
    found = direct(
        cost, bounds, maxfun=settings.evaluations, maxiter=settings.evaluations, vol_tol=0.0, locally_biased=False
    )
    polished = refine_contacts(model, contacts, pose(found.x)[None]).poses
    return conclude(model, contacts, polished, "direct", begin, None, extra)
