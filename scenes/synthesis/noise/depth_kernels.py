"""Compiled loops over the pixels of a depth image: the formulas of `depth`, in single passes. Metres, radians."""

from __future__ import annotations

import math

import numba
import numpy as np

# Inverse depths of neighbours that differ by this factor are a step (12 mm at 0.6 m) even within one instance.
SAME_SURFACE = 1.02
STEEP = np.deg2rad(60.0)


@numba.njit(cache=True, nogil=True)
def incidence(fx, fy, cx, cy, u0, v0, ids, normals, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w): angle between the rays of pixels from (u0, v0) and normals (h, w, 3); 0 where ids < 0."""
    for row in range(out.shape[0]):
        y = (v0 + row - cy) / fy
        for column in range(out.shape[1]):
            if ids[row, column] < 0:
                out[row, column] = 0.0
                continue
            x = (u0 + column - cx) / fx
            along = x * normals[row, column, 0] + y * normals[row, column, 1] + normals[row, column, 2]
            out[row, column] = math.acos(min(abs(along) / math.sqrt(x * x + y * y + 1.0), 1.0))


@numba.njit(cache=True, nogil=True)
def read_depth(truth, ids, shift, angle, lateral, largest, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w): depth where each pixel looks, moved by shift (2, h, w) times its lateral sigma (see
    `depth.lateral_sigma`). Inverse depth, which is linear in the image on a plane, is interpolated within one
    instance; across instances or steps the nearest pixel is read.
    """
    height, width = truth.shape
    for row in range(height):
        for column in range(width):
            theta = min(angle[row, column], largest)
            sigma = lateral * (0.8 + 0.035 * theta / (np.pi / 2 - theta))
            x = min(max(column + sigma * shift[0, row, column], 0.0), width - 1.0)
            y = min(max(row + sigma * shift[1, row, column], 0.0), height - 1.0)
            x0, y0 = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
            x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
            low = min(truth[y0, x0], truth[y0, x1], truth[y1, x0], truth[y1, x1])
            high = max(truth[y0, x0], truth[y0, x1], truth[y1, x0], truth[y1, x1])
            owner = ids[y0, x0]
            if low > 0.0 and high < SAME_SURFACE * low and owner == ids[y0, x1] == ids[y1, x0] == ids[y1, x1]:
                a, b = x - x0, y - y0
                upper = (1 - a) / truth[y0, x0] + a / truth[y0, x1]
                lower = (1 - a) / truth[y1, x0] + a / truth[y1, x1]
                out[row, column] = 1.0 / ((1 - b) * upper + b * lower)
            else:
                out[row, column] = truth[int(np.rint(y)), int(np.rint(x))]


@numba.njit(cache=True, nogil=True)
def extremes(depth, near, far):  # type: ignore[no-untyped-def]
    """Fill near and far (h, w): least and greatest positive depth of each 3 x 3 neighbourhood; inf and 0 without."""
    height, width = depth.shape
    low, high = np.zeros(width), np.zeros(width)
    for row in range(height):
        for column in range(width):
            low[column], high[column] = np.inf, 0.0
            for other in range(max(row - 1, 0), min(row + 2, height)):
                value = depth[other, column]
                if value > 0.0:
                    low[column] = min(low[column], value)
                    high[column] = max(high[column], value)
        for column in range(width):
            first, last = max(column - 1, 0), min(column + 1, width - 1)
            near[row, column] = min(low[first], low[column], low[last])
            far[row, column] = max(high[first], high[column], high[last])


@numba.njit(cache=True, nogil=True)
def add_structured_light(depth, angle, draws, share, largest):  # type: ignore[no-untyped-def]
    """Add share times `depth.axial_sigma` times draws (h, w) to depth (h, w) in place."""
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            z = depth[row, column]
            sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
            theta = min(angle[row, column], largest)
            if theta > STEEP:
                sigma += 0.0001 / math.sqrt(max(z, 0.05)) * theta**2 / (np.pi / 2 - theta) ** 2
            depth[row, column] = z + share * sigma * draws[row, column]


@numba.njit(cache=True, nogil=True)
def read_off(depth, bias, bias_sigma, factor, focal_baseline, step):  # type: ignore[no-untyped-def]
    """In place: depth (h, w) with its bias (bias_sigma times bias (h, w)) and scale, read in steps of disparity (px,
    0: none) as `depth.quantised` does.
    """
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            z = depth[row, column]
            if bias_sigma > 0.0:
                z += bias_sigma * bias[row, column]
            z *= factor
            if step > 0.0:
                z = focal_baseline / (max(np.rint(focal_baseline / z / step), 1.0) * step) if z > 0.0 else 0.0
            depth[row, column] = z
