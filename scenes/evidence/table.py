"""The one table: points that must lie on the object's surface, or outside it.

Every sense writes rows of the same kind, in one frame (the camera's), metres:

    a depth pixel         ON the surface, unless it belongs to something in front (gate above)
    a fingertip contact   ON the surface, with the outward normal when known
    an inactive taxel, a link that feels nothing, free space before an observed depth   OUTSIDE
    a mask's pixel whose ray passes the object by       not so far outside (gate below 0)

A row's residual is r = (d(p) - offset) / sigma with d the signed distance of the point from the object.
Its loss is that of a point that is either on the object (a unit Gaussian in r) or clutter (a flat density,
met where |r| = gate): rho(s) = s - 2 log(1 + exp((s - gate^2) / 2)) + const, s = r^2 (+ the normal's part). The
derivative of rho is the probability that the row belongs to the object, so fitting *is* deciding.
A pixel was seen, so the surface there faces the camera: rows with `facing` carry the viewing ray (unit) in the
normal's place, and d is the distance to the side of the object that faces it
(scenes.geometry.lattice.seen_distance_at). Without it a thin wall's far side would explain a point as well as its near
side. So it is with a contact whose normal is known: the finger came from where that points to, and `facing` rows with
a normal are led out along it. `gate_above` holds for points found outside (d > offset), `gate_below` for points found
inside: what is seen or felt in front of an object may be something else, but nothing opaque is ever inside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry.poses import FARTHEST
from scenes.recordings.frames import SIGMAS, Contacts

Array = NDArray[np.float64]

VISION, TOUCH = 0, 1

# Columns of the packed table that the kernels read.
POINT, NORMAL = slice(0, 3), slice(3, 6)
SIGMA, SIGMA_NORMAL, WEIGHT, GATE_ABOVE, GATE_BELOW, OFFSET, FACING = 6, 7, 8, 9, 10, 11, 12
COLUMNS = 13

# A gate that no residual reaches: the row is trusted whatever it says.
NO_GATE = 1e30


@dataclass(frozen=True)
class Evidence:
    """rows (n, 13) float64: point, outward normal (0 when unknown), sigma (m), sigma of the normal (rad, 0 = none),
    weight (share of a row's information that is its own, 1 = independent), gate above and below (sigmas; 0 = the
    row says nothing on that side), offset (m), facing (1 = reached from where the normal points, or along the ray).
    sense (n,): VISION or TOUCH.
    """

    rows: Array
    sense: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def points(self) -> Array:
        """(n, 3) metres."""
        return self.rows[:, POINT]

    @property
    def on(self) -> NDArray[np.bool_]:
        """(n,) whether a row lies ON the surface: the others say something on one side of it alone."""
        return (self.rows[:, GATE_ABOVE] > 0.0) & (self.rows[:, GATE_BELOW] > 0.0)

    @cached_property
    def is_sound(self) -> bool:
        """Whether all of it is finite numbers in as many columns as there are: looked at once."""
        # a number that is not finite makes their sum so: no array of answers
        return self.rows.ndim == 2 and self.rows.shape[1] == COLUMNS and math.isfinite(self.rows.sum())

    def take(self, index: ArrayLike) -> Evidence:
        """Rows by index or mask."""
        index = np.asarray(index)
        index = index if index.size else index.astype(np.intp)
        return Evidence(np.ascontiguousarray(self.rows[index]), self.sense[index])

    def of(self, sense: int) -> Evidence:
        """Rows of one sense."""
        return self.take(self.sense == sense)

    def reweighted(self, factor: ArrayLike) -> Evidence:
        """The same rows with their weights multiplied, scalar or (n,)."""
        rows = self.rows.copy()
        rows[:, WEIGHT] *= np.asarray(factor, dtype=np.float64)
        return Evidence(rows, self.sense)

    def with_sigma(self, sigma: float, sense: int) -> Evidence:
        """The same rows with another sigma (m) for one sense."""
        rows = self.rows.copy()
        rows[self.sense == sense, SIGMA] = sigma
        return Evidence(rows, self.sense)

    def widened(self, sigma: ArrayLike) -> Evidence:
        """The same rows with an independent error of this sigma (m) more, scalar or (n,)."""
        rows = self.rows.copy()
        rows[:, SIGMA] = np.hypot(rows[:, SIGMA], sigma)
        return Evidence(rows, self.sense)

    def gated(self, gate: float) -> Evidence:
        """No row trusted farther than `gate` sigmas, where it is as likely clutter; the others as they are."""
        rows = self.rows.copy()
        both = [GATE_ABOVE, GATE_BELOW]
        rows[:, both] = np.minimum(rows[:, both], gate)
        return Evidence(rows, self.sense)

    def moved(self, target_from_source: Array) -> Evidence:
        """The same rows in another frame."""
        rows = self.rows.copy()
        rows[:, POINT] = self.rows[:, POINT] @ target_from_source[:3, :3].T + target_from_source[:3, 3]
        rows[:, NORMAL] = self.rows[:, NORMAL] @ target_from_source[:3, :3].T
        return Evidence(rows, self.sense)


def empty() -> Evidence:
    """A table without rows."""
    return Evidence(np.zeros((0, COLUMNS)), np.zeros(0, dtype=np.uint8))


def stack(*tables: Evidence) -> Evidence:
    """All rows of all tables, in order."""
    return Evidence(np.concatenate([t.rows for t in tables]), np.concatenate([t.sense for t in tables]))


def make(
    points: ArrayLike,
    sigma: ArrayLike,
    sense: int,
    *,
    normals: Array | None = None,
    sigma_normal: ArrayLike = 0.0,
    weight: ArrayLike = 1.0,
    gate_above: ArrayLike = NO_GATE,
    gate_below: ArrayLike = NO_GATE,
    offset: ArrayLike = 0.0,
    rays: Array | None = None,
    from_outside: bool = False,
) -> Evidence:
    """Rows from columns: points (n, 3) metres; every other argument a scalar or (n,). NaN normals mean unknown.
    rays (n, 3): unit viewing directions of pixels, instead of normals. from_outside: what is there was touched from the
    side that its normal points to.

    Raises InputError when a point is not finite (or beyond poses.FARTHEST), or a sigma is not positive.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.size and points.shape[-1] != 3:
        raise InputError(f"evidence: expected points of shape (n, 3), got {points.shape}")
    points = points.reshape(-1, 3)
    n = len(points)
    good = np.abs(points) < FARTHEST  # not true of NaN either
    if not good.all():
        raise InputError(f"evidence: expected finite points, got {int((~good).any(axis=1).sum())} bad rows")
    rows = np.zeros((n, COLUMNS))
    rows[:, POINT] = points
    rows[:, SIGMA] = sigma
    rows[:, WEIGHT], rows[:, GATE_ABOVE], rows[:, GATE_BELOW], rows[:, OFFSET] = weight, gate_above, gate_below, offset
    if n and not ((rows[:, SIGMA] >= SIGMAS[0]) & (rows[:, SIGMA] <= SIGMAS[1])).all():
        raise InputError(
            f"evidence: expected sigma above 0 m, from {SIGMAS[0]:g} to {SIGMAS[1]:g}, got {rows[:, SIGMA]}"
        )
    if normals is not None:
        known = np.isfinite(normals).all(axis=1)
        rows[known, NORMAL] = normals[known]
        rows[:, SIGMA_NORMAL] = np.where(known, sigma_normal, 0.0)
        rows[:, FACING] = known & from_outside & (rows[:, SIGMA_NORMAL] > 0)
    if rays is not None:
        rows[:, NORMAL], rows[:, FACING] = rays, 1.0
    return Evidence(rows, np.full(n, sense, dtype=np.uint8))


def from_contacts(contacts: Contacts, gate: ArrayLike = NO_GATE, use_normals: bool = True) -> Evidence:
    """ON rows of contacts, in their frame; `gate` in sigmas, () or (n,), is where one is as likely a false one."""
    return make(
        contacts.points,
        contacts.sigma_point,
        TOUCH,
        normals=contacts.normals if use_normals else None,
        sigma_normal=contacts.sigma_normal,
        gate_above=gate,
        gate_below=gate,
        from_outside=True,
    )


def outside(
    points: ArrayLike, sigma: ArrayLike, sense: int, radius: ArrayLike = 0.0, gate: float = NO_GATE
) -> Evidence:
    """OUTSIDE rows: the object's surface is at least `radius` (m) away from each point (n, 3)."""
    return make(points, sigma, sense, gate_above=0.0, gate_below=gate, offset=radius)
