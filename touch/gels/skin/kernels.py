"""A gel's colours to slopes, compiled: each pixel's normal, the equations of its lamps, what is smooth between held
values; and which points of a patch tell the most of its pose. Pixels are flat, (n,); r (n, 3) are their lines and a
(2, 3) how those move from column to column and row to row (`Gel.lines`), so that slopes are -(normal . a) /
(normal . r) for a pinhole camera and for parallel lines alike.
"""

from __future__ import annotations

import math

import numba
import numpy as np

# Skin steeper than 84 degrees to its pixel's line is a wrong colour.
FLATTEST = 0.1
# Of a pixel's own two equations, in the mean of their diagonal: where colours say nothing, slopes do not follow lamps.
SILENT = 1e-3


@numba.njit(cache=True, nogil=True)
def _nearest(s, c0, c1, c2, rx, ry, rz, pull, longest, steps, x, y):
    """The normal (x, y, z) near the given (x, y) whose colours by s (3, 3) are nearest to changes c."""
    least = 1.0 - longest * longest
    for _ in range(steps):
        z = math.sqrt(max(1.0 - x * x - y * y, least))
        over_x, over_y = x / z, y / z
        dx, dy, dz = x - rx, y - ry, z - rz
        a, b, c = pull, 0.0, pull
        g, h = -pull * dx, -pull * dy
        for i in range(3):
            change = c0 if i == 0 else (c1 if i == 1 else c2)
            left = change - s[i, 0] * dx - s[i, 1] * dy - s[i, 2] * dz
            u, v = s[i, 0] - s[i, 2] * over_x, s[i, 1] - s[i, 2] * over_y
            a += u * u
            b += u * v
            c += v * v
            g += u * left
            h += v * left
        determinant = a * c - b * b  # above pull squared
        x += (c * g - b * h) / determinant
        y += (a * h - b * g) / determinant
        length = math.sqrt(x * x + y * y)
        if length > longest:
            x *= longest / length
            y *= longest / length
    return x, y, math.sqrt(max(1.0 - x * x - y * y, least))


@numba.njit(cache=True, nogil=True)
def _mixed(mixture, by_normal, out):
    """The mixture (3, 3) times by_normal (3, 3) into out."""
    for c in range(3):
        for i in range(3):
            out[c, i] = (
                mixture[c, 0] * by_normal[0, i] + mixture[c, 1] * by_normal[1, i] + mixture[c, 2] * by_normal[2, i]
            )


@numba.njit(cache=True, nogil=True)
def face(mixture, by_normal, change, rest, pull, longest, steps, out):
    """Gauss-Newton over x and y of the normal, z = sqrt(1 - x^2 - y^2), from what out (n, 3) has; fills out.

    by_normal (n, 3, 3): change of a channel by the normal's, before the lamps mix channels, mixture (3, 3); change
    (n, 3): what is seen; rest (n, 3): the untouched normals; pull: weight of staying there; longest: of (x, y), below
    1.
    """
    s = np.zeros((3, 3))
    for p in range(len(change)):
        _mixed(mixture, by_normal[p], s)
        out[p, 0], out[p, 1], out[p, 2] = _nearest(
            s,
            change[p, 0],
            change[p, 1],
            change[p, 2],
            rest[p, 0],
            rest[p, 1],
            rest[p, 2],
            pull,
            longest,
            steps,
            out[p, 0],
            out[p, 1],
        )


@numba.njit(cache=True, nogil=True)
def slopes_by_colours(
    seen, unmixed, drift, by_normal, by_depth, depth, rest, lines, across, index, width, pull, longest, far, near, out
):
    """Slopes of the pixels `index` (m,) less those of the untouched skin; fills out (2, n) there.

    seen (n, 3): relative changes of colours; unmixed (3, 3): what undoes the lamps' mixture; drift: of the exposure;
    by_normal (n, 3, 3), by_depth (n, 3) and depth (n,): as the calibration has them; rest (n, 3): untouched normals,
    from which a row's first pixel takes `far` steps; the others take `near` from their neighbour's; width: of a row.
    """
    x, y, z, before = 0.0, 0.0, 1.0, -2
    for k in range(len(index)):
        p = index[k]
        steps = near
        if p != before + 1 or p % width == 0:
            x, y, steps = rest[p, 0], rest[p, 1], far
        before = p
        q0 = (1.0 + seen[p, 0]) / (1.0 + drift) - 1.0
        q1 = (1.0 + seen[p, 1]) / (1.0 + drift) - 1.0
        q2 = (1.0 + seen[p, 2]) / (1.0 + drift) - 1.0
        c0 = unmixed[0, 0] * q0 + unmixed[0, 1] * q1 + unmixed[0, 2] * q2 - by_depth[p, 0] * depth[p]
        c1 = unmixed[1, 0] * q0 + unmixed[1, 1] * q1 + unmixed[1, 2] * q2 - by_depth[p, 1] * depth[p]
        c2 = unmixed[2, 0] * q0 + unmixed[2, 1] * q1 + unmixed[2, 2] * q2 - by_depth[p, 2] * depth[p]
        rx, ry, rz = rest[p, 0], rest[p, 1], rest[p, 2]
        x, y, z = _nearest(by_normal[p], c0, c1, c2, rx, ry, rz, pull, longest, steps, x, y)
        ahead = max(x * lines[p, 0] + y * lines[p, 1] + z * lines[p, 2], FLATTEST)
        away = max(rx * lines[p, 0] + ry * lines[p, 1] + rz * lines[p, 2], FLATTEST)
        for i in range(2):
            pressed = (x * across[i, 0] + y * across[i, 1] + z * across[i, 2]) / ahead
            out[i, p] = (rx * across[i, 0] + ry * across[i, 1] + rz * across[i, 2]) / away - pressed


