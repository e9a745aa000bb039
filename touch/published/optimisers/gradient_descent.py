"""Gradient descent with a forward-difference Jacobian on neighbourhoods, as published (T1 sections 2.6.2.2 and 3.2)."""

from __future__ import annotations

import math
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
from touch.published.optimisers.costs import CENTIMETRES, RegionSettings, region_costs, regions_about, start_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GradientDescentSettings:
    """T1 eq. 2.29. Values by judgement where no source is named."""

    # w_n of eq. 3.5, square centimetres; 0 is eq. 3.3.
    normal_weight: float = 20.0
    # lambda (no unit): "defined experimentally"; the largest of 1, 2, 5 x 10^k at which cube and cylinder do not
    # diverge.
    rate: float = 5e-4
    # h of the forward difference (eq. 2.28): quaternion units and centimetres.
    difference: float = 1e-5
    # max_i and eps_g (square centimetres) of the stopping rule.
    iterations: int = 200
    accuracy: float = 1e-4
    regions: RegionSettings = field(default_factory=RegionSettings)
    # A fixed rate may diverge, each step longer than the last: it ends where the next one would lead farther than this,
    # in metres. Squares of it still fit into the single precision of the tree that answers distances to the mesh.
    farthest: float = 1e18


@numba.njit(cache=True, nogil=True)
def forward_jacobian(
    x: Array,
    costs: Array,
    step: float,
    contacts: Array,
    normals: Array,
    first: NDArray[np.int64],
    cloud: Array,
    cloud_normals: Array,
    normal_weight: float,
    jacobian: Array,
    other: Array,
) -> None:
    """T1 eq. 2.28: fills jacobian (m, 7) from costs (m,) at x (7,); other (m,) is working room."""
    for j in range(7):
        kept = x[j]
        x[j] = kept + step
        region_costs(x, contacts, normals, first, cloud, cloud_normals, normal_weight, other)
        x[j] = kept
        for k in range(costs.shape[0]):
            jacobian[k, j] = (other[k] - costs[k]) / step


@numba.njit(cache=True, nogil=True)
def normalise(x: Array) -> None:
    """Give the quaternion of x (7,) unit length."""
    length = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
    for j in range(4):
        x[j] /= length


@numba.njit(cache=True, nogil=True)
def is_within(x: Array, farthest: float) -> bool:
    """True when x (7,) has a quaternion that can be normalised, and moves by no more than `farthest` along any axis."""
    length = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3]
    good = 0.0 < length < math.inf  # False for NaN
    for j in range(4, 7):
        good = good and abs(x[j]) <= farthest
    return good


@numba.njit(cache=True, nogil=True)
def descend(
    contacts: Array,
    normals: Array,
    first: NDArray[np.int64],
    cloud: Array,
    cloud_normals: Array,
    normal_weight: float,
    rate: float,
    step: float,
    iterations: int,
    accuracy: float,
    farthest: float,
    x: Array,
) -> int:
    """T1 eq. 2.29 from x (7,) in place; returns the iterations used. Ends before a step beyond farthest (cm)."""
    m = contacts.shape[0]
    costs, other, jacobian = np.zeros(m), np.zeros(m), np.zeros((m, 7))
    for i in range(iterations):
        region_costs(x, contacts, normals, first, cloud, cloud_normals, normal_weight, costs)
        if costs.max() < accuracy:
            return i
        forward_jacobian(x, costs, step, contacts, normals, first, cloud, cloud_normals, normal_weight, jacobian, other)
        before = x.copy()
        for j in range(7):
            for k in range(m):
                x[j] -= rate * jacobian[k, j] * costs[k]
        if not is_within(x, farthest):
            x[:] = before
            return i
        normalise(x)
    return iterations


def refine(
    model: ObjectModel,
    contacts: Contacts,
    start: Array,
    seed: int = 0,
    settings: GradientDescentSettings | None = None,
) -> tuple[Array, int]:
    """Pose (4, 4) contacts_frame_from_object reached from `start`, and the iterations it took. seed: of the cloud."""
    settings = settings or GradientDescentSettings()
    regions = regions_about(model, contacts, start, seed, settings.regions)
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    used = descend(
        *regions.arguments,
        settings.normal_weight,
        settings.rate,
        settings.difference,
        settings.iterations,
        settings.accuracy,
        CENTIMETRES * settings.farthest,
        x,
    )
    return regions.pose(x), int(used)


def localize(
    model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None, extra: Evidence | None
) -> Localization:
    """The method behind `touch.localize(method="gradient-descent")`: local, starts at the prior's mean."""
    model.field  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    pose, _ = refine(model, contacts, start_of(model, contacts, seed, prior), seed)
    return conclude(model, contacts, pose[None], "gradient-descent", begin, prior, extra)
