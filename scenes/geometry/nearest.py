"""The nearest of many points, exactly: a k-d tree. Any frame, any one unit.

Bentley, Multidimensional binary search trees used for associative searching, CACM 18, 1975; the distance to a cell is
kept side by side as in Arya and Mount, Algorithms for fast vector quantization, DCC 1993. SciPy has one as well, but
takes a tenth of a second to load.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError

Array = NDArray[np.float64]

# Points of a cell that is cut no further: cheaper to look at than to descend.
LEAF = 12
# Cells that wait at most: one for each level of a tree of 2^60 points.
DEEPEST = 64


class Nearest:
    """Finds how far the nearest of points (n, 3) is; the points are sorted once."""

    def __init__(self, points: ArrayLike) -> None:
        """Raises InputError for none, or some that are not finite."""
        given = np.array(points, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != 3 or not len(given) or not np.isfinite(given).all():
            raise InputError(f"nearest: expected finite points (n, 3), n at least 1, got shape {given.shape}")
        order, self._axis = np.arange(len(given)), np.zeros(len(given), dtype=np.int8)
        build(given, order, self._axis)
        self._points = given[order]

    def distance(self, points: ArrayLike) -> Array:
        """(m,) from each of finite points (m, 3)."""
        asked = np.ascontiguousarray(points, dtype=np.float64)
        out = np.zeros(len(asked))
        query(self._points, self._axis, asked, out)
        return out


@numba.njit(cache=True, nogil=True)
def build(points, order, axis):  # type: ignore[no-untyped-def]
    """Sort order (n,) so that the middle of every range splits it along axis[middle], the one in which it is longest:
    ranges are halved until they are leaves.
    """
    waiting = np.zeros((DEEPEST, 2), dtype=np.int64)
    waiting[0, 1] = len(order)
    count = 1
    while count:
        count -= 1
        low, high = waiting[count]
        if high - low <= LEAF:
            continue
        middle = (low + high) // 2
        longest, along = -1.0, 0
        for d in range(3):
            least = most = points[order[low], d]
            for i in range(low + 1, high):
                least = min(least, points[order[i], d])
                most = max(most, points[order[i], d])
            if most - least > longest:
                longest, along = most - least, d
        axis[middle] = along
        # Hoare's selection: the middle in its place, what is less before it
        first, last = low, high - 1
        while first < last:
            pivot = points[order[(first + last) // 2], along]
            i, j = first, last
            while i <= j:
                while points[order[i], along] < pivot:
                    i += 1
                while points[order[j], along] > pivot:
                    j -= 1
                if i <= j:
                    order[i], order[j] = order[j], order[i]
                    i += 1
                    j -= 1
            if middle <= j:
                last = j
            elif middle >= i:
                first = i
            else:
                break
        waiting[count, 0], waiting[count, 1] = low, middle
        waiting[count + 1, 0], waiting[count + 1, 1] = middle + 1, high
        count += 2


@numba.njit(cache=True, nogil=True)
def query(points, axis, asked, out):  # type: ignore[no-untyped-def]
    """Fill out (m,) with the distances of asked (m, 3) from the nearest of points (n, 3), ordered by `build`."""
    ranges = np.zeros((DEEPEST, 2), dtype=np.int64)
    # how far the cell of each range is from the point, axis by axis
    beside = np.zeros((DEEPEST, 3))
    for m in range(len(asked)):
        best = np.inf
        ranges[0, 0], ranges[0, 1] = 0, len(points)
        beside[0] = 0.0
        count = 1
        while count:
            count -= 1
            low, high = ranges[count]
            bx, by, bz = beside[count]
            if bx * bx + by * by + bz * bz >= best:
                continue
            while high - low > LEAF:
                middle = (low + high) // 2
                along = axis[middle]
                off = asked[m, along] - points[middle, along]
                square = 0.0
                for d in range(3):
                    gap = asked[m, d] - points[middle, d]
                    square += gap * gap
                best = min(best, square)
                # the farther half waits; it is `off` away along this axis
                if off < 0.0:
                    ranges[count, 0], ranges[count, 1] = middle + 1, high
                    high = middle
                else:
                    ranges[count, 0], ranges[count, 1] = low, middle
                    low = middle + 1
                beside[count, 0], beside[count, 1], beside[count, 2] = bx, by, bz
                beside[count, along] = off
                count += 1
            for i in range(low, high):
                square = 0.0
                for d in range(3):
                    gap = asked[m, d] - points[i, d]
                    square += gap * gap
                best = min(best, square)
        out[m] = math.sqrt(best)
