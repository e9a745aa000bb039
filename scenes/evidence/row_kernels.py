"""The rows of a table of evidence as the kernels read them, and their robust loss.

What of a row does not depend on the pose (its inverse sigma under a stage's blur, the loss's constant) is worked out
once for all poses and steps.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED
from scenes.evidence.table import (
    COLUMNS,
    FACING,
    GATE_ABOVE,
    GATE_BELOW,
    OFFSET,
    SIGMA,
    SIGMA_NORMAL,
)
from scenes.geometry.lattice import beyond_box, value_at

# Columns of a prepared row beside those of scenes.evidence.table: 1 / sigma under the blur, the variance of its normal
# under the blur (0 without one), and the constants of the loss on either side of the surface.
INVERSE, NARROW, FLOOR_ABOVE, FLOOR_BELOW = COLUMNS, COLUMNS + 1, COLUMNS + 2, COLUMNS + 3
PREPARED = COLUMNS + 4


@numba.njit(cache=True, nogil=True)
def loss_floor(gate):
    """What the robust loss of a row has at most beyond gate^2: its loss at distance zero is zero but for rounding."""
    return 2.0 * math.log1p(math.exp(-0.5 * gate * gate))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def robust(s, gate, floor, huber):
    """Loss rho(s) and its derivative, the probability that the row is the object's (see scenes.evidence.table).

    floor: loss_floor(gate). With huber > 0 (sigmas) residuals beyond it count linearly, the loss for noise of unknown
    shape.
    """
    if huber > 0.0:
        if s <= huber * huber:
            return s, 1.0
        root = math.sqrt(s)
        return 2.0 * huber * root - huber * huber, huber / root
    # log(1 + exp(over)) without a branch on its sign: rows far from a pose change sides at random, and a processor that
    # guesses wrong loses more than the exponential takes
    over = 0.5 * (s - gate * gate)
    e = math.exp(-abs(over))
    loss = s - 2.0 * max(over, 0.0) - 2.0 * math.log1p(e) + floor
    return loss, (e if over > 0.0 else 1.0) / (1.0 + e)


@numba.njit(cache=True, nogil=True)
def prepare(rows, blur, blur_normal):
    """(n, PREPARED) rows for the kernels from a table (n, COLUMNS) of evidence, under blurs in m and rad."""
    out = np.zeros((rows.shape[0], PREPARED))
    for n in range(rows.shape[0]):
        for i in range(COLUMNS):
            out[n, i] = rows[n, i]
        out[n, INVERSE] = 1.0 / math.sqrt(rows[n, SIGMA] * rows[n, SIGMA] + blur * blur)
        sigma_normal = rows[n, SIGMA_NORMAL]
        out[n, NARROW] = sigma_normal * sigma_normal + blur_normal * blur_normal if sigma_normal > 0.0 else 0.0
        out[n, FLOOR_ABOVE] = loss_floor(rows[n, GATE_ABOVE])
        out[n, FLOOR_BELOW] = loss_floor(rows[n, GATE_BELOW])
    return out


@numba.njit(cache=True, nogil=True)
def loss_floors(rows):
    """(n, 2) loss_floor of a table's gates above and below."""
    out = np.zeros((rows.shape[0], 2))
    for n in range(rows.shape[0]):
        out[n, 0] = loss_floor(rows[n, GATE_ABOVE])
        out[n, 1] = loss_floor(rows[n, GATE_BELOW])
    return out


@numba.njit(cache=True, nogil=True)
def silent_last(prepared):
    """Prepared rows (n, PREPARED), otherwise in order, with the one-sided ones last that say nothing where they are
    outside; and how many come before these.
    """
    out = np.zeros_like(prepared)
    k = 0
    for silent in range(2):
        for n in range(prepared.shape[0]):
            # with a side that it must be seen from, a point may be inside from far away
            if (prepared[n, GATE_ABOVE] == 0.0 and prepared[n, FACING] == 0.0) == (silent == 1):
                out[k] = prepared[n]
                k += 1
        if silent == 0:
            speaking = k
    return out, speaking


@numba.njit(cache=True, nogil=True, fastmath=FUSED)
def near_rows(lattice, rows, speaking, rotation, middle, reach, active):
    """Fill active after its first `speaking` rows with the one-sided rows (from there on, as in silent_last) that a
    pose, or one near it, may have within the surface or nearer to it than reach (m); returns how many rows are active,
    and how far (m) the farthest row left out is from the pose's middle.
    """
    values, origin, spacing, _, centroid = lattice
    k = speaking
    lever = 0.0
    for n in range(speaking, rows.shape[0]):
        yx = rows[n, 0] - middle[0]
        yy = rows[n, 1] - middle[1]
        yz = rows[n, 2] - middle[2]
        qx = rotation[0, 0] * yx + rotation[1, 0] * yy + rotation[2, 0] * yz + centroid[0]
        qy = rotation[0, 1] * yx + rotation[1, 1] * yy + rotation[2, 1] * yz + centroid[1]
        qz = rotation[0, 2] * yx + rotation[1, 2] * yy + rotation[2, 2] * yz + centroid[2]
        far = reach + rows[n, OFFSET]
        # beyond the lattice's box the box itself is nearer than the surface: no look-up tells more
        beyond = beyond_box(values, origin, spacing, qx, qy, qz)
        if beyond > max(far, 0.0) or value_at(values, origin, spacing, qx, qy, qz) > far:
            lever = max(lever, math.sqrt(yx * yx + yy * yy + yz * yz))
            continue
        for i in range(PREPARED):
            active[k, i] = rows[n, i]
        k += 1
    return k, lever
