"""Superquadrics: closed shapes of eleven numbers, fitted to points (Solina & Bajcsy, IEEE PAMI 12, 1990). Metres.

F(p) = ((|x|/a)^(2/e2) + (|y|/b)^(2/e2))^(e2/e1) + (|z|/c)^(2/e1) is 1 on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

# Exponents between a box with rounded edges and a ball's octahedral neighbour: convex, as things in hands mostly are.
EXPONENTS = (0.1, 2.0)
# Half axes (m): thinner than a card or larger than an arm is no object for a hand.
AXES = (0.001, 0.5)
# An axis is at most this many times half the points' own largest extent; and that each is like the points' own extent
# along it is believed as much as this share of the points: what no camera saw has no end otherwise.
GROWTH = 1.2
BELIEF = 0.05
# Points that a fit needs: more than it has numbers, with room for noise.
FEWEST = 20
MOST = 800


@dataclass(frozen=True)
class Superquadric:
    """axes (3,) half lengths m; exponents (2,): e1 along z, e2 around it; pose (4, 4) object_from_superquadric."""

    axes: Array
    exponents: Array
    pose: Array

    def inside_outside(self, points: Array) -> Array:
        """F (n,) of points (n, 3), object frame: below 1 inside, above 1 outside."""
        return _inside_outside(poses.apply(poses.inverse(self.pose), points), self.axes, self.exponents)

    def radial_distance(self, points: Array) -> Array:
        """(n,) m along the ray from the centre, outside positive (Whaite & Ferrie 1991)."""
        local = poses.apply(poses.inverse(self.pose), points)
        value = np.maximum(_inside_outside(local, self.axes, self.exponents), 1e-12)
        return np.asarray(np.linalg.norm(local, axis=1) * (1.0 - value ** (-0.5 * self.exponents[0])))

    def mesh(self, divisions: int = 5) -> tuple[Array, Faces]:
        """Closed vertices (n, 3) and faces (m, 3), wound outwards, object frame."""
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=divisions)
        # rays through the axes' ellipsoid: edges of a flat shape get their share of triangles
        rays = np.asarray(ball.vertices) * self.axes
        scale = _inside_outside(rays, self.axes, self.exponents) ** (-0.5 * self.exponents[0])
        return poses.apply(self.pose, rays * scale[:, None]), np.asarray(ball.faces, dtype=np.int64)


def _inside_outside(local: Array, axes: Array, exponents: Array) -> Array:
    e1, e2 = exponents
    # never exactly 0: its logarithm stands in the derivative
    x, y, z = np.maximum(np.abs(local) / axes, 1e-9).T
    return np.asarray((x ** (2 / e2) + y ** (2 / e2)) ** (e2 / e1) + z ** (2 / e1))


def fit_superquadric(points: Array, weights: Array | None = None) -> Superquadric:
    """The superquadric nearest to points (n, 3) on a surface, each with a weight (n,), default 1.

    Least squares of sqrt(a b c) (F^e1 - 1), which prefers the smaller of two that fit alike; started along the points'
    own axes in three orders. Raises InputError for too few points or points that are not finite.
    """
    from scipy.optimize import least_squares

    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(points) < FEWEST or not np.isfinite(points).all():
        raise InputError(f"superquadric: expected {FEWEST} finite points or more, got {len(points)}")
    chosen = np.linspace(0, len(points) - 1, min(len(points), MOST)).astype(int)
    root = np.ones(len(points)) if weights is None else np.sqrt(weights)
    if weights is not None:  # the few that weigh much are all kept
        chosen = np.union1d(chosen, np.flatnonzero(weights > 2.0 * np.median(weights))[:MOST])
    used, root = points[chosen], root[chosen]
    middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
    _, _, own = np.linalg.svd(used - used.mean(axis=0), full_matrices=False)
    scale = float(np.linalg.norm(used - middle, axis=1).max())
    best: tuple[float, Superquadric] | None = None
    for order in [p for p in permutations(range(3)) if p[0] < p[1]]:  # which axis is z; x and y are alike
        rotation = own[list(order)].T
        rotation[:, 2] *= np.sign(np.linalg.det(rotation))
        start = poses.make_pose(rotation, middle)
        half = np.clip(0.5 * np.ptp((used - middle) @ rotation, axis=0), 2 * AXES[0], AXES[1])

        def made(x: Array, start: Array = start) -> Superquadric:
            moved = poses.perturb(start, np.concatenate([x[5:8], scale * x[8:]]), np.zeros(3))
            return Superquadric(np.exp(x[:3]), x[3:5], moved)

        def residual(x: Array, half: Array = half) -> Array:
            shape = made(x)
            value = shape.inside_outside(used)
            away = np.minimum(value, 1e6) ** shape.exponents[0] - 1.0
            on = root * np.sqrt(np.prod(shape.axes)) * away / scale**1.5
            return np.append(on, BELIEF * np.sqrt(np.sum(root**2)) * (x[:3] - np.log(half)))

        low = np.concatenate([np.full(3, np.log(AXES[0])), np.full(2, EXPONENTS[0]), np.full(6, -np.inf)])
        most = np.log(GROWTH * half.max())
        high = np.concatenate([np.full(3, most), np.full(2, EXPONENTS[1]), np.full(6, np.inf)])
        begin = np.concatenate([np.log(half), [1.0, 1.0], np.zeros(6)])
        found = least_squares(residual, begin, bounds=(low, high), max_nfev=80)
        shape = made(found.x)
        error = float(np.average(np.abs(shape.radial_distance(used)), weights=root**2))
        if best is None or error < best[0]:
            best = (error, shape)
    assert best is not None
    return best[1]
