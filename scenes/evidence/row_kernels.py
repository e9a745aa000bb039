"""The rows of a table of evidence as the kernels read them, and their robust loss.

What of a row does not depend on the pose (its inverse sigma under a stage's blur, the loss's constant) is worked out
once for all poses and steps.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT
from scenes.evidence.table import (
    COLUMNS,
    GATE_ABOVE,
    GATE_BELOW,
    SIGMA,
    SIGMA_NORMAL,
    WEIGHT,
)

# Columns of a prepared row beside those of scenes.evidence.table: 1 / sigma under the blur, the variance of its normal
# under the blur (0 without one), and the constants of the loss on either side of the surface.
INVERSE, NARROW, FLOOR_ABOVE, FLOOR_BELOW = COLUMNS, COLUMNS + 1, COLUMNS + 2, COLUMNS + 3
PREPARED = COLUMNS + 4
# Beyond this the exponential `decay` is nothing beside one.
NOTHING = 40.0
_MIDDLE = 0.3125
_AT_MIDDLE = 0.7316156289466418  # exp(-_MIDDLE)


@numba.njit(cache=True, nogil=True, **LENT)
def loss_floor(gate):
    """What the robust loss of a row has at most beyond gate^2: its loss at distance zero is zero but for rounding."""
    return 2.0 * math.log1p(math.exp(-0.5 * gate * gate))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, **LENT)
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
    lay_floors(rows, out[:, FLOOR_ABOVE : FLOOR_BELOW + 1])
    for n in range(rows.shape[0]):
        for i in range(COLUMNS):
            out[n, i] = rows[n, i]
        out[n, INVERSE] = 1.0 / math.sqrt(rows[n, SIGMA] * rows[n, SIGMA] + blur * blur)
        sigma_normal = rows[n, SIGMA_NORMAL]
        out[n, NARROW] = sigma_normal * sigma_normal + blur_normal * blur_normal if sigma_normal > 0.0 else 0.0
    return out


@numba.njit(cache=True, nogil=True)
def loss_floors(rows):
    """(n, 2) loss_floor of a table's gates above and below."""
    out = np.zeros((rows.shape[0], 2))
    lay_floors(rows, out)
    return out


@numba.njit(cache=True, nogil=True, **LENT)
def lay_floors(rows, out):
    """Fill out (n, 2) with `loss_floors`: one for all rows that follow one another and have the same gate."""
    for side in range(2):
        column = GATE_BELOW if side else GATE_ABOVE
        last, floor = math.nan, 0.0
        for n in range(rows.shape[0]):
            if rows[n, column] != last:
                last = rows[n, column]
                floor = loss_floor(last)
            out[n, side] = floor


@numba.njit(inline="always")
def decay(t):
    """exp(-t) of t from 0 to 40, without a branch or a call: the 64th power of a polynomial about the middle."""
    x = _MIDDLE - t * 0.015625
    p = 1.0 / 479001600.0
    p = p * x + 1.0 / 39916800.0
    p = p * x + 1.0 / 3628800.0
    p = p * x + 1.0 / 362880.0
    p = p * x + 1.0 / 40320.0
    p = p * x + 1.0 / 5040.0
    p = p * x + 1.0 / 720.0
    p = p * x + 1.0 / 120.0
    p = p * x + 1.0 / 24.0
    p = p * x + 1.0 / 6.0
    p = p * x + 0.5
    p = p * x + 1.0
    p = p * x + 1.0
    p *= _AT_MIDDLE
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return p


@numba.njit(inline="always")
def log_above_one(e):
    """log(1 + e) of e from 0 to 1: the series of the area tangent."""
    z = e / (2.0 + e)
    y = z * z
    p = 1.0 / 35.0
    p = p * y + 1.0 / 33.0
    p = p * y + 1.0 / 31.0
    p = p * y + 1.0 / 29.0
    p = p * y + 1.0 / 27.0
    p = p * y + 1.0 / 25.0
    p = p * y + 1.0 / 23.0
    p = p * y + 1.0 / 21.0
    p = p * y + 1.0 / 19.0
    p = p * y + 1.0 / 17.0
    p = p * y + 1.0 / 15.0
    p = p * y + 1.0 / 13.0
    p = p * y + 1.0 / 11.0
    p = p * y + 1.0 / 9.0
    p = p * y + 1.0 / 7.0
    p = p * y + 1.0 / 5.0
    p = p * y + 1.0 / 3.0
    p = p * y + 1.0
    return 2.0 * z * p


@numba.njit(cache=True, nogil=True)
def thin_rows(rows, sense, touch, most, out, senses):
    """Fill out (n, COLUMNS) and senses (n,) with rows of a table, evenly taken, that carry the weight of all; returns
    how many: every contact, of vision's rows most[0], and of vision's and touch's one-sided ones most[1] each.

    rows (n, COLUMNS), sense (n,): a table's; touch: what `sense` is of touch.
    """
    k = 0
    for group in range(4):
        felt, silent = group == 0 or group == 3, group >= 2
        count = 0
        for n in range(rows.shape[0]):
            count += (sense[n] == touch) == felt and (rows[n, GATE_ABOVE] == 0.0) == silent
        if count == 0:
            continue
        kept = count if group == 0 else max(1, min(most[1] if silent else most[0], count))
        # which of the group's rows is the next to be taken
        at = taken = following = 0
        for n in range(rows.shape[0]):
            if (sense[n] == touch) != felt or (rows[n, GATE_ABOVE] == 0.0) != silent:
                continue
            if at == following:
                for i in range(rows.shape[1]):
                    out[k, i] = rows[n, i]
                out[k, WEIGHT] *= count / kept
                senses[k] = sense[n]
                taken += 1
                k += 1
                if taken == kept:
                    break
                following = (taken * count) // kept
            at += 1
    return k
