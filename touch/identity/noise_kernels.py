"""Compiled likelihood of contacts at poses, the size of their noise summed over, for touch.identity.noise."""

from __future__ import annotations

import math

import numba
import numpy as np

# Factors multiplied before the logarithm is taken: each is from 0.01 to 1e6 or so, and their product no overflow.
AT_ONCE = 8
# Logarithms this far below the largest add a billionth of what a thousand of the largest do.
NOTHING = 30.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def log_likelihoods(distances, along, known, scales, normals, worths, beliefs, power, out):
    """Fill out (p,): log likelihood of contacts at p poses, to a power, summed over each scale b of their noise, share
    f of false ones and worth q of normals.

    distances (p, n): of contacts from the surface (m); below 0 where a contact lies on it because the pose was made so,
    which tells nothing of the noise. along (p, n): cosines between felt and true normal;
    known (n,): which contacts have one. scales (b,) m. normals (q, 3): concentration, share of meaningless ones, sign.
    worths (f, 2): share of false contacts, and their density (1/m). beliefs (b, f, q): logarithms of what is believed.
    """
    poses, count = distances.shape
    points, directions = np.zeros((count, len(scales))), np.ones((count, len(normals)))
    logs = np.zeros(beliefs.shape)
    for p in range(poses):
        largest = -np.inf
        for i in range(count):
            for b in range(len(scales)):
                if distances[p, i] < 0.0:
                    points[i, b] = 0.5 / scales[0]
                else:
                    points[i, b] = 0.5 * math.exp(-distances[p, i] / scales[b]) / scales[b]
            if known[i]:
                for q in range(len(normals)):
                    # von Mises and Fisher's density, over that of directions that mean nothing
                    sharp = normals[q, 0]
                    whole = 2.0 * sharp / (1.0 - math.exp(-2.0 * sharp))
                    density = whole * math.exp(sharp * (normals[q, 2] * along[p, i] - 1.0))
                    directions[i, q] = (1.0 - normals[q, 1]) * density + normals[q, 1]
        for b in range(len(scales)):
            for f in range(len(worths)):
                true, false = 1.0 - worths[f, 0], worths[f, 0] * worths[f, 1]
                for q in range(len(normals)):
                    total, product = 0.0, 1.0
                    for i in range(count):
                        product *= true * points[i, b] * directions[i, q] + false
                        if i % AT_ONCE == AT_ONCE - 1:
                            total += math.log(product)
                            product = 1.0
                    logs[b, f, q] = beliefs[b, f, q] + power * (total + math.log(product))
                    largest = max(largest, logs[b, f, q])
        total = 0.0
        for log in logs.flat:
            if log > largest - NOTHING:
                total += math.exp(log - largest)
        out[p] = largest + math.log(total)
