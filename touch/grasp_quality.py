"""How well contacts hold an object: its grasp wrench space, the largest ball about the origin, the volume (T1 sections
2.1 and 6.2.2; Ferrari & Canny, ICRA 1992).

A wrench is (force, torque / length) about the centre of mass, so that all six numbers are newtons; with the object's
radius as the length, the quality does not depend on its size. Every contact pushes with a normal force of at most 1 N.
Any frame, metres.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry.objects import ObjectModel

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

Array = NDArray[np.float64]

NORMS = ("l1", "linf")
# Coulomb's coefficient (no unit) of nothing that is touched dry: silicone has up to 3.
MOST_FRICTION = 100.0


@dataclass(frozen=True)
class WrenchSettings:
    """What a contact can do, and what is asked of all of them. Values by judgement where no source is named."""

    # Coulomb friction (no unit): between rubber and plastic or metal it is 0.4 to 0.9; cautious.
    friction: float = 0.5
    # Sides of the pyramid inside each friction cone; 8 lose 8 % of the tangential force at worst.
    edges: int = 8
    # Radius (m) of a soft fingertip's contact: with even pressure it resists a twist about the normal of
    # 2/3 friction radius per newton (Howe & Cutkosky 1996). 0: a hard point.
    soft_radius: float = 0.0
    # What is limited to 1 N: "l1" the sum of the normal forces (a hand with one motor), "linf" each of them.
    norm: str = "l1"
    # Balls (N, torques divided by the object's radius) smaller than this are round-off.
    smallest: float = 1e-7

    def __post_init__(self) -> None:
        """Refuse what is no contact."""
        if not 0 <= self.friction <= MOST_FRICTION:
            raise InputError(f"friction: expected a number from 0 to {MOST_FRICTION:g}, got {self.friction:g}")
        if not (np.isfinite(self.soft_radius) and self.soft_radius >= 0):
            raise InputError(f"soft finger: expected a radius from 0, got {self.soft_radius}")
        if self.edges < 3:
            raise InputError(f"edges: expected a friction pyramid of 3 sides or more, got {self.edges}")
        if self.norm not in NORMS:
            raise InputError(f"norm: expected one of {', '.join(NORMS)}, got {self.norm!r}")


@dataclass(frozen=True)
class Quality:
    """closure: whether every small push is balanced; epsilon: the largest one (N) that is balanced from every side, 0
    without closure; volume: of the space of wrenches with normal forces of 1 N in all (N^6); margin: epsilon, or
    without closure minus the distance (N) of the origin from what the contacts can do. weakest (6,): unit wrench, force
    then torque / length, that is resisted least; None for contacts that span fewer than 6 directions. why: in words.
    """

    closure: bool
    epsilon: float
    volume: float
    margin: float
    why: str
    weakest: Array | None = None

    @property
    def verdict(self) -> str:
        """In two or three words."""
        return "force closure" if self.closure else "no force closure"


def on_surface(model: ObjectModel, points: Array, normals: Array, back: float = 0.003) -> tuple[Array, Array]:
    """Feet (n, 3) of contacts on the mesh and its outward normals there, object frame.

    normals (n, 3): outward as sensed, NaN where unknown. A thin wall has two sides: the foot is looked for from `back`
    metres outside of where the contact's normal leaves.
    """
    if not len(points):
        return np.zeros((0, 3)), np.zeros((0, 3))
    known = np.isfinite(normals).all(axis=1, keepdims=True)
    outside = points + back * np.where(known, np.nan_to_num(normals), 0.0)
    _, gradient, foot = model.surface.closest(outside)
    return foot, gradient


def primitive_wrenches(
    points: ArrayLike, normals: ArrayLike, centre: ArrayLike, length: float, settings: WrenchSettings | None = None
) -> Array:
    """(n, k, 6) wrenches of a normal force of 1 N along each edge of each contact's friction pyramid, then, for a soft
    finger, along the normal with the twist that it can resist both ways.

    points (n, 3) m, normals (n, 3) outward of the object, centre (3,) of mass, length (m) that torques are divided by.
    The pyramids are turned towards the other contacts, so that the frame does not matter. Raises InputError for shapes
    that do not fit, numbers that are not finite, normals without length or a length that is not above 0.
    """
    settings = settings or WrenchSettings()
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    normals = np.asarray(normals, dtype=np.float64).reshape(-1, 3)
    centre = np.asarray(centre, dtype=np.float64)
    if points.shape != normals.shape or centre.shape != (3,):
        raise InputError(f"grasp: expected as many normals as points, got {points.shape} and {normals.shape}")
    size = np.linalg.norm(normals, axis=1)
    if not (np.isfinite(points).all() and np.isfinite(size).all() and np.isfinite(centre).all()):
        raise InputError("grasp: expected finite contacts and centre of mass, got NaN or infinity")
    if (size < 1e-9).any():
        raise InputError(f"grasp: expected normals, contact {int(np.argmin(size))} has one of length 0")
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"grasp: expected a length above 0 to divide torques by, got {length}")
    angle = 2.0 * np.pi * np.arange(settings.edges) / settings.edges
    circle = settings.friction * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    twist = 2.0 / 3.0 * settings.friction * settings.soft_radius / length
    out = np.zeros((len(points), settings.edges + (2 if twist > 0 else 0), 6))
    for i, (point, inward) in enumerate(zip(points, -normals / size[:, None])):
        side = _side(inward, np.vstack([centre, points]) - point)
        force = inward + circle @ np.stack([side, np.cross(inward, side)])
        if twist > 0:
            force = np.concatenate([force, np.repeat(inward[None], 2, axis=0)])
        out[i, :, :3] = force
        out[i, :, 3:] = np.cross(point - centre, force) / length
        if twist > 0:
            out[i, -2:, 3:] += np.array([[twist], [-twist]]) * inward
    return out


def _side(inward: Array, towards: Array) -> Array:
    """A unit tangent (3,): the largest tangential part of the vectors (n, 3); of an axis when all are along inward."""
    flat = towards - (towards @ inward)[:, None] * inward
    size = np.linalg.norm(flat, axis=1)
    best = int(np.argmax(size > 0.999 * size.max()))  # the first of equals, whatever round-off says
    if size[best] <= 1e-6 * max(1e-300, np.linalg.norm(towards, axis=1).max()):
        axis = np.eye(3)[np.argmin(np.abs(inward))]
        flat, best = (axis - (axis @ inward) * inward)[None], 0
    return np.asarray(flat[best] / np.linalg.norm(flat[best]))


def grasp_quality(
    points: ArrayLike, normals: ArrayLike, centre: ArrayLike, length: float, settings: WrenchSettings | None = None
) -> Quality:
    """Quality of contacts at points (n, 3) with outward normals (n, 3) about the centre of mass (3,); see the module.

    Whatever cannot hold (no contact, one, contacts whose wrenches leave a direction out) has zeros and says why.
    """
    settings = settings or WrenchSettings()
    wrenches = primitive_wrenches(points, normals, centre, length, settings)
    flat = wrenches.reshape(-1, 6)
    if not len(flat):
        return Quality(False, 0.0, 0.0, 0.0, "nothing touches the object")
    rank = _rank(flat)
    if rank < 6:
        contacts = f"{len(wrenches)} contact{'s'[: len(wrenches) > 1]}"
        why = f"{contacts} can push and turn in {rank} of 6 directions only"
        return Quality(False, 0.0, 0.0, min(0.0, -_distance(flat)), why)
    hull = largest_ball(flat)
    volume = hull.volume
    epsilon, weakest = hull.radius, hull.weakest
    if epsilon <= settings.smallest:
        # without closure the forces that are less than 1 N in all are part of the space, too
        volume = largest_ball(np.concatenate([flat, np.zeros((1, 6))])).volume
        return Quality(False, 0.0, volume, -_distance(flat), "some pushes meet no resistance", weakest)
    if settings.norm == "linf":
        epsilon, weakest = _grown_ball(wrenches)
    return Quality(True, epsilon, volume, epsilon, "every push is resisted", weakest)


def margin(wrenches: Array, settings: WrenchSettings | None = None) -> float:
    """Epsilon of primitive wrenches (n, k, 6), or minus the origin's distance; faster than `grasp_quality`."""
    settings = settings or WrenchSettings()
    flat = wrenches.reshape(-1, 6)
    if not len(flat):
        return 0.0
    away = _distance(flat)
    if away > settings.smallest or _rank(flat) < 6:
        return min(0.0, -away)
    radius = largest_ball(flat).radius if settings.norm == "l1" else _grown_ball(wrenches)[0]
    return max(0.0, radius)


