"""Kernels of what recorders do to depth images (h, w), float64 metres, 0 = no reading; NumPy twins in the tests."""

from __future__ import annotations

import math

import numba


@numba.njit(cache=True, nogil=True)
def smooth_rows(disparity, weight, step):  # type: ignore[no-untyped-def]
    """Recursive mean along each row, to the right and back, in place; it starts anew across `step` and missing ones."""
    height, width = disparity.shape
    for v in range(height):
        for first, last, way in ((0, width, 1), (width - 1, -1, -1)):
            mean = disparity[v, first]
            for u in range(first + way, last, way):
                here = disparity[v, u]
                if here > 0.0 and mean > 0.0 and abs(here - mean) < step:
                    mean = weight * here + (1.0 - weight) * mean
                    disparity[v, u] = mean
                else:
                    mean = here


@numba.njit(cache=True, nogil=True)
def fill_from_left(depth):  # type: ignore[no-untyped-def]
    """Missing readings take that of the pixel to their left, in place."""
    height, width = depth.shape
    for v in range(height):
        for u in range(1, width):
            if depth[v, u] == 0.0:
                depth[v, u] = depth[v, u - 1]


@numba.njit(cache=True, nogil=True)
def fill_from_farthest(depth):  # type: ignore[no-untyped-def]
    """Missing readings take the farthest of the five neighbours to their left, above and below, in place, row by row:
    those above and to the left have been filled before.
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(1, width):
            if depth[v, u] > 0.0:
                continue
            farthest = depth[v, u - 1]
            for row in range(max(v - 1, 0), min(v + 2, height)):
                farthest = max(farthest, depth[row, u - 1])
            if v > 0:
                farthest = max(farthest, depth[v - 1, u])
            if v + 1 < height:
                farthest = max(farthest, depth[v + 1, u])
            depth[v, u] = farthest


@numba.njit(cache=True, nogil=True)
def register(depth, lens, other, rotation, shift, out, source):  # type: ignore[no-untyped-def]
    """Readings as another camera has them: each pixel's square is projected, and the nearest one stays.

    lens, other: fx, fy, cx, cy (px) of either camera. rotation (3, 3), shift (3,) m: other_from_this. out (H, W) m, 0
    on entry. source (H, W): the pixel v * w + u that a reading came from.
    """
    fx, fy, cx, cy = lens
    gx, gy, hx, hy = other
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z <= 0.0:
                continue
            left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
            deep = (
                rotation[2, 0] * (u - cx) / fx * z + rotation[2, 1] * (v - cy) / fy * z + rotation[2, 2] * z + shift[2]
            )
            before = deep > 0.0
            for corner in range(4):
                x = (u + (corner % 2) - 0.5 - cx) / fx * z
                y = (v + (corner // 2) - 0.5 - cy) / fy * z
                away = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + shift[2]
                if away <= 0.0:
                    before = False
                    break
                a = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0]) / away * gx + hx
                b = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1]) / away * gy + hy
                left, right, top, bottom = min(left, a), max(right, a), min(top, b), max(bottom, b)
            if not before:
                continue
            for row in range(max(math.ceil(top), 0), min(math.floor(bottom), out.shape[0] - 1) + 1):
                for column in range(max(math.ceil(left), 0), min(math.floor(right), out.shape[1] - 1) + 1):
                    if out[row, column] == 0.0 or deep < out[row, column]:
                        out[row, column] = deep
                        source[row, column] = v * width + u
