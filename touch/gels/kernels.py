"""Normals by colours, compiled: for each pixel the unit normal whose predicted colours are nearest to the seen ones."""

from __future__ import annotations

import math

import numba


@numba.njit(cache=True, nogil=True)
def face(by_normal, change, rest, pull, longest, steps, out):
    """Gauss-Newton over x and y of the normal, z = sqrt(1 - x^2 - y^2), from what out (n, 3) has; fills out.

    by_normal (n, 3, 3): change of a channel by the normal's; change (n, 3): what is seen; rest (n, 3): the untouched
    normals; pull: weight of staying there; longest: of (x, y), below 1.
    """
    for p in range(len(change)):
        s = by_normal[p]
        x, y = out[p, 0], out[p, 1]
        for _ in range(steps):
            z = math.sqrt(max(1.0 - x * x - y * y, 1.0 - longest * longest))
            a, b, c = pull, 0.0, pull
            g, h = -pull * (x - rest[p, 0]), -pull * (y - rest[p, 1])
            dx, dy, dz = x - rest[p, 0], y - rest[p, 1], z - rest[p, 2]
            for i in range(3):
                left = change[p, i] - s[i, 0] * dx - s[i, 1] * dy - s[i, 2] * dz
                u, v = s[i, 0] - s[i, 2] * x / z, s[i, 1] - s[i, 2] * y / z
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
        out[p, 0], out[p, 1] = x, y
        out[p, 2] = math.sqrt(max(1.0 - x * x - y * y, 1.0 - longest * longest))
