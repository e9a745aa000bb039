"""Compiled: the surface about a pixel of a depth image. Camera frame, metres."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING

# Readings along each side of a window at most: of more the places between say the same.
WINDOW = 11


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def surface_at(depth, lens, uv, reach, fewest, roughest, places, normals, good):  # type: ignore[no-untyped-def]
    """Fill places (n, 3), normals (n, 3) that face the camera, and good (n,): the plane through what is read within
    reach (m) of the points that pixels uv (n, 2) of depth (h, w) show, and whether there is one.

    In an image of a plane 1 / z is linear, and so it is fitted, by least squares: the noise of a reading is along its
    ray. lens: fx, fy, cx, cy. There is none through fewer than `fewest` readings, or such as lie on a line, or through
    those that are off by more than roughest (m, standard deviation).
    """
    fx, fy, cx, cy = lens
    height, width = depth.shape
    for n in range(uv.shape[0]):
        u0, v0 = uv[n, 0], uv[n, 1]
        z0 = np.float64(depth[v0, u0])
        good[n] = False
        if not 0.0 < z0 < FARTHEST_READING:
            continue
        x0, y0 = (u0 - cx) / fx, (v0 - cy) / fy
        half_u, half_v = int(min(reach * fx / z0, width)), int(min(reach * fy / z0, height))
        step_u, step_v = 1 + 2 * half_u // WINDOW, 1 + 2 * half_v // WINDOW
        # of places about the pixel in reaches, and of how much less far they are than it, as shares
        count = sx = sy = sq = sxx = sxy = syy = sxq = syq = sqq = 0.0
        for v in range(max(v0 - half_v // step_v * step_v, v0 % step_v), min(v0 + half_v + 1, height), step_v):
            for u in range(max(u0 - half_u // step_u * step_u, u0 % step_u), min(u0 + half_u + 1, width), step_u):
                z = np.float64(depth[v, u])
                if not 0.0 < z < FARTHEST_READING:
                    continue
                x, y = (u - cx) / fx, (v - cy) / fy
                a, b, c = x * z - x0 * z0, y * z - y0 * z0, z - z0
                if a * a + b * b + c * c > reach * reach:
                    continue
                x, y, q = (x - x0) * z0 / reach, (y - y0) * z0 / reach, z0 / z - 1.0
                count += 1.0
                sx, sy, sq = sx + x, sy + y, sq + q
                sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
                sxq, syq, sqq = sxq + x * q, syq + y * q, sqq + q * q
        if count < fewest:
            continue
        mx, my, mq = sx / count, sy / count, sq / count
        xx, xy, yy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
        xq, yq, qq = sxq / count - mx * mq, syq / count - my * mq, sqq / count - mq * mq
        apart = xx * yy - xy * xy
        # a line has no second direction
        if not apart > 0.01 * (xx + yy) * (xx + yy):
            continue
        slope_x, slope_y = (xq * yy - yq * xy) / apart, (yq * xx - xq * xy) / apart
        rough = z0 * math.sqrt(max(qq - slope_x * xq - slope_y * yq, 0.0))
        a, b = slope_x / reach, slope_y / reach
        inverse = (1.0 + mq - slope_x * mx - slope_y * my) / z0
        c = inverse - a * x0 - b * y0
        length = math.sqrt(a * a + b * b + c * c)
        # both are positive for a plane before the camera
        if not (inverse > 0.0 and length > 0.0):
            continue
        # rays through the pixel meet the plane at this slant
        if rough * inverse / (length * math.sqrt(x0 * x0 + y0 * y0 + 1.0)) > roughest:
            continue
        normals[n, 0], normals[n, 1], normals[n, 2] = -a / length, -b / length, -c / length
        places[n, 0], places[n, 1], places[n, 2] = x0 / inverse, y0 / inverse, 1.0 / inverse
        good[n] = True
