"""Levenberg-Marquardt with a forward-difference Jacobian and a pseudo-inverse on neighbourhoods, as published (T1 eqs.
2.30, 2.31, 3.3, 3.5). The package's own refinement, analytic and batched, is `touch.multistart.refine_contacts`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.published.answers import conclude
from touch.published.optimisers.costs import RegionSettings, region_costs, regions_about, start_of
from touch.published.optimisers.gradient_descent import forward_jacobian, normalise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LevenbergMarquardtSettings:
    """T1 eq. 2.30. Values by judgement where no source is named."""

    # w_n of eq. 3.5, square centimetres; 0 is eq. 3.3.
    normal_weight: float = 20.0
    # First lambda, the factor it is divided or multiplied by, and where it ends the work (T1 section 2.6.2.2).
    damping: float = 1e-2
    factor: float = 10.0
    largest_damping: float = 1e100
    # h of the forward difference (eq. 2.28): quaternion units and centimetres.
    difference: float = 1e-5
    # max_i and eps_g (square centimetres) of the stopping rule.
    iterations: int = 200
    accuracy: float = 1e-4
    # Singular values below this share of the largest are zeros to the pseudo-inverse (eq. 2.31).
    rank_tolerance: float = 1e-10
    regions: RegionSettings = field(default_factory=RegionSettings)


@numba.njit(cache=True, nogil=True)
def iterate(
    contacts: Array,
    normals: Array,
    first: NDArray[np.int64],
    cloud: Array,
    cloud_normals: Array,
    normal_weight: float,
    damping: float,
    factor: float,
    largest_damping: float,
    step: float,
    iterations: int,
    accuracy: float,
    rank_tolerance: float,
    x: Array,
) -> int:
    """T1 eq. 2.30 from x (7,) in place; returns the iterations used. A step that raises the error is rejected."""
    m = contacts.shape[0]
    costs, other, jacobian = np.zeros(m), np.zeros(m), np.zeros((m, 7))
    region_costs(x, contacts, normals, first, cloud, cloud_normals, normal_weight, costs)
    fresh = True
    normal, right = np.zeros((7, 7)), np.zeros(7)
    for i in range(iterations):
        if costs.max() < accuracy or damping > largest_damping:
            return i
        if fresh:
            forward_jacobian(
                x, costs, step, contacts, normals, first, cloud, cloud_normals, normal_weight, jacobian, other
            )
            normal = jacobian.T @ jacobian
            right = jacobian.T @ costs
        damped = normal.copy()
        for j in range(7):
            damped[j, j] += damping * normal[j, j]
        if not np.isfinite(damped).all():
            return i
        trial = x - np.linalg.pinv(damped, rank_tolerance) @ right
        normalise(trial)
        region_costs(trial, contacts, normals, first, cloud, cloud_normals, normal_weight, other)
        fresh = (other * other).sum() < (costs * costs).sum()
        if fresh:
            x[:] = trial
            costs[:] = other
            damping /= factor
        else:
            damping *= factor
    return iterations


def refine(
    model: ObjectModel,
    contacts: Contacts,
    start: Array,
    seed: int = 0,
    settings: LevenbergMarquardtSettings | None = None,
) -> tuple[Array, int]:
    """Pose (4, 4) contacts_frame_from_object reached from `start`, and the iterations it took. seed: of the cloud."""
    settings = settings or LevenbergMarquardtSettings()
    regions = regions_about(model, contacts, start, seed, settings.regions)
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    used = iterate(
        *regions.arguments,
        settings.normal_weight,
        settings.damping,
        settings.factor,
        settings.largest_damping,
        settings.difference,
        settings.iterations,
        settings.accuracy,
        settings.rank_tolerance,
        x,
    )
    return regions.pose(x), int(used)


def localize(
    model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None, extra: Evidence | None
) -> Localization:
    """The method behind `touch.localize(method="levenberg-marquardt")`: local, starts at the prior's mean."""
    model.field  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    pose, _ = refine(model, contacts, start_of(model, contacts, seed, prior), seed)
    return conclude(model, contacts, pose[None], "levenberg-marquardt", begin, prior, extra)
