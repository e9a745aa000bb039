"""Fingertips as a grasp meets them: convex cores rounded by a ball.

A sphere is a point rounded by its radius. Ellipsoids, cylinders with flat ends and meshes (their convex hulls) are the
shape shrunk by `ROUNDING`, then rounded by as much: edges get that radius, flat and gently bent sides stay where they
are (an ellipsoid's to some hundredths of a millimetre). A core is described by how far it reaches from a point inside
in every direction. Sensor frame, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot.sensors import Sensor, surface_hull

Array = NDArray[np.float64]

# Radius (m) of the edges of tips that are no balls: rubber and machined tips are broken by about half a millimetre.
ROUNDING = 5e-4
# Points of a core at which clearance is looked for: while choosing a grasp, and while closing it exactly.
COARSE, FINE = 200, 1200


@dataclass(frozen=True, eq=False)
class Tip:
    """centre (3,) of the core, sensor frame; rounding (m), the ball's radius; kind and size: "sphere" (), "ellipsoid"
    radii (3,), "cylinder" (radius, half length) along z, "mesh" planes (m, 4): outward normals and their distances from
    the centre. Sizes are the core's.
    """

    centre: Array
    rounding: float
    kind: str
    size: Array

    def reach(self, directions: Array) -> Array:
        """(n,) metres from the centre to the core's surface along unit directions (n, 3)."""
        if self.kind == "sphere":
            return np.zeros(len(directions))
        if self.kind == "ellipsoid":
            return 1.0 / np.linalg.norm(directions / self.size, axis=1)
        if self.kind == "cylinder":
            across = np.linalg.norm(directions[:, :2], axis=1)
            return np.minimum(
                self.size[0] / np.maximum(across, 1e-12), self.size[1] / np.maximum(np.abs(directions[:, 2]), 1e-12)
            )
        along = directions @ self.size[:, :3].T
        return np.where(along > 1e-12, self.size[:, 3] / np.maximum(along, 1e-12), np.inf).min(axis=1)

    def points(self, directions: Array) -> Array:
        """(n, 3) points of the core's surface, sensor frame, in unit directions (n, 3) from its centre."""
        return self.centre + self.reach(directions)[:, None] * directions

    def samples(self, count: int) -> Array:
        """(n, 3) points spread over the core's surface, sensor frame; the centre alone for a sphere."""
        if self.kind == "sphere":
            return self.centre[None].copy()
        return self.points(poses.around(count))

    @property
    def radius(self) -> float:
        """Mean distance (m) from the centre to the surface."""
        return float(self.reach(poses.around(COARSE)).mean()) + self.rounding

    @property
    def extent(self) -> float:
        """Distance (m) of the farthest point of the surface from the sensor's origin."""
        return float(np.linalg.norm(self.samples(FINE), axis=1).max()) + self.rounding


def tip_of(sensor: Sensor) -> Tip | None:
    """The tip of a sensor with a surface; None without. Raises InputError for a mesh that is too small or no mesh."""
    if sensor.surface is None:
        return None
    kind, values = next(iter(sensor.surface.items()))
    return _tip(sensor.name, kind, values)


def tip_skin(sensor: Sensor, count: int = 400) -> Array:
    """(n, 3) points on a sensor's tip, or up to a hair inside it, sensor frame; none without a surface."""
    tip = tip_of(sensor)
    if tip is None:
        return np.zeros((0, 3))
    directions = poses.around(count)
    return tip.points(directions) + tip.rounding * directions


def _tip(name: str, kind: str, values: dict[str, Any]) -> Tip:
    origin = np.zeros(3)
    if kind == "sphere":
        return Tip(origin, float(values["radius"]), kind, np.zeros(0))
    if kind == "mesh":
        vertices, faces = surface_hull({kind: values}, f"sensor {name!r}")
        centre = vertices.mean(axis=0)
        corners = vertices[faces] - centre
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1)
        normals, corners = normals[length > 1e-14] / length[length > 1e-14, None], corners[length > 1e-14]
        depth = np.einsum("ni,ni->n", normals, corners[:, 0])
        smallest = float(depth.min(initial=0.0 if not len(depth) else np.inf))
        rounding = _rounding(name, smallest)
        return Tip(centre, rounding, kind, np.column_stack([normals, depth - rounding]))
    size = np.array(values["radii"] if kind == "ellipsoid" else [values["radius"], 0.5 * values["length"]], dtype=float)
    rounding = _rounding(name, float(size.min()))
    return Tip(origin, rounding, kind, size - rounding)


def _rounding(name: str, smallest: float) -> float:
    if smallest < 1e-4:
        raise InputError(f"sensor {name!r}: expected a fingertip of a tenth of a millimetre or more, got {smallest} m")
    return min(ROUNDING, 0.5 * smallest)


# The nearest point of a core is looked for among so many directions in a cone, whose half angle (rad) shrinks from more
# than the spacing of samples down to some micrometres on a fingertip.
CONE = 48
CONES = 0.1 * 0.55 ** np.arange(10)


def nearest(tip: Tip, distance: Callable[[Array], Array], start: Array) -> tuple[Array, float]:
    """The point (3,) of the core where distance(points (n, 3), sensor frame) -> (n,) is least, and that least distance.

    start (3,): a point of the core near it. Samples in ever narrower cones about the best direction so far: derivatives
    jump where the core or the object has an edge, and lead along no ridge. The rounding is not taken off.
    """
    here = start - tip.centre
    best = float(distance(start[None])[0])
    if tip.kind == "sphere" or not here.any():
        return start, best
    here = here / np.linalg.norm(here)
    share = np.sqrt((np.arange(CONE) + 0.5) / CONE)
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(CONE)
    disc = np.stack([share * np.cos(turn), share * np.sin(turn)], axis=1)
    for angle in CONES:
        side = np.cross(here, np.eye(3)[np.argmin(np.abs(here))])
        side /= np.linalg.norm(side)
        around = here + angle * (disc @ np.stack([side, np.cross(here, side)]))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        values = distance(tip.points(around))
        if values.min() < best:
            here, best = around[np.argmin(values)], float(values.min())
    return tip.points(here[None])[0], best
