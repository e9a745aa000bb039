"""Compiled: pixels with a reading as points, and which of them to keep. Camera frame, metres."""

from __future__ import annotations

import math

import numba

from scenes.geometry.cameras import FARTHEST_READING
from vision.look.mask.piece_kernels import is_on_plane

# What a pixel of the grid is: without a reading, chosen, another.
CHOSEN, OTHER = 1, 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def read(depth, lens, box, stride, mask, uv, points):  # type: ignore[no-untyped-def]
    """Fill uv (n, 2) and points (n, 3) with the pixels of a box (u0, v0, u1, v1) of depth (h, w), every `stride` along
    each axis, that have a reading and are in the mask (h, w), or any mask of no size; returns how many. lens (fx, fy,
    cx, cy).
    """
    fx, fy, cx, cy = lens
    u0, v0, u1, v1 = box
    count = 0
    for v in range(v0, v1, stride):
        for u in range(u0, u1, stride):
            z = float(depth[v, u])
            # not true of NaN either
            if not (0.0 < z < FARTHEST_READING) or (mask.size and not mask[v, u]):
                continue
            uv[count, 0], uv[count, 1] = u, v
            points[count, 0], points[count, 1], points[count, 2] = (u - cx) / fx * z, (v - cy) / fy * z, z
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sort(depth, lens, box, stride, mask, ball, planes, noise, margins, which):  # type: ignore[no-untyped-def]
    """Mark in which (rows, columns) what the pixels that `read` reads are: CHOSEN in a ball (x, y, z, radius), off
    planes (k, 6) and in the mask, else OTHER; returns how many of each. noise, margins: see mark_planes.
    """
    fx, fy, cx, cy = lens
    chosen, others = 0, 0
    for row in range(which.shape[0]):
        v = box[1] + row * stride
        for column in range(which.shape[1]):
            u = box[0] + column * stride
            z = float(depth[v, u])
            if not 0.0 < z < FARTHEST_READING:
                continue
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            a, b, c = x - ball[0], y - ball[1], z - ball[2]
            inside = math.sqrt(a * a + b * b + c * c) < ball[3]
            inside = inside and (not mask.size or mask[v, u])
            if inside and not is_on_plane(x, y, z, planes, noise, margins):
                which[row, column] = CHOSEN
                chosen += 1
            else:
                which[row, column] = OTHER
                others += 1
    return chosen, others


@numba.njit(cache=True, nogil=True, error_model="numpy")
def take(depth, lens, box, stride, which, kind, count, uv, points):  # type: ignore[no-untyped-def]
    """Fill uv (n, 2) and points (n, 3) with n of the `count` pixels of a kind that `sort` marked, evenly."""
    fx, fy, cx, cy = lens
    most, seen, taken = len(uv), 0, 0
    for row in range(which.shape[0]):
        for column in range(which.shape[1]):
            if taken == most:
                return
            if which[row, column] != kind:
                continue
            if seen == taken * count // most:
                u, v = box[0] + column * stride, box[1] + row * stride
                z = float(depth[v, u])
                uv[taken, 0], uv[taken, 1] = u, v
                points[taken, 0], points[taken, 1], points[taken, 2] = (u - cx) / fx * z, (v - cy) / fy * z, z
                taken += 1
            seen += 1
