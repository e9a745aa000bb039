"""Compiled: which pixels may be the object's by where they are, and samples of their pieces. Camera frame, metres."""

from __future__ import annotations

import numba
import numpy as np

from scenes.geometry.cameras import FARTHEST_READING
from vision.look.mask.piece_kernels import is_on_plane


@numba.njit(cache=True, nogil=True, error_model="numpy")
def candidates(depth, lens, box, ball, planes, noise, margins, z, good):  # type: ignore[no-untyped-def]
    """Fill z (h, w) with the depths of a box (u0, v0, u1, v1), 0 for no reading, and good (h, w) with whether a pixel
    has one, in a ball (x, y, z, radius) and off planes (k, 6). lens (fx, fy, cx, cy); noise, margins: see mark_planes.
    """
    fx, fy, cx, cy = lens
    along, reach = np.zeros(z.shape[1]), ball[3] * ball[3]
    for column in range(z.shape[1]):
        along[column] = (box[0] + column - cx) / fx
    for row in range(z.shape[0]):
        across = (box[1] + row - cy) / fy
        for column in range(z.shape[1]):
            there = float(depth[box[1] + row, box[0] + column])
            # not true of NaN either
            if not 0.0 < there < FARTHEST_READING:
                continue
            z[row, column] = there
            c = there - ball[2]
            if not c * c < reach:
                continue
            x, y = along[column] * there, across * there
            a, b = x - ball[0], y - ball[1]
            if a * a + b * b + c * c < reach:
                good[row, column] = not is_on_plane(x, y, there, planes, noise, margins)


# Farther than anything is drawn (m): where there is no hand, nothing is nearer than it.
_BEYOND = np.float32(1e3)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lay_hand(drawn, nearest, farthest, there):  # type: ignore[no-untyped-def]
    """Fill nearest and farthest (h, w) with the depth (m) at which a hand is drawn (h, w), inf where it is not: that is
    beyond all in the one and 0 in the other; and there (h, w) with 1 where it is.
    """
    for row in range(drawn.shape[0]):
        for column in range(drawn.shape[1]):
            depth = drawn[row, column]
            nearest[row, column] = _BEYOND
            if np.isfinite(depth):
                nearest[row, column] = farthest[row, column] = depth
                there[row, column] = 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def part(good, close, near, whole, around, inner, outer, uncertain):  # type: ignore[no-untyped-def]
    """Part good pixels (h, w) by where the hand is drawn: inner are those close to it around which it is all over,
    whole (h, w), uncertain the others that are close; outer those beside it, around (h, w), of which no hand is near,
    near (h, w) m.
    """
    for row in range(good.shape[0]):
        for column in range(good.shape[1]):
            if close[row, column]:
                inner[row, column] = whole[row, column] > 0
                uncertain[row, column] = not inner[row, column]
            elif good[row, column]:
                outer[row, column] = around[row, column] > 0 and near[row, column] >= _BEYOND


@numba.njit(cache=True, nogil=True, error_model="numpy")
def close_to(z, good, near, far, margin, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w) with whether good pixels at depths z (h, w) are between near and far (h, w), in single precision,
    or beside them by less than `margin` (m).
    """
    for row in range(z.shape[0]):
        for column in range(z.shape[1]):
            low, high = np.float32(near[row, column] - margin), np.float32(far[row, column] + margin)
            out[row, column] = good[row, column] and z[row, column] > low and z[row, column] < high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def every(pieces, step, first, lens, corner, z, points):  # type: ignore[no-untyped-def]
    """Fill points (n, 3) with every step[p]-th pixel of piece p of pieces (h, w), in row-major order from first[p] on;
    of those with a step of 0 none. z (h, w): depths; corner (u, v): the first pixel's.
    """
    fx, fy, cx, cy = lens
    seen = np.zeros(len(step), dtype=np.int64)
    for row in range(z.shape[0]):
        across = (corner[1] + row - cy) / fy
        for column in range(z.shape[1]):
            piece = pieces[row, column]
            if piece < 0 or step[piece] == 0:
                continue
            if seen[piece] % step[piece] == 0:
                to, there = first[piece] + seen[piece] // step[piece], z[row, column]
                points[to, 0], points[to, 1] = (corner[0] + column - cx) / fx * there, across * there
                points[to, 2] = there
            seen[piece] += 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shares(rgb, chosen, step, out):  # type: ignore[no-untyped-def]
    """Fill out (n, 2) with the shares of red and green of every `step`-th chosen pixel (h, w) of rgb (h, w, 3)."""
    seen = 0
    for row in range(chosen.shape[0]):
        for column in range(chosen.shape[1]):
            if not chosen[row, column]:
                continue
            if seen % step == 0:
                red, green, blue = rgb[row, column, 0], rgb[row, column, 1], rgb[row, column, 2]
                whole = max(float(red) + float(green) + float(blue), 1.0)
                out[seen // step, 0], out[seen // step, 1] = red / whole, green / whole
            seen += 1
