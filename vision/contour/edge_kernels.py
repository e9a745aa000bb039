"""Compiled loops that fit the step across each line of an outline. Pixels along each line; levels of an image."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def profiles(samples, places, normals, reach, alike, values):
    """Fill values (n, k) with what lines near each other say together, along each line's change of colour: the median
    of samples (n, k, c) of all lines whose places (n, 2) are within reach (px) of its own and whose normals (n, 2) have
    at least that cosine with its own.

    The change of colour is what they sum up to before the middle less what they do behind it, as a unit vector.
    """
    n, k, c = samples.shape
    near, room, change = np.zeros(n, np.int64), np.zeros(n), np.zeros(c)
    for i in range(n):
        count = 0
        for j in range(n):
            a, b = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1]
            cosine = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1]
            if a * a + b * b < reach * reach and cosine >= alike:
                near[count] = j
                count += 1
        size = 0.0
        for q in range(c):
            change[q] = 0.0
            for t in range(count):
                for s in range(k // 2):
                    change[q] += float(samples[near[t], s, q]) - float(samples[near[t], k - 1 - s, q])
            size += change[q] * change[q]
        size = math.sqrt(size)
        for q in range(c):
            change[q] = change[q] / size if size > 0.0 else 0.0
        for s in range(k):
            for t in range(count):
                value = 0.0
                for q in range(c):
                    value += change[q] * float(samples[near[t], s, q])
                u = t
                while u > 0 and room[u - 1] > value:
                    room[u] = room[u - 1]
                    u -= 1
                room[u] = value
            middle = count // 2
            values[i, s] = room[middle] if count % 2 == 1 else 0.5 * (room[middle] + room[middle - 1])


@numba.njit(cache=True, nogil=True)
def steps(values, first, start, smear, window, rounding, rounds, edges):
    """Fill edges (n, 3) with the step of each line's values (n, k) next to start (n,): where it is (px), the standard
    deviation of that (px; inf where there is none), and how much the values fall there.

    Least squares of a - h Phi((offset - x) / smear) over the offsets within `window` (px) of x, by Gauss-Newton, a and
    h solved for along the way. Values are at offsets first, first + 1, ...; rounding: the least standard deviation of
    one. start is NaN where no step is looked for.
    """
    n, k = values.shape
    for i in range(n):
        x, deviation, height = start[i], np.inf, 0.0
        for _ in range(rounds):
            deviation = np.inf
            if not abs(x) < k:
                break
            low, high = math.ceil(x - window - first), math.floor(x + window - first)
            if low < 0 or high >= k:
                break
            m = high - low + 1
            f1, f2, y1, fy = 0.0, 0.0, 0.0, 0.0
            for j in range(low, high + 1):
                f = 0.5 * math.erfc((x - first - j) / (smear * math.sqrt(2.0)))
                f1 += f
                f2 += f * f
                y1 += values[i, j]
                fy += f * values[i, j]
            det = m * f2 - f1 * f1
            if det < 1e-6:
                break
            rise = (m * fy - f1 * y1) / det
            level, height = (y1 - rise * f1) / m, -rise
            d1, df, d2, dr, rr = 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(low, high + 1):
                z = (first + j - x) / smear
                f = 0.5 * math.erfc(-z / math.sqrt(2.0))
                slope = -rise * math.exp(-0.5 * z * z) / (smear * math.sqrt(2.0 * math.pi))
                off = values[i, j] - level - rise * f
                d1 += slope
                df += slope * f
                d2 += slope * slope
                dr += slope * off
                rr += off * off
            # of the slope, what neither a nor h can do
            own = d2 - (d1 * (d1 * f2 - df * f1) + df * (df * m - d1 * f1)) / det
            if own < 1e-9:
                break
            step = min(max(dr / own, -1.0), 1.0)
            x += step
            deviation = math.sqrt(max(rr / max(m - 3, 1), rounding * rounding) / own)
            if abs(step) < 0.02:
                break
        edges[i, 0], edges[i, 1], edges[i, 2] = x, deviation, height


@numba.njit(cache=True, nogil=True)
def weigh(edges, variance, rows, moved, wrong, share, left, weight):
    """Where a line has an edge, a standard deviation edges[:, 1] that is finite, put into left (n,) how far (px) its
    place is from that, what all lines share left in, and into weight (n,) what that counts; as `kernels.weigh`.

    edges (n, 2 or more): where each is (px); variance (n,) of it (px^2); rows (n, m), moved (m,), share (n,) as there;
    wrong: odds that an edge is another, times its density there.
    """
    for i in range(len(edges)):
        if not np.isfinite(edges[i, 1]):
            continue
        posed, expected = 0.0, 0.0
        for k in range(rows.shape[1]):
            expected += rows[i, k] * moved[k]
            if k < 6:
                posed = expected
        off = edges[i, 0] - expected
        odds = wrong * np.sqrt(2.0 * np.pi * variance[i]) * np.exp(min(0.5 * off * off / variance[i], 50.0))
        left[i] = posed - edges[i, 0]
        weight[i] = share[i] / variance[i] / (1.0 + odds)
