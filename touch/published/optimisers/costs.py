"""The cost functions of T1 as published, compiled: eqs. 3.3, 3.5 over neighbourhoods, eq. 4.1 over the whole surface.

A candidate x = (q, t) moves the contacts, not the object: a contact f (given relative to a pivot) goes to
q f q* + pivot + t in the object's frame, and the answer is the inverse of that motion. Local methods work in
centimetres as the thesis does (its w_n = 20 weighs an angle against square centimetres), the search of chapter 4 in
metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.lattice import distance_at
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts

Array = NDArray[np.float64]

CENTIMETRES = 100.0


@numba.njit(cache=True, nogil=True)
def rotate(q: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Q (x, y, z) q* for a unit quaternion q (4,), scalar first."""
    w, a, b, c = q[0], q[1], q[2], q[3]
    u = 2.0 * (b * z - c * y)
    v = 2.0 * (c * x - a * z)
    s = 2.0 * (a * y - b * x)
    return x + w * u + b * s - c * v, y + w * v + c * u - a * s, z + w * s + a * v - b * u


@numba.njit(cache=True, nogil=True)
def region_costs(
    x: Array,
    contacts: Array,
    normals: Array,
    first: NDArray[np.int64],
    cloud: Array,
    cloud_normals: Array,
    normal_weight: float,
    out: Array,
) -> None:
    """T1 eq. 3.5 (3.3 when normal_weight is 0) for a candidate x (7,): fills out (m,), one cost a contact.

    contacts (m, 3) and normals (m, 3) (zeros when unknown) relative to the pivot; region of contact k is
    cloud[first[k]:first[k + 1]], relative to the same pivot. x's quaternion need not have unit length.
    """
    length = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
    q = x[:4] / length
    for k in range(contacts.shape[0]):
        px, py, pz = rotate(q, contacts[k, 0], contacts[k, 1], contacts[k, 2])
        px, py, pz = px + x[4], py + x[5], pz + x[6]
        ux, uy, uz = rotate(q, normals[k, 0], normals[k, 1], normals[k, 2])
        # without a measured normal the angle has nothing to say
        weight = normal_weight if ux * ux + uy * uy + uz * uz > 0.5 else 0.0
        best = math.inf
        for i in range(first[k], first[k + 1]):
            dx, dy, dz = px - cloud[i, 0], py - cloud[i, 1], pz - cloud[i, 2]
            cost = dx * dx + dy * dy + dz * dz
            if weight > 0.0 and cost < best:
                along = ux * cloud_normals[i, 0] + uy * cloud_normals[i, 1] + uz * cloud_normals[i, 2]
                cost += weight * abs(1.0 - along)
            best = min(best, cost)
        out[k] = best


@numba.njit(cache=True, nogil=True)
def surface_cost(
    values: NDArray[np.float32],
    origin: Array,
    spacing: float,
    pivot: Array,
    contacts: Array,
    normals: Array,
    normal_weight: float,
    q: Array,
    t: Array,
) -> float:
    """T1 eq. 4.1, metres: sum over contacts of distance + normal_weight (1 - cosine), at the nearest surface point.

    The distance lattice stands in for the thesis's k-d tree; its gradient is the normal at the nearest point.
    """
    total = 0.0
    for k in range(contacts.shape[0]):
        px, py, pz = rotate(q, contacts[k, 0], contacts[k, 1], contacts[k, 2])
        d, gx, gy, gz = distance_at(
            values, origin, spacing, px + pivot[0] + t[0], py + pivot[1] + t[1], pz + pivot[2] + t[2]
        )
        total += abs(d)
        ux, uy, uz = rotate(q, normals[k, 0], normals[k, 1], normals[k, 2])
        if ux * ux + uy * uy + uz * uz > 0.5:
            length = max(math.sqrt(gx * gx + gy * gy + gz * gz), 1e-6)
            total += normal_weight * (1.0 - (ux * gx + uy * gy + uz * gz) / length)
    return total


@dataclass(frozen=True)
class RegionSettings:
    """Neighbourhoods of T1 section 3.2.1. Values by judgement: the thesis names none."""

    # Points of the object's cloud; the thesis speaks of thousands.
    cloud: int = 8000
    # eps_d (m) of T1 figure 3.2, and the fewest points a region has: eps_d grows until it holds them.
    radius: float = 0.015
    fewest: int = 60


@dataclass(frozen=True)
class Regions:
    """Contacts and the object's points near each, centimetres about the pivot (the centroid), object frame."""

    contacts: Array
    normals: Array
    first: NDArray[np.int64]
    cloud: Array
    cloud_normals: Array
    pivot: Array
    start: Array

    @property
    def arguments(self) -> tuple[Array, Array, NDArray[np.int64], Array, Array]:
        """As `region_costs` takes them."""
        return self.contacts, self.normals, self.first, self.cloud, self.cloud_normals

    def pose(self, x: Array) -> Array:
        """(4, 4) contacts_frame_from_object of a solution x (7,)."""
        return pose_of(x[:4], x[4:] / CENTIMETRES, self.pivot, self.pivot, self.start)


def regions_about(
    model: ObjectModel, contacts: Contacts, start: Array, seed: int = 0, settings: RegionSettings | None = None
) -> Regions:
    """The neighbourhoods of every contact with the object at `start` (4, 4)."""
    from scipy.spatial import cKDTree

    settings = settings or RegionSettings()
    cloud, cloud_normals = model.sample_surface(settings.cloud, seed)
    tree = cKDTree(cloud)
    local = contacts.moved(se3.inverse(start))
    fewest = min(settings.fewest, len(cloud))
    farthest = tree.query(local.points, k=[fewest])[0][:, 0]
    lists = tree.query_ball_point(local.points, np.maximum(farthest, settings.radius) * (1 + 1e-9))
    first = np.concatenate([[0], np.cumsum([len(one) for one in lists])]).astype(np.int64)
    index = np.concatenate([np.sort(one) for one in lists]).astype(np.int64)
    return Regions(
        CENTIMETRES * (local.points - model.centroid),
        np.nan_to_num(local.normals),
        first,
        np.ascontiguousarray(CENTIMETRES * (cloud[index] - model.centroid)),
        np.ascontiguousarray(cloud_normals[index]),
        model.centroid,
        start,
    )


def pose_of(q: Array, t: Array, pivot: Array, contact_pivot: Array, start: Array) -> Array:
    """(4, 4) contacts_frame_from_object: contacts seen from `start` and relative to contact_pivot went to q f q* +
    pivot + t (m).
    """
    rotation = se3.from_quaternion(q)
    moved = se3.make_pose(rotation, pivot + t - rotation @ contact_pivot)
    return start @ se3.inverse(moved)


def start_of(model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None) -> Array:
    """Where a local method starts: the prior's mean, else the centroid at the contacts' mean, turned at random."""
    if prior is not None:
        return prior.pose
    rotation = se3.random_rotations(1, np.random.default_rng(seed))[0]
    return se3.make_pose(rotation, contacts.points.mean(axis=0) - rotation @ model.centroid)
