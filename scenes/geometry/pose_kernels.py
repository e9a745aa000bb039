"""Compiled batches of poses: moved, compared, and taken apart for the kernels of alignment. Metres, radians.

Of a few poses NumPy takes ten times as long, most of it between its calls.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.rotation_kernels import exp_times, log_rotation


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


@numba.njit(cache=True, nogil=True)
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
