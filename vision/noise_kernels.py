"""How far readings of a depth image scatter about the planes that smooth surfaces are, compiled.

The twin in plain NumPy is in the tests. Metres, pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from scenes._numba import LENT


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def scatter_on_planes(
    depth: NDArray[np.float32], step: int, count: int, stride: int, farthest: float, out: NDArray[np.float64]
) -> int:
    """Of every `stride`-th window of count^2 readings, `step` pixels apart, all of which are there and no farther than
    `farthest` (m): standard deviation (m) about the plane that fits them best, and mean depth (m), in the order of the
    image, as far as out (n, 2) goes; returns how many.

    A plane's readings are linear in the image one over each: no line of sight is needed.
    """
    height, width = depth.shape
    span, found, middle = step * (count - 1), 0, 0.5 * (count - 1)
    places = count * count
    # sum over the window of the square of either coordinate, in steps from the middle
    spread = places * (places - 1.0) / 12.0
    for top in range(0, height - span, stride):
        for left in range(0, width - span, stride):
            total = squares = across = down = 0.0
            whole = True
            for j in range(count):
                for i in range(count):
                    reading = np.float64(depth[top + j * step, left + i * step])
                    if not 0.0 < reading <= farthest:
                        whole = False
                        break
                    inverse = 1.0 / reading
                    total += inverse
                    squares += inverse * inverse
                    across += (i - middle) * inverse
                    down += (j - middle) * inverse
                if not whole:
                    break
            if not whole:
                continue
            mean = total / places
            left_over = squares - places * mean * mean - (across * across + down * down) / spread
            out[found, 0] = math.sqrt(max(left_over, 0.0) / (places - 3.0)) / (mean * mean)
            out[found, 1] = 1.0 / mean
            found += 1
            if found == out.shape[0]:
                return found
    return found
