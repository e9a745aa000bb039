"""Compiled: which cells of a coarse grid a mesh's triangles come near, which points lie in one, mixing of cells,
distances in double precision from closest points in single, and the patch of least area over a hole.
"""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mark_cells(low, high, origin, cell, covered):
    """Mark in covered (i, j, k) the cells of size `cell` (m) from origin (3,) that any box low, high (m, 3) reaches."""
    for n in range(low.shape[0]):
        i0 = math.floor((low[n, 0] - origin[0]) / cell)
        j0 = math.floor((low[n, 1] - origin[1]) / cell)
        k0 = math.floor((low[n, 2] - origin[2]) / cell)
        i1 = math.floor((high[n, 0] - origin[0]) / cell) + 1
        j1 = math.floor((high[n, 1] - origin[1]) / cell) + 1
        k1 = math.floor((high[n, 2] - origin[2]) / cell) + 1
        for i in range(max(i0, 0), min(i1, covered.shape[0])):
            for j in range(max(j0, 0), min(j1, covered.shape[1])):
                for k in range(max(k0, 0), min(k1, covered.shape[2])):
                    covered[i, j, k] = True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def in_cells(points, middle, origin, cell, covered, out):
    """Fill out (n,) with whether points (n, 3), less middle (3,), lie in a marked cell; see mark_cells."""
    inverse = 1.0 / cell
    for n in range(points.shape[0]):
        x = (points[n, 0] - middle[0] - origin[0]) * inverse
        y = (points[n, 1] - middle[1] - origin[1]) * inverse
        z = (points[n, 2] - middle[2] - origin[2]) * inverse
        # not true of NaN either
        if 0.0 <= x < covered.shape[0] and 0.0 <= y < covered.shape[1] and 0.0 <= z < covered.shape[2]:
            out[n] = covered[int(x), int(y), int(z)]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mix_cells(points, origin, cell, index, colours, out):
    """Fill out (n, 3) with the colours (k, 3) of the eight cells of size `cell` (m) from origin (3,) around each of
    points (n, 3), mixed by how near their middles are; index (i, j, k): number of a cell's colour + 1, 0 for none. A
    point with none around is left as it is.
    """
    inverse = 1.0 / cell
    for n in range(points.shape[0]):
        x = (points[n, 0] - origin[0]) * inverse - 0.5
        y = (points[n, 1] - origin[1]) * inverse - 0.5
        z = (points[n, 2] - origin[2]) * inverse - 0.5
        # not true of NaN either
        if not (-1.0 <= x < index.shape[0] and -1.0 <= y < index.shape[1] and -1.0 <= z < index.shape[2]):
            continue
        i0, j0, k0 = math.floor(x), math.floor(y), math.floor(z)
        total, red, green, blue = 0.0, 0.0, 0.0, 0.0
        for i in range(max(i0, 0), min(i0 + 2, index.shape[0])):
            for j in range(max(j0, 0), min(j0 + 2, index.shape[1])):
                for k in range(max(k0, 0), min(k0 + 2, index.shape[2])):
                    which = index[i, j, k] - 1
                    if which >= 0:
                        weight = (1.0 - abs(x - i)) * (1.0 - abs(y - j)) * (1.0 - abs(z - k))
                        total += weight
                        red += weight * colours[which, 0]
                        green += weight * colours[which, 1]
                        blue += weight * colours[which, 2]
        if total > 1e-6:
            out[n, 0], out[n, 1], out[n, 2] = red / total, green / total, blue / total


# Nearer to the surface than this (m) the direction to it is noise of single precision.
_TOO_NEAR = 1e-6


@numba.njit(cache=True, nogil=True, error_model="numpy")
def feet(points, face, corners, normals, upright, foot, distance, gradient, slanted):
    """Signed distance (n,) and its unit gradient (n, 3) of points (n, 3) whose closest points are foot (n, 3), put back
    in place onto the planes of their triangles, face (n,).

    corners (m, 3, 3), normals (m, 3): of the triangles. A point without one, -1, is left as it is. slanted (n,):
    whether the foot is on an edge or a corner, so that the side of one triangle does not tell the sign: its cosine with
    the normal is below `upright`.
    """
    for n in range(points.shape[0]):
        f = face[n]
        if f < 0:
            continue
        a, b, c = normals[f, 0], normals[f, 1], normals[f, 2]
        off = 0.0
        for i in range(3):
            off += (foot[n, i] - corners[f, 0, i]) * normals[f, i]
        for i in range(3):
            # rounding has lifted the foot off its triangle
            foot[n, i] -= off * normals[f, i]
        x, y, z = points[n, 0] - foot[n, 0], points[n, 1] - foot[n, 1], points[n, 2] - foot[n, 2]
        length = math.sqrt(x * x + y * y + z * z)
        side = x * a + y * b + z * c
        if length < _TOO_NEAR:
            distance[n] = side
            gradient[n, 0], gradient[n, 1], gradient[n, 2] = a, b, c
            continue
        distance[n] = -length if side < 0.0 else length
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = x / distance[n], y / distance[n], z / distance[n]
        slanted[n] = abs(side) < upright * length


@numba.njit(cache=True, nogil=True, error_model="numpy")
def least_patch(ring, taken, nothing, triangles):
    """Fill triangles (n - 2, 3) with the corners in ring (n, 3) of the patch of least area that spans it, without the
    chords that are taken (n, n); whether there is one.

    Dynamic programming over the ring's chords (Barequet and Sharir, Filling gaps in the boundary of a polyhedron,
    1995). Triangles of no area (length^2) more than `nothing` are shunned: they have no side to face.
    """
    n = ring.shape[0]
    least, apex = np.zeros((n, n)), np.zeros((n, n), dtype=np.int64)
    for length in range(2, n):
        for i in range(n - length):
            k, best = i + length, np.inf
            ux, uy, uz = ring[k, 0] - ring[i, 0], ring[k, 1] - ring[i, 1], ring[k, 2] - ring[i, 2]
            for j in range(i + 1, k):
                vx, vy, vz = ring[j, 0] - ring[i, 0], ring[j, 1] - ring[i, 1], ring[j, 2] - ring[i, 2]
                x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                area = 0.5 * math.sqrt(x * x + y * y + z * z)
                if area <= nothing:
                    area += 1e6 * nothing
                total = least[i, j] + least[j, k] + area
                if total < best:
                    best = total
                    apex[i, k] = j
            least[i, k] = best if not taken[i, k] or length == n - 1 else np.inf
    if not least[0, n - 1] < np.inf:
        return False
    stack = np.zeros((n, 2), dtype=np.int64)
    stack[0, 1] = n - 1
    depth, count = 1, 0
    while depth:
        depth -= 1
        i, k = stack[depth]
        if k - i < 2:
            continue
        j = apex[i, k]
        triangles[count, 0], triangles[count, 1], triangles[count, 2] = i, j, k
        count += 1
        stack[depth], stack[depth + 1] = (i, j), (j, k)
        depth += 2
    return True
