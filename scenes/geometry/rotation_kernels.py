"""Compiled rotations, and batches of poses moved, compared, and taken apart for kernels: of a few poses NumPy takes ten
times as long, most of it between its calls. Metres, radians.

What is compiled is kept on disk by the date of its own file: after a change here, delete the `__pycache__` of callers.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT


@numba.njit(cache=True, nogil=True, **LENT)
def log_rotation(r, out):
    """Rotation vector of r (3, 3) into out (3,), through the quaternion."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= r[0, 0] and trace >= r[1, 1] and trace >= r[2, 2]:
        w = 1.0 + trace
        x = r[2, 1] - r[1, 2]
        y = r[0, 2] - r[2, 0]
        z = r[1, 0] - r[0, 1]
    elif r[0, 0] >= r[1, 1] and r[0, 0] >= r[2, 2]:
        w = r[2, 1] - r[1, 2]
        x = 1.0 + r[0, 0] - r[1, 1] - r[2, 2]
        y = r[1, 0] + r[0, 1]
        z = r[2, 0] + r[0, 2]
    elif r[1, 1] >= r[2, 2]:
        w = r[0, 2] - r[2, 0]
        x = r[1, 0] + r[0, 1]
        y = 1.0 + r[1, 1] - r[0, 0] - r[2, 2]
        z = r[2, 1] + r[1, 2]
    else:
        w = r[1, 0] - r[0, 1]
        x = r[2, 0] + r[0, 2]
        y = r[2, 1] + r[1, 2]
        z = 1.0 + r[2, 2] - r[0, 0] - r[1, 1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 / w if length < 1e-12 * abs(w) else 2.0 * math.atan2(length, w) / length
    out[0] = factor * x
    out[1] = factor * y
    out[2] = factor * z


@numba.njit(cache=True, nogil=True, **LENT)
def exp_times(theta, r, out):
    """Out = exp(theta) r."""
    square = theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2]
    angle = math.sqrt(square)
    if square < 1e-8:
        a = 1.0 - square / 6.0
        b = 0.5 - square / 24.0
    else:
        a = math.sin(angle) / angle
        s = math.sin(0.5 * angle) / angle
        b = 2.0 * s * s
    x, y, z = theta[0], theta[1], theta[2]
    e00 = 1.0 - b * (y * y + z * z)
    e01 = b * x * y - a * z
    e02 = b * x * z + a * y
    e10 = b * x * y + a * z
    e11 = 1.0 - b * (x * x + z * z)
    e12 = b * y * z - a * x
    e20 = b * x * z - a * y
    e21 = b * y * z + a * x
    e22 = 1.0 - b * (x * x + y * y)
    for j in range(3):
        p, q, s = r[0, j], r[1, j], r[2, j]
        out[0, j] = e00 * p + e01 * q + e02 * s
        out[1, j] = e10 * p + e11 * q + e12 * s
        out[2, j] = e20 * p + e21 * q + e22 * s


@numba.njit(cache=True, nogil=True, **LENT)
def apply_each(transforms, which, points, out):
    """Fill out (n, 3) with each of points (n, 3) by its own of transforms (k, 4, 4), which (n,) one that is."""
    for n in range(points.shape[0]):
        pose = transforms[which[n]]
        for i in range(3):
            turned = (pose[i, 0] * points[n, 0] + pose[i, 2] * points[n, 2]) + pose[i, 1] * points[n, 1]
            out[n, i] = turned + pose[i, 3]


@numba.njit(cache=True, nogil=True, **LENT)
def apply_in_ball(transforms, which, points, centre, radius, out):
    """Put those of points (n, 3) into out (n, 3), each by its own of transforms (k, 4, 4) as in apply_each, that end
    nearer than `radius` to centre (3,); returns how many.
    """
    count = 0
    for n in range(points.shape[0]):
        pose, square = transforms[which[n]], 0.0
        for i in range(3):
            turned = (pose[i, 0] * points[n, 0] + pose[i, 2] * points[n, 2]) + pose[i, 1] * points[n, 1]
            out[count, i] = turned + pose[i, 3]
            square += (out[count, i] - centre[i]) ** 2
        if square < radius * radius:
            count += 1
    return count


@numba.njit(cache=True, nogil=True)
def perturbed(poses, deltas, centre, out):
    """Fill out (n, 4, 4) with poses (n, 4, 4), or the one of (1, 4, 4), turned by deltas (n, 6)[:3] about centre (3,)
    and moved by the rest: poses.perturb.
    """
    turned = np.zeros((3, 3))
    for n in range(deltas.shape[0]):
        pose = poses[n if poses.shape[0] > 1 else 0]
        exp_times(deltas[n, :3], pose[:3, :3], turned)
        for i in range(3):
            place = pose[i, 3] + deltas[n, 3 + i]
            for j in range(3):
                place += (pose[i, j] - turned[i, j]) * centre[j]
                out[n, i, j] = turned[i, j]
            out[n, i, 3] = place
            out[n, 3, i] = 0.0
        out[n, 3, 3] = 1.0


@numba.njit(cache=True, nogil=True)
def differences(poses, references, centre, out):
    """Fill out (n, 6) with what takes references (n, 4, 4), or the one of (1, 4, 4), to poses (n, 4, 4):
    poses.difference.
    """
    turn = np.zeros((3, 3))
    for n in range(poses.shape[0]):
        pose, reference = poses[n], references[n if references.shape[0] > 1 else 0]
        for i in range(3):
            moved = pose[i, 3] - reference[i, 3]
            for j in range(3):
                moved += (pose[i, j] - reference[i, j]) * centre[j]
                turn[i, j] = pose[i, 0] * reference[j, 0] + pose[i, 1] * reference[j, 1] + pose[i, 2] * reference[j, 2]
            out[n, 3 + i] = moved
        log_rotation(turn, out[n])


@numba.njit(cache=True, nogil=True, **LENT)
def split(poses, centroid, rotations, middles):
    """Fill rotations (n, 3, 3) and middles (n, 3), places of the centroid (3,), of poses (n, 4, 4); whether all their
    numbers are finite.
    """
    finite = True
    for n in range(poses.shape[0]):
        for i in range(4):
            for j in range(4):
                finite = finite and math.isfinite(poses[n, i, j])
        for i in range(3):
            middles[n, i] = poses[n, i, 3]
            for j in range(3):
                rotations[n, i, j] = poses[n, i, j]
                middles[n, i] += poses[n, i, j] * centroid[j]
    return finite


@numba.njit(cache=True, nogil=True)
def joined(rotations, middles, centroid, out):
    """Fill out (n, 4, 4) from rotations (n, 3, 3), straightened as by poses.straightened, and middles (n, 3), places of
    the centroid (3,).
    """
    gram = np.zeros((3, 3))
    for n in range(rotations.shape[0]):
        r = rotations[n]
        for i in range(3):
            for j in range(3):
                gram[i, j] = -0.5 * (r[0, i] * r[0, j] + r[1, i] * r[1, j] + r[2, i] * r[2, j])
            gram[i, i] += 1.5
        for i in range(3):
            place = middles[n, i]
            for j in range(3):
                out[n, i, j] = r[i, 0] * gram[0, j] + r[i, 1] * gram[1, j] + r[i, 2] * gram[2, j]
                place -= out[n, i, j] * centroid[j]
            out[n, i, 3] = place
            out[n, 3, i] = 0.0
        out[n, 3, 3] = 1.0
