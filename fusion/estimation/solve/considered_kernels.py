"""What pixels tell of the errors that they share, where it is only considered: as far as a pose explains it as well.

A bias of depth that nothing of known shape shows is not to be solved for by what an object's own pixels are off: an
outline that a camera has fattened is explained by a scale, and the object moved by millimetres. Considering it (Schmidt
1966) keeps the pose where pixels alone put it, as uncertain as the bias makes it there; contacts then move it along
what is uncertain. Both at once are the normal equations in which what pixels are off is projected on what a pose makes
of it, wherever it is multiplied by scale and bias.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT

# Unknowns of the pose.
POSE = 6
# Added to a unit diagonal: keeps the factor of a singular system finite, and changes no digit of another.
JITTER = 1e-9


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def add_of_pose(design, information, residuals, count, part, pull):
    """Add the first lines (6, m) of design^T diag(information) design to part, and those of its product with residuals
    to pull (6,), over the first `count` rows.
    """
    m = design.shape[1]
    n = 0
    while n + 4 <= count:
        q0, q1, q2, q3 = information[n], information[n + 1], information[n + 2], information[n + 3]
        r0, r1, r2, r3 = residuals[n], residuals[n + 1], residuals[n + 2], residuals[n + 3]
        for i in range(POSE):
            c0, c1, c2, c3 = design[n, i] * q0, design[n + 1, i] * q1, design[n + 2, i] * q2, design[n + 3, i] * q3
            pull[i] += c0 * r0 + c1 * r1 + c2 * r2 + c3 * r3
            for j in range(m):
                part[i, j] += c0 * design[n, j] + c1 * design[n + 1, j] + c2 * design[n + 2, j] + c3 * design[n + 3, j]
        n += 4
    for k in range(n, count):
        for i in range(POSE):
            c = design[k, i] * information[k]
            pull[i] += c * residuals[k]
            for j in range(m):
                part[i, j] += c * design[k, j]


@numba.njit(cache=True, nogil=True)
def confounded(part, pull):
    """Fill in what pixels tell of scale and bias as far as a pose explains it: of their products part (m, m), of which
    the pose's lines (6, m) are there, the rest of the lower triangle, and of those with residuals, pull (m,), the rest.

    Residuals are projected on what a turn or a move of the object makes of them: C A^-1 C^T and C A^-1 p, with A and
    C^T the halves of the pose's lines and p its pull. A direction that no pixel tells of has no part in it.
    """
    k = part.shape[1] - POSE
    scale, factor = np.zeros(POSE), np.zeros((POSE, POSE))
    for i in range(POSE):
        scale[i] = 1.0 / math.sqrt(part[i, i]) if part[i, i] > 0.0 else 0.0
    for i in range(POSE):
        for j in range(i):
            factor[i, j] = part[i, j] * scale[i] * scale[j]
        factor[i, i] = 1.0 + JITTER
    for j in range(POSE):
        for p in range(j):
            for i in range(j, POSE):
                factor[i, j] -= factor[i, p] * factor[j, p]
        root = math.sqrt(max(factor[j, j], JITTER))
        for i in range(j, POSE):
            factor[i, j] /= root
    half, last = np.zeros((POSE, k)), np.zeros(POSE)
    for i in range(POSE):
        last[i] = pull[i] * scale[i]
        for j in range(k):
            half[i, j] = part[i, POSE + j] * scale[i]
        for p in range(i):
            last[i] -= factor[i, p] * last[p]
            for j in range(k):
                half[i, j] -= factor[i, p] * half[p, j]
        last[i] /= factor[i, i]
        for j in range(k):
            half[i, j] /= factor[i, i]
    for i in range(k):
        pull[POSE + i] = 0.0
        for p in range(POSE):
            pull[POSE + i] += half[p, i] * last[p]
            part[POSE + i, p] = part[p, POSE + i]
        for j in range(i + 1):
            total = 0.0
            for p in range(POSE):
                total += half[p, i] * half[p, j]
            part[POSE + i, POSE + j] = total


@numba.njit(cache=True, nogil=True)
def field_spread(points, gain, length, out):
    """Fill out (m, m) with what a smooth error of standard deviation 1 at points (n, 3), whose correlation is
    exp(-|p - q|^2 / (2 length^2)), makes of m unknowns that an error at each moves by a row of gain (n, m).
    """
    count, size = gain.shape
    sharpness = -0.5 / length**2
    moved = np.zeros(size)
    for i in range(count):
        moved[:] = gain[i]
        for j in range(i):
            square = 0.0
            for axis in range(3):
                square += (points[i, axis] - points[j, axis]) ** 2
            # both orders of each pair
            shared = 2.0 * math.exp(sharpness * square)
            for k in range(size):
                moved[k] += shared * gain[j, k]
        for k in range(size):
            for m in range(size):
                out[k, m] += 0.5 * (gain[i, k] * moved[m] + moved[k] * gain[i, m])