@numba.njit(cache=True, nogil=True)
def _by_slope(s, x, y, z, r, a, out):
    """How colours by s (3, 3) change with the slopes of the normal (x, y, z); fills out (3, 2)."""
    z = max(z, 0.1)
    near = x * r[0] + y * r[1] + z * r[2]
    steep = near <= FLATTEST
    near = max(near, FLATTEST)
    # by x and y of the normal, z along with them; slope i: -(n . a_i) / (n . r)
    turn = np.zeros((2, 2))
    for i in range(2):
        top = x * a[i, 0] + y * a[i, 1] + z * a[i, 2]
        for j in range(2):
            own = x if j == 0 else y
            above = a[i, j] - a[i, 2] * own / z
            below = 0.0 if steep else r[j] - r[2] * own / z
            turn[i, j] = -above / near + top * below / (near * near)
    determinant = turn[0, 0] * turn[1, 1] - turn[0, 1] * turn[1, 0]
    if abs(determinant) < 1e-300:
        determinant = 1e-300
    for c in range(3):
        u, v = s[c, 0] - s[c, 2] * x / z, s[c, 1] - s[c, 2] * y / z
        out[c, 0] = (u * turn[1, 1] - v * turn[1, 0]) / determinant
        out[c, 1] = (v * turn[0, 0] - u * turn[0, 1]) / determinant


@numba.njit(cache=True, nogil=True)
def facing(along, r, a, out):
    """Unit normals out (n, 3) of slopes along (2, n)."""
    for p in range(len(r)):
        # P_u / D = (ln D)_u r + a_u' for a pinhole's lines, (0, 0, z_u) + a_u' for parallel ones: the normal is
        # across both, n . (slope r + a) = 0
        x0, y0, z0 = along[0, p] * r[p, 0] + a[0, 0], along[0, p] * r[p, 1] + a[0, 1], along[0, p] * r[p, 2] + a[0, 2]
        x1, y1, z1 = along[1, p] * r[p, 0] + a[1, 0], along[1, p] * r[p, 1] + a[1, 1], along[1, p] * r[p, 2] + a[1, 2]
        x, y, z = y0 * z1 - z0 * y1, z0 * x1 - x0 * z1, x0 * y1 - y0 * x1
        length = max(math.sqrt(x * x + y * y + z * z), 1e-300)
        out[p, 0], out[p, 1], out[p, 2] = x / length, y / length, z / length


@numba.njit(cache=True, nogil=True)
def following(q, mixture, by_normal, by_depth, depth, rest, normal, level, lines, across, index, model, fields):
    """What colours the surface would have, and how each pixel's slopes follow the lamps.

    q (m, 3): relative changes seen at the pixels `index`; normal, level (m, 3): their normals by colours alone, and of
    the integrated surface; by_normal (m, 3, 3), by_depth (m, 3), depth (m,), rest and lines (m, 3). Fills model (m, 3),
    the colours under the calibration's lamps, and fields (2, 10, n), slopes by the mixture, row by row, and the drift.
    """
    own, s = np.zeros((3, 2)), np.zeros((3, 3))
    for p in range(len(index)):
        for c in range(3):
            model[p, c] = by_depth[p, c] * depth[p]
            for i in range(3):
                model[p, c] += by_normal[p, c, i] * (level[p, i] - rest[p, i])
        _mixed(mixture, by_normal[p], s)
        _by_slope(s, normal[p, 0], normal[p, 1], normal[p, 2], lines[p], across, own)
        a = own[0, 0] ** 2 + own[1, 0] ** 2 + own[2, 0] ** 2
        b = own[0, 0] * own[0, 1] + own[1, 0] * own[1, 1] + own[2, 0] * own[2, 1]
        d = own[0, 1] ** 2 + own[1, 1] ** 2 + own[2, 1] ** 2
        lift = SILENT * (a + d) + 1e-12
        a, d = a + lift, d + lift
        determinant = a * d - b * b
        for i in range(2):
            fields[i, 9, index[p]] = 0.0
        for c in range(3):
            for i in range(2):
                if i == 0:
                    way = (d * own[c, 0] - b * own[c, 1]) / determinant
                else:
                    way = (a * own[c, 1] - b * own[c, 0]) / determinant
                for k in range(3):
                    fields[i, 3 * c + k, index[p]] = -way * model[p, k]
                fields[i, 9, index[p]] -= way * (1.0 + q[p, c])


