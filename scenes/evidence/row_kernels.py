"""The rows of a table of evidence as the kernels read them, and their robust loss.

What of a row does not depend on the pose (its inverse sigma under a stage's blur, the loss's constant) is worked out
once for all poses and steps.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.evidence.table import (
    COLUMNS,
    GATE_ABOVE,
    GATE_BELOW,
    SIGMA,
    SIGMA_NORMAL,
)

# Columns of a prepared row beside those of scenes.evidence.table: 1 / sigma under the blur, the variance of its normal
# under the blur (0 without one), and the constants of the loss on either side of the surface.
INVERSE, NARROW, FLOOR_ABOVE, FLOOR_BELOW = COLUMNS, COLUMNS + 1, COLUMNS + 2, COLUMNS + 3
PREPARED = COLUMNS + 4


@numba.njit(cache=True, nogil=True)
def loss_floor(gate):
    """What the robust loss of a row has at most beyond gate^2: its loss at distance zero is zero but for rounding."""
    return 2.0 * math.log1p(math.exp(-0.5 * gate * gate))


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
