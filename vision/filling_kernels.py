"""Steps of a depth image that have no gap, and runs of one value beside them, compiled; twins in NumPy in the tests.

depth: (h, w) float32 m, 0 or farther than any camera sees = no reading. A step: readings that follow one another along
a row, differ by more than `step` (m), and the nearer of which is no farther than `farthest` (m).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING


@numba.njit(cache=True, nogil=True, **LENT)
def look_at_rows(
    depth: NDArray[np.float32], step: float, farthest: float, stride: int
) -> tuple[int, int, int, int, int, int]:
    """Of every `stride`-th row: steps, and those of them across missing readings; neighbours on one surface (no step
    between them, no farther than `farthest`), and those of them that are equal; changes from neighbour to neighbour
    that follow another one, equal ones passed over, and those of them that go back.
    """
    height, width = depth.shape
    steps = gaps = pairs = equal = changes = turns = 0
    for v in range(0, height, stride):
        last, at, slope = np.float32(0.0), -1, np.float32(0.0)
        for u in range(width):
            here = depth[v, u]
            if not 0.0 < here < FARTHEST_READING:
                continue
            change, beside = here - last, u - at == 1
            if at >= 0 and abs(change) > step:
                near = min(here, last) <= farthest
                steps += near
                gaps += near and not beside
                slope = np.float32(0.0)
            elif at < 0 or not beside or here > farthest:
                slope = np.float32(0.0)
            else:
                pairs += 1
                equal += change == 0.0
                if change != 0.0:
                    if slope != 0.0:
                        changes += 1
                        turns += change * slope < 0.0
                    slope = change
            last, at = here, u
    return steps, gaps, pairs, equal, changes, turns


@numba.njit(cache=True, nogil=True, **LENT)
def drop_runs(
    depth: NDArray[np.float32], step: float, farthest: float, run: int, longest: int, out: NDArray[np.float32]
) -> int:
    """Zeros in out (h, w), a copy of depth, where `run` or more readings of one value lie in a row on either side of a
    step between neighbours, beginning at it; returns how many. longest: only runs up to so many readings that are
    followed by another reading of the same surface; 0 is any.
    """
    height, width = depth.shape
    dropped = 0
    for v in range(height):
        for u in range(1, width):
            left, right = depth[v, u - 1], depth[v, u]
            if not (left > 0.0 and right > 0.0 and abs(right - left) > step and min(left, right) <= farthest):
                continue
            for side in range(2):
                way = 1 if side else -1
                begin, value = (u, right) if side else (u - 1, left)
                end = begin
                while 0 <= end < width and depth[v, end] == value:
                    end += way
                long = abs(end - begin)
                if long < run:
                    continue
                if longest > 0:
                    if long > longest or not 0 <= end < width:
                        continue
                    beyond = depth[v, end]
                    if not (beyond > 0.0 and abs(beyond - value) <= step):
                        continue
                for i in range(long):
                    dropped += out[v, begin + way * i] > 0.0
                    out[v, begin + way * i] = 0.0
    return dropped