@numba.njit(cache=True, nogil=True)
def equations(
    q, corrected, mixture, by_normal, level, model, lines, across, index, bent, weight, outlier, information, gradient
):
    """Adds the normal equations of the mixture and the drift to information (10, 10) and gradient (10,).

    corrected (m, 3): changes seen, without the drift; bent (2, 10, n): slopes of the surface by the parameters; the
    others as in `following`. weight: of a pixel whose colours fit; what is off by `outlier` counts half.
    """
    by_slope, s, row = np.zeros((3, 2)), np.zeros((3, 3)), np.zeros((3, 10))
    left = np.zeros(3)
    for p in range(len(index)):
        square = 0.0
        for c in range(3):
            left[c] = corrected[p, c]
            for k in range(3):
                left[c] -= mixture[c, k] * model[p, k]
            square += left[c] ** 2
        _mixed(mixture, by_normal[p], s)
        _by_slope(s, level[p, 0], level[p, 1], level[p, 2], lines[p], across, by_slope)
        heavy = weight / (1.0 + square / outlier**2)
        for c in range(3):
            for k in range(10):
                row[c, k] = -by_slope[c, 0] * bent[0, k, index[p]] - by_slope[c, 1] * bent[1, k, index[p]]
            for k in range(3):
                row[c, 3 * c + k] -= model[p, k]
            row[c, 9] -= 1.0 + q[p, c]
            for i in range(10):
                gradient[i] += heavy * row[c, i] * left[c]
                for k in range(i + 1):
                    information[i, k] += heavy * row[c, i] * row[c, k]
    for i in range(10):
        for k in range(i):
            information[k, i] = information[i, k]


@numba.njit(cache=True, nogil=True)
def relax(values, free, load, factor, sweeps, enough):
    """Successive over-relaxation of minus Laplace z = load on the grid free (h, w), z held elsewhere, borders free.

    values (h, w): start and result; factor: of over-relaxation, 1 to 2; ends after `sweeps`, or when no cell changes by
    more than `enough`.
    """
    height, width = values.shape
    for _ in range(sweeps):
        most = 0.0
        for r in range(height):
            for c in range(width):
                if not free[r, c]:
                    continue
                total, count = load, 0
                if r > 0:
                    total += values[r - 1, c]
                    count += 1
                if r + 1 < height:
                    total += values[r + 1, c]
                    count += 1
                if c > 0:
                    total += values[r, c - 1]
                    count += 1
                if c + 1 < width:
                    total += values[r, c + 1]
                    count += 1
                if count:
                    change = factor * (total / count - values[r, c])
                    values[r, c] += change
                    most = max(most, abs(change))
        if most < enough:
            break


@numba.njit(cache=True, nogil=True)
def most_telling(jac, inverse, chosen, fixed):
    """Fills chosen (k,) from its place `fixed` on with indices of jac (n, 6) whose rows add most to a determinant.

    Greedy D-optimal design (Fedorov 1972): the determinant of A grows by 1 + j^T A^-1 j with row j, and A^-1 follows by
    Sherman and Morrison. inverse (6, 6) is A^-1 of the first `fixed` of chosen, and is used up. Needs len(chosen) <= n.
    """
    total, size = jac.shape
    gain = np.zeros(total)
    for n in range(total):
        value = 0.0
        for i in range(size):
            inner = 0.0
            for k in range(size):
                inner += inverse[i, k] * jac[n, k]
            value += jac[n, i] * inner
        gain[n] = value
    for k in range(fixed):
        gain[chosen[k]] = -np.inf
    half = np.zeros(size)
    for place in range(fixed, len(chosen)):
        best = 0
        for n in range(total):
            if gain[n] > gain[best]:
                best = n
        chosen[place] = best
        for i in range(size):
            inner = 0.0
            for k in range(size):
                inner += inverse[i, k] * jac[best, k]
            half[i] = inner
        over = 1.0 / (1.0 + gain[best])
        for i in range(size):
            for k in range(size):
                inverse[i, k] -= over * half[i] * half[k]
        gain[best] = -np.inf
        for n in range(total):
            along = 0.0
            for i in range(size):
                along += half[i] * jac[n, i]
            gain[n] -= over * along * along
