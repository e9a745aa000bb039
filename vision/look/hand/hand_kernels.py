"""Compiled: what the pixels of a hand say of its place. Camera frame, metres, radians."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING

# Nearer than this (m) before the camera no point is looked up.
LEAST_AHEAD = 1e-3


@numba.njit(cache=True, nogil=True)
def pulls(points, distance, gradient, rotation, centre, gate, weight, direction, jacobian, robust, hessian, pull):  # type: ignore[no-untyped-def]
    """Add to hessian (6, 6) and pull (6,) the Gauss-Newton matrix and gradient of points (n, 3) with weight (n,) each,
    which are so far, distance (n,), from a hand, whose gradient (n, 3) in its own frame is turned by rotation (3, 3)
    into direction (n, 3).

    Fills jacobian (n, 6): how distances change with a turn and a move of the hand about centre (3,): the hand moves,
    the points stay, and the distance falls by g . (omega x (p - c) + v); and robust (n,): Tukey's weights, 0 beyond the
    gate (m).
    """
    for n in range(len(points)):
        for i in range(3):
            turned = rotation[i, 0] * gradient[n, 0] + rotation[i, 1] * gradient[n, 1] + rotation[i, 2] * gradient[n, 2]
            direction[n, i] = turned
            jacobian[n, 3 + i] = -turned
        x, y, z = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        a, b, c = direction[n, 0], direction[n, 1], direction[n, 2]
        jacobian[n, 0], jacobian[n, 1], jacobian[n, 2] = z * b - y * c, x * c - z * a, y * a - x * b
        share = distance[n] / gate
        left = max(0.0, 1.0 - share * share)
        robust[n] = left * left
        own = weight[n] * robust[n]
        if own == 0.0:
            continue
        for i in range(6):
            scaled = own * jacobian[n, i]
            pull[i] += scaled * distance[n]
            for j in range(i + 1):
                hessian[i, j] += scaled * jacobian[n, j]
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]


@numba.njit(cache=True, nogil=True)
def explained(points, along, across, away, lens, depth, near, past, out):  # type: ignore[no-untyped-def]
    """Count into out (c, b, a), for points (n, 3) of a hand in the camera's frame moved by every one of `along` (a,) in
    x, `across` (b,) in y and `away` (c,) in z, those that are read where they would be, within `near` (m), less those
    that the camera reads farther than `past` (m) behind.

    What is read in front of one hides it and tells nothing, nor does a pixel without a reading in depth (h, w). lens:
    fx, fy, cx, cy. A column is that of all moves in y, and a row that of all in x: each is worked out once. Which
    readings count is a toss-up, so that they are added up without asking.
    """
    fx, fy, cx, cy = lens
    height, width = depth.shape
    columns, inside = np.zeros(len(along), np.int64), np.zeros(len(along), np.int64)
    for n in range(len(points)):
        for c in range(len(away)):
            z = points[n, 2] + away[c]
            if z <= past:
                continue
            for a in range(len(along)):
                u = math.floor(fx * (points[n, 0] + along[a]) / z + cx + 0.5)
                inside[a] = (u >= 0) & (u < width)
                columns[a] = u if inside[a] else 0
            for b in range(len(across)):
                v = math.floor(fy * (points[n, 1] + across[b]) / z + cy + 0.5)
                if v < 0 or v >= height:
                    continue
                for a in range(len(along)):
                    read = depth[v, columns[a]]
                    behind = read - z
                    seen = inside[a] * ((read > 0.0) & (read < FARTHEST_READING))
                    at = (behind < near) & (behind > -near) & (behind <= past)
                    out[c, b, a] += seen * (np.int64(at) - np.int64(behind > past))


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def seen_past(points, lens, depth, near):  # type: ignore[no-untyped-def]
    """How many of points (n, 3) of a hand, camera frame, are in the image with a reading in depth (h, w) at their
    pixels, and how many of those are farther away there by more than near (m). lens: fx, fy, cx, cy.
    """
    fx, fy, cx, cy = lens
    height, width = depth.shape
    read = past = 0
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not z > LEAST_AHEAD:
            continue
        u, v = np.rint(fx * x / z + cx), np.rint(fy * y / z + cy)
        if not (0.0 <= u < width and 0.0 <= v < height):
            continue
        reading = np.float64(depth[int(v), int(u)])
        if 0.0 < reading < FARTHEST_READING:
            read += 1
            past += reading > z + near
    return read, past
