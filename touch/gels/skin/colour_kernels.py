"""What an image's colours differ by from the untouched skin's, compiled: the exposure's drift, and by how much more."""

from __future__ import annotations

import math

import numba
import numpy as np

# Bins along each channel in which the most frequent difference is looked for.
BINS = 13


@numba.njit(cache=True, nogil=True)
def most_frequent(values, most, shifts, fewest):
    """(3,) the mode of relative differences (n, 3) of all channels together, each up to `most`; 0 if there is none.

    Untouched pixels are alike in all channels; those on a contact may be the most in one, hardly ever in all three.
    From the middle of the fullest bin, `shifts` steps to the mean about it (mean shift; Comaniciu and Meer, PAMI 2002);
    fewer than the share `fewest` of all alike are none.
    """
    width = 2.0 * most / BINS
    counts = np.zeros((BINS, BINS, BINS), dtype=np.int64)
    for p in range(len(values)):
        a, b, c = values[p, 0], values[p, 1], values[p, 2]
        if abs(a) < most and abs(b) < most and abs(c) < most:
            i, j, k = int((a + most) / width), int((b + most) / width), int((c + most) / width)
            counts[min(i, BINS - 1), min(j, BINS - 1), min(k, BINS - 1)] += 1
    found, fullest = np.zeros(3), 0
    for i in range(BINS):
        for j in range(BINS):
            for k in range(BINS):
                if counts[i, j, k] > fullest:
                    fullest = counts[i, j, k]
                    found[0], found[1], found[2] = (i + 0.5) * width, (j + 0.5) * width, (k + 0.5) * width
    if fullest == 0:
        return np.zeros(3)
    found -= most
    for _ in range(shifts):  # the mean about the fullest bin is finer than the bin
        total, near = np.zeros(3), 0
        for p in range(len(values)):
            a, b, c = values[p, 0], values[p, 1], values[p, 2]
            if not (abs(a) < most and abs(b) < most and abs(c) < most):
                continue
            if abs(a - found[0]) < width and abs(b - found[1]) < width and abs(c - found[2]) < width:
                total[0] += a
                total[1] += b
                total[2] += c
                near += 1
        if near == 0 or near < fewest * len(values):
            return np.zeros(3)
        found = total / near
    return found


@numba.njit(cache=True, nogil=True)
def judge(blurred, level, drift, noise, smooth, size, counts):
    """Of smoothed differences (h, w, 3) and the background's level (h, w, 3): smooth (h, w, 3) without the exposure's
    drift (3,); how much that is, in sigmas of noise (3,), size (h, w), and in counts (h, w). Fills the three.
    """
    for v in range(blurred.shape[0]):
        for u in range(blurred.shape[1]):
            by_noise, plain = 0.0, 0.0
            for c in range(3):
                left = blurred[v, u, c] - drift[c] * level[v, u, c]
                smooth[v, u, c] = left
                by_noise += (left / noise[c]) ** 2
                plain += left**2
            size[v, u], counts[v, u] = math.sqrt(by_noise), math.sqrt(plain)
