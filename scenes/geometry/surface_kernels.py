"""Compiled: which cells of a coarse grid a mesh's triangles come near, and which points lie in one of them."""

from __future__ import annotations

import math

import numba


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
