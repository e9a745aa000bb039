"""Closed triangle meshes from formulas: bodies of revolution, extrusions, and surfaces of implicit functions.

Everything in metres, faces wound outwards, no randomness: the same call gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
Mesh = tuple[Array, Faces]
Implicit = Callable[[Array], Array]


def revolve(profile: ArrayLike, segments: int = 96) -> Mesh:
    """The body swept by a profile turned about the z axis.

    profile: (n, 2) rows (radius, z), from a point on the axis (radius 0) to another, walked so that the inside is on
    the left: up the outer wall, and back down the inner one for a hollow body. segments: facets a turn.
    """
    curve = np.asarray(profile, dtype=np.float64)
    if curve.ndim != 2 or curve.shape[1] != 2 or len(curve) < 3 or curve[0, 0] != 0 or curve[-1, 0] != 0:
        raise InputError(f"revolve: expected (n, 2) rows from the axis to the axis, got shape {curve.shape}")
    if (curve[1:-1, 0] <= 0).any():
        raise InputError("revolve: expected radii above 0 between the two ends")
    angle = 2 * np.pi * np.arange(segments) / segments
    rings = np.stack(
        [
            curve[1:-1, 0, None] * np.cos(angle),
            curve[1:-1, 0, None] * np.sin(angle),
            np.broadcast_to(curve[1:-1, 1, None], (len(curve) - 2, segments)),
        ],
        axis=-1,
    )
    vertices = np.concatenate([[[0, 0, curve[0, 1]]], rings.reshape(-1, 3), [[0, 0, curve[-1, 1]]]])
    here = np.arange(segments)
    after = (here + 1) % segments
    last = len(vertices) - 1
    faces = [np.stack([np.zeros_like(here), 1 + after, 1 + here], axis=1)]
    for ring in range(len(curve) - 3):
        low, high = 1 + ring * segments, 1 + (ring + 1) * segments
        faces.append(np.stack([low + here, low + after, high + after], axis=1))
        faces.append(np.stack([low + here, high + after, high + here], axis=1))
    top = 1 + (len(curve) - 3) * segments
    faces.append(np.stack([top + here, top + after, np.full_like(here, last)], axis=1))
    return vertices, np.concatenate(faces).astype(np.int64)


def loft(polygons: ArrayLike, heights: ArrayLike) -> Mesh:
    """The body between polygons of equal corner count, one per height, counter-clockwise seen from +z.

    polygons (k, n, 2), heights (k,) increasing. The end caps are fans about their first corner, so they must be
    convex or star-shaped about it.
    """
    shapes = np.asarray(polygons, dtype=np.float64)
    levels = np.asarray(heights, dtype=np.float64)
    count, corners = shapes.shape[:2]
    vertices = np.concatenate([shapes, np.broadcast_to(levels[:, None, None], (count, corners, 1))], axis=2)
    here = np.arange(corners)
    after = (here + 1) % corners
    faces = []
    for level in range(count - 1):
        low, high = level * corners, (level + 1) * corners
        faces.append(np.stack([low + here, low + after, high + after], axis=1))
        faces.append(np.stack([low + here, high + after, high + here], axis=1))
    fan = np.stack([np.zeros(corners - 2, dtype=int), here[1:-1], here[2:]], axis=1)
    faces.append(fan[:, ::-1])
    faces.append((count - 1) * corners + fan)
    return vertices.reshape(-1, 3), np.concatenate(faces).astype(np.int64)


def extrude(polygon: ArrayLike, thickness: float) -> Mesh:
    """A polygon (n, 2), counter-clockwise and star-shaped about its first corner, from z = -thickness/2 to +."""
    return loft(np.array([polygon, polygon]), [-thickness / 2, thickness / 2])


def mesh_implicit(function: Implicit, low: ArrayLike, high: ArrayLike, spacing: float) -> Mesh:
    """The zero set of `function` (points (n, 3) -> (n,), negative inside) by surface nets.

    One vertex in every grid cell that the surface crosses (Gibson, "Constrained elastic surface nets", 1998), joined
    by one quad per crossed grid edge; vertices are then brought onto the zero set by Newton steps of the function
    itself, so the mesh is far finer than its grid where the surface is smooth. low, high: a box (3,) that holds the
    zero set with a margin of two cells. Raises InputError when the surface leaves the box.
    """
    start = np.asarray(low, dtype=np.float64)
    counts = np.ceil((np.asarray(high, dtype=np.float64) - start) / spacing).astype(int) + 1
    values = _narrow_band(function, start, counts, spacing)
    inside = values < 0
    border = np.ones(inside.shape, dtype=bool)
    border[1:-1, 1:-1, 1:-1] = False
    if (inside & border).any():
        raise InputError("mesh_implicit: expected the surface inside the box, it leaves it")
    cells = tuple(counts - 1)
    total, crossings = np.zeros((*cells, 3)), np.zeros(cells)
    quads = []
    # Cells around an edge along `axis`, in circular order; reversed when the edge runs from outside to inside
    for axis in range(3):
        first = tuple(slice(0, -1) if i == axis else slice(None) for i in range(3))
        second = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
        edges = np.argwhere(inside[first] != inside[second])
        step = np.eye(3, dtype=int)[axis]
        a, b = values[tuple(edges.T)], values[tuple((edges + step).T)]
        points = edges + (a / (a - b))[:, None] * step
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        ring = np.stack([edges - u - v, edges - v, edges, edges - u], axis=1)
        for corner in range(4):
            np.add.at(total, tuple(ring[:, corner].T), points)
            np.add.at(crossings, tuple(ring[:, corner].T), 1)
        outward = (a < 0)[:, None, None]
        quads.append(np.where(outward, ring, ring[:, ::-1]))
    used = crossings > 0
    number = np.cumsum(used).reshape(cells) - 1
    vertices = start + spacing * total[used] / crossings[used][:, None]
    vertices = _project(function, vertices, spacing)
    index = np.concatenate([number[tuple(np.moveaxis(q, 2, 0))] for q in quads])
    corners = vertices[index]
    # Split each quad along its shorter diagonal: fewer slivers
    other = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1) > np.linalg.norm(
        corners[:, 1] - corners[:, 3], axis=1
    )
    index = np.where(other[:, None], np.roll(index, -1, axis=1), index)
    return vertices, np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]]).astype(np.int64)


def _narrow_band(function: Implicit, start: Array, counts: NDArray[np.int64], spacing: float) -> Array:
    """Values at all grid nodes; exact near the zero set, only the sign elsewhere (a few times fewer evaluations).

    A block of 4 cells a side is skipped when its centre is farther from the surface than its half diagonal; that is
    safe for functions with gradient at most 1, and a factor of 1.5 covers those slightly steeper.
    """
    block = 4
    blocks = -(-counts // block)
    centres = _grid(blocks) * (block * spacing) + start + 0.5 * (block - 1) * spacing
    rough = function(centres.reshape(-1, 3)).reshape(tuple(blocks))
    values = np.kron(rough, np.ones((block,) * 3))
    near = np.abs(rough) < 1.5 * block * spacing * np.sqrt(3) / 2
    nodes = np.argwhere(near)[:, None] * block + np.argwhere(np.ones((block,) * 3))[None]
    nodes = nodes.reshape(-1, 3)
    values[tuple(nodes.T)] = function(start + spacing * nodes)
    return np.ascontiguousarray(values[: counts[0], : counts[1], : counts[2]])


def _grid(shape: NDArray[np.int64]) -> Array:
    return np.stack(np.meshgrid(*[np.arange(n, dtype=np.float64) for n in shape], indexing="ij"), axis=-1)


def _project(function: Implicit, points: Array, spacing: float, steps: int = 2) -> Array:
    """Newton steps to the zero set along the gradient, held within 0.7 cells so that no triangle turns over."""
    moved = points
    h = 1e-3 * spacing
    for _ in range(steps):
        value = function(moved)
        gradient = np.stack([(function(moved + h * e) - value) / h for e in np.eye(3)], axis=1)
        square = np.maximum(np.sum(gradient**2, axis=1), 0.25)
        moved = moved - (value / square)[:, None] * gradient
        step = moved - points
        length = np.linalg.norm(step, axis=1, keepdims=True)
        moved = points + step * np.minimum(1.0, 0.7 * spacing / np.maximum(length, 1e-12))
    return moved


# Signed distances of simple bodies (exact or a close lower bound; Hart, "Sphere tracing", 1996), points (n, 3).


def ellipsoid(points: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """First-order distance to an ellipsoid with semi-axes `radii`, exact on the surface."""
    local = points - np.asarray(centre, dtype=np.float64)
    scaled = local / np.asarray(radii, dtype=np.float64)
    k0 = np.linalg.norm(scaled, axis=1)
    k1 = np.linalg.norm(scaled / np.asarray(radii, dtype=np.float64), axis=1)
    return k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)


def capsule(points: Array, start: ArrayLike, end: ArrayLike, radius: float, end_radius: float | None = None) -> Array:
    """Distance to a segment minus a radius that may change linearly along it."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    along = b - a
    t = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    width = radius + t * ((radius if end_radius is None else end_radius) - radius)
    return np.linalg.norm(points - a - t[:, None] * along, axis=1) - width


def rounded_box(points: Array, centre: ArrayLike, half: ArrayLike, rounding: float) -> Array:
    """Distance to a box of half sizes `half` (outer) with edges of radius `rounding`."""
    outside = np.abs(points - np.asarray(centre, dtype=np.float64)) - np.asarray(half, dtype=np.float64) + rounding
    return np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0) - rounding


def rounded_cylinder(points: Array, start: ArrayLike, end: ArrayLike, radius: float, rounding: float) -> Array:
    """Distance to a cylinder between two points, its rims of radius `rounding`."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / length
    local = points - (a + b) / 2
    along = local @ axis
    radial = np.sqrt(np.maximum(np.sum(local**2, axis=1) - along**2, 0.0))
    outside = np.stack([radial - radius, np.abs(along) - length / 2], axis=1) + rounding
    return np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0) - rounding


def smooth_union(parts: list[Array], blend: float) -> Array:
    """Union whose seams are filleted over about `blend` metres (polynomial smooth minimum)."""
    out = parts[0]
    for other in parts[1:]:
        share = np.maximum(blend - np.abs(out - other), 0.0) / blend
        out = np.minimum(out, other) - share**2 * blend / 4
    return out
