"""The compiled rows of evidence of one predicted image: what shows the object there, and where it cannot be.

One pass over the rays of a pose, without arrays between the steps; the twin in plain NumPy is in the tests. Camera
frame, metres, pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.evidence.table import COLUMNS, FACING, GATE_ABOVE, GATE_BELOW, SIGMA, WEIGHT
from vision.picture.columns import HIT, NEAR
from vision.picture.scoring_kernels import cell_of


@numba.njit(cache=True, nogil=True)
def shown_rays(state, side, inner, thin_share, chosen):
    """Rays (side^2,) that show the object: inside its outline by `inner` rays, and at the predicted depth; of a thing
    of which less than thin_share of what is near is inside, all that is near. Fills chosen and returns how many.
    """
    core = np.zeros((2, side * side), dtype=np.bool_)
    now = 0
    near = 0
    for k in range(side * side):
        core[0, k] = state[k] & HIT > 0
        near += state[k] & NEAR > 0
    for _ in range(inner):
        before, after = core[now], core[1 - now]
        for j in range(side):
            for i in range(side):
                k = j * side + i
                at_rim = j == 0 or i == 0 or j == side - 1 or i == side - 1
                after[k] = (
                    before[k]
                    and not at_rim
                    and before[k - side]
                    and before[k + side]
                    and before[k - 1]
                    and before[k + 1]
                )
        now = 1 - now
    count = 0
    for k in range(side * side):
        if core[now, k] and state[k] & NEAR:
            chosen[count] = k
            count += 1
    if count >= thin_share * near:
        return count
    count = 0
    for k in range(side * side):
        if state[k] & NEAR:
            chosen[count] = k
            count += 1
    return count


@numba.njit(cache=True, nogil=True, **LENT)
def free_rays(expected, seen, past, share, chosen):
    """Rays that see past the object, `share` of them, evenly chosen: fills chosen and returns how many."""
    count = 0
    for k in range(past.shape[0]):
        if past[k] == 1.0 and seen[k] > expected[k]:
            chosen[count] = k
            count += 1
    if count == 0:
        return 0
    # ties to the even number, as Python rounds
    kept = max(1, int(np.rint(count * share)))
    for k in range(kept):
        chosen[k] = chosen[(k * count) // kept]
    return kept


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_rows(u, v, step, view, camera, chosen, limits, noise, surface, beyond, free, most, room, rows):
    """Rows (n, COLUMNS) of evidence of one pose, as many as are returned: its pixels, then what is free.

    u, v (side^2,), step (4,): of vision.picture.kernels.outline_rays. view: expected, seen, state, past (side^2,):
    as of compare_pixels. camera: fx, fy, cx, cy. chosen (side^2,): rays that show the object, see shown_rays, which
    are overwritten; limits: how many, and the fewest that are believed. noise: floor, growth, depth it grows from,
    and bias of a DepthModel. surface: most rows of pixels, square of the length (px) over which pixels share a
    bias, gates above and below. beyond: depths (m) behind the surface at which a ray that sees past is empty,
    clearance, sigma, gate, cells of an outline, and rays of a side by which a pose is scored. free (k, COLUMNS):
    more of that, wherever the object is. most: at most so many of the pixels' and half as many of the other rows
    are taken, evenly, carrying the weight of all; 0: all. room: to work in, as many rows as `beyond` has depths for
    each ray that it is scored by.
    """
    expected, seen, state, past = view
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    shown, least = limits
    floor, growth, least_from, bias = noise
    most_rows, sharing_square, gate_above, gate_below = surface
    depths, clearance, sigma_free, gate_free, cells, scored = beyond
    side = math.sqrt(u.shape[0])

    pixels = 0
    if shown >= least:
        area = max(cell_of(step), 1.0)
        each = max(1.0, shown / most_rows)
        pixels = int(shown / each)
        sharing = min(max(sharing_square / (area * each), 1.0), max(1.0, pixels / 3.0))
        taken = pixels if most == 0 else min(pixels, most)
        for k in range(taken):
            row = rows[k]
            row[:] = 0.0
            ray = chosen[int((k * pixels) // taken * each)]
            z = seen[ray]
            x, y = (u[ray] - cx) / fx * z, (v[ray] - cy) / fy * z
            length = math.sqrt(x * x + y * y + z * z)
            row[0], row[1], row[2] = x, y, z
            row[3], row[4], row[5] = x / length, y / length, z / length
            independent = floor + growth * ((z - least_from) * (z - least_from))
            square = independent * independent + bias * bias
            sigma = math.sqrt(square)
            weight = sigma * sigma / (independent * independent + sharing * (bias * bias))
            row[SIGMA], row[WEIGHT] = sigma, min(weight, 1.0) * (pixels / taken)
            row[GATE_ABOVE], row[GATE_BELOW], row[FACING] = gate_above, gate_below, 1.0
        pixels = taken

    hits = 0
    for k in range(u.shape[0]):
        hits += state[k] & HIT > 0
    fewer = min(1.0, (scored / side) ** 2)
    rays = free_rays(expected, seen, past, fewer, chosen)
    weight = cells / max(hits * fewer, 1.0) / depths.shape[0]
    empty = 0
    for k in range(rays):
        ray = chosen[k]
        for depth in depths:
            z = expected[ray] + depth
            if z < seen[ray] - clearance:
                row = room[empty]
                row[:] = 0.0
                row[0], row[1], row[2] = (u[ray] - cx) / fx * z, (v[ray] - cy) / fy * z, z
                row[SIGMA], row[WEIGHT], row[GATE_BELOW] = sigma_free, weight, gate_free
                empty += 1
    silent = free.shape[0] + empty
    taken = silent if most == 0 else min(max(1, most // 2), silent)
    for k in range(taken):
        at = (k * silent) // taken
        row = free[at] if at < free.shape[0] else room[at - free.shape[0]]
        for c in range(COLUMNS):
            rows[pixels + k, c] = row[c]
        rows[pixels + k, WEIGHT] *= silent / taken
    return pixels + taken