@dataclass(frozen=True)
class WrenchBall:
    """radius: of the largest ball about the origin inside a hull, negative for an origin outside of it; weakest (d,):
    unit normal of the facet that it touches; volume: of the hull.
    """

    radius: float
    weakest: Array
    volume: float


def largest_ball(points: Array) -> WrenchBall:
    """The largest ball about the origin in the convex hull of points (n, d); of a flat hull, nothing.

    For an origin outside, `radius` is minus how far the worst facet has it outside.
    """
    hull = _hull(points)
    if hull is None:
        return WrenchBall(0.0, np.zeros(points.shape[1]), 0.0)
    normals, offsets = hull.equations[:, :-1], -hull.equations[:, -1]
    nearest = int(np.argmin(offsets))
    return WrenchBall(float(offsets[nearest]), -normals[nearest], float(hull.volume))


def _hull(points: Array) -> ConvexHull | None:
    """Qhull's convex hull, None for points that span no volume."""
    from scipy.spatial import ConvexHull, QhullError

    if _rank(points) < points.shape[1]:
        return None
    with suppress(QhullError):
        return ConvexHull(points)
    # many edges of a pyramid lie in one facet: where merging them fails, points moved by round-off have plain facets
    with suppress(QhullError):
        return ConvexHull(points, qhull_options="QJ Pp")
    return None


