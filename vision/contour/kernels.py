"""Compiled loops over the lines across an outline. Pixels along each line; logarithms are natural."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def offset_tables(bins, ratios, group, temper, first, near, log_p, sides):
    """Fill log_p (n, m): log probability of each offset at which a line's colours change from object to ground; and
    sides (n, 2): mean log ratio of the samples inside and outside, those from near[0] to near[1] from the middle one.

    bins (n, k): the colour of each sample of a line, from inside to outside; ratios (g, b): log of how much likelier a
    colour is inside than outside, in each group of lines; group (n,). Offset j lies before sample first + j: what is
    before it is the object's, the rest is not.
    """
    n, k = bins.shape
    m = log_p.shape[1]
    for i in range(n):
        ratio = ratios[group[i]]
        inner, outer = 0.0, 0.0
        for d in range(near[0], near[1] + 1):
            inner += ratio[bins[i, k // 2 - d]]
            outer += ratio[bins[i, k // 2 + d]]
        sides[i, 0] = inner / (near[1] - near[0] + 1)
        sides[i, 1] = outer / (near[1] - near[0] + 1)
        total = 0.0
        for s in range(first):
            total += ratio[bins[i, s]]
        best = -np.inf
        for j in range(m):
            value = temper * total
            log_p[i, j] = value
            best = max(best, value)
            if first + j < k:
                total += ratio[bins[i, first + j]]
        mass = 0.0
        for j in range(m):
            mass += np.exp(log_p[i, j] - best)
        norm = best + np.log(mass)
        for j in range(m):
            log_p[i, j] -= norm


@numba.njit(cache=True, nogil=True)
def sites(log_p, lowest, expected, window, mean, precision):
    """Fill mean (n,) and precision (n,): the Gaussian that stands for each line near where it is expected.

    log_p (n, m) over offsets lowest, lowest + 1, ... (px). The table times a Gaussian of standard deviation window
    about expected (n,) has two moments; what is left when that Gaussian is divided out again says what the line says
    there (Minka, UAI 2001). A line that says nothing there, or less than nothing, has precision 0.
    """
    n, m = log_p.shape
    own = 1.0 / (window * window)
    for i in range(n):
        best = -np.inf
        for j in range(m):
            off = lowest + j - expected[i]
            best = max(best, log_p[i, j] - 0.5 * own * off * off)
        mass, first, second = 0.0, 0.0, 0.0
        for j in range(m):
            off = lowest + j - expected[i]
            p = np.exp(log_p[i, j] - 0.5 * own * off * off - best)
            mass += p
            first += p * off
            second += p * off * off
        middle = first / mass
        variance = max(second / mass - middle * middle, 0.0) + 1.0 / 12.0
        left = 1.0 / variance - own
        if left <= 0.0:
            mean[i], precision[i] = expected[i], 0.0
        else:
            mean[i], precision[i] = expected[i] + middle / variance / left, left


@numba.njit(cache=True, nogil=True)
def shift_scores(table, lowest, normals, most, unknown, scores):
    """Fill scores (2 most + 1, 2 most + 1): mean over the lines of table (n, m), over offsets lowest, lowest + 1, ...
    (px), where a shift of the whole outline by (dv, du) px, rows first, moves each; unknown: outside its table.
    """
    n, m = table.shape
    for a in range(2 * most + 1):
        for b in range(2 * most + 1):
            total = 0.0
            for i in range(n):
                along = (b - most) * normals[i, 0] + (a - most) * normals[i, 1] - lowest
                j = int(np.floor(along + 0.5))
                total += table[i, j] if 0 <= j < m else unknown
            scores[a, b] = total / n