def _rank(flat: Array) -> int:
    """Dimension of the convex hull of points (n, d)."""
    if len(flat) < 2:
        return 0
    values = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    return int((values > 1e-7 * max(1e-300, np.linalg.norm(flat, axis=1).max())).sum())


def _distance(flat: Array) -> float:
    """Distance of the origin from the convex hull of wrenches (n, 6): the least-distance problem as non-negative least
    squares (Lawson & Hanson 1974, chapter 23); 0 inside.
    """
    from scipy.optimize import nnls

    target = np.append(np.zeros(flat.shape[1]), 1.0)
    weights, _ = nnls(np.vstack([flat.T, np.ones(len(flat))]), target)
    total = weights.sum()
    away = float(np.linalg.norm(weights @ flat) / total) if total > 0 else 0.0
    return away if away > 1e-9 else 0.0


def _farthest(wrenches: Array, directions: Array) -> Array:
    """For directions (b, 6), the farthest points (b, 6) along them of the sum of the contacts' own spaces.

    Each is the hull of its wrenches (n, k, 6) and of no force at all.
    """
    reach = np.einsum("nkd,bd->bnk", wrenches, directions)
    best = reach.argmax(axis=2)[:, :, None]
    chosen = np.take_along_axis(wrenches[None], best[..., None], axis=2)[:, :, 0]
    pushing = np.take_along_axis(reach, best, axis=2)[:, :, 0] > 0
    return np.asarray((chosen * pushing[:, :, None]).sum(axis=1))


def _grown_ball(wrenches: Array, at_once: int = 12, tolerance: float = 1e-9) -> tuple[float, Array]:
    """Radius of the largest ball about the origin in the sum of the contacts' own spaces, and where it touches.

    The sum has too many corners to list. A hull inside it grows towards its nearest facets until one of them is a facet
    of the sum itself: exact, and few corners are ever looked at (Zheng, IEEE T-RO 2013).
    """
    points = np.unique(_farthest(wrenches, np.concatenate([np.eye(6), -np.eye(6)])), axis=0)
    for _ in range(6):  # a flat start grows across its own plane
        _, values, axes = np.linalg.svd(points - points.mean(axis=0))
        if len(points) > 6 and values[5] > 1e-6 * values[0]:
            break
        points = np.unique(np.concatenate([points, _farthest(wrenches, np.stack([axes[-1], -axes[-1]]))]), axis=0)
    while True:
        hull = _hull(points)
        if hull is None:
            return 0.0, np.zeros(6)
        order = np.argsort(-hull.equations[:, -1], kind="stable")[:at_once]
        normals, offsets = hull.equations[order, :-1], -hull.equations[order, -1]
        corners = _farthest(wrenches, normals)
        beyond = np.einsum("bd,bd->b", normals, corners) - offsets
        grown = np.unique(np.concatenate([points, corners[beyond > tolerance]]), axis=0)
        if beyond[0] <= tolerance or len(grown) == len(points):
            return float(offsets[0]), -normals[0]
        points = grown
