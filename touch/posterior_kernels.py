"""Compiled density of a mixture on poses, for touch.posterior."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.rotation_kernels import log_rotation

# Exponents this far below the largest add a thousandth at most, of a hundred: nothing beside what a sample is worth.
NOTHING = 11.5
# The logarithm of pi^2 / 4, by which a chart of the rotations is smaller at half a turn, at most.
HALF_TURN = 0.91


@numba.njit(cache=True, nogil=True, error_model="numpy")
def student_mixture(rotations, middles, roots, widths, logs, freedom, at_rotations, at_middles, out):
    """Log density, per Haar measure of rotations and volume of places, of a mixture of multivariate Student
    distributions over the charts of their own centres, up to one constant.

    Components: rotations (k, 3, 3), middles (k, 3), roots (k, 6, 6): inverses of the lower triangular factors of their
    scale matrices; widths (k, 2): traces of these matrices' rotations and displacements; logs (k,): log weight less the
    log determinant of that factor. freedom: degrees of. Poses: at_rotations (n, 3, 3), at_middles (n, 3). Fills out
    (n,).
    """
    relative = np.zeros((3, 3))
    delta = np.zeros(6)
    power = 0.5 * (freedom + 6.0)
    for j in range(at_rotations.shape[0]):
        largest = -np.inf
        total = 0.0
        for i in range(rotations.shape[0]):
            # a square is at least that of the turn, and of the shift, alone over the trace of its matrix; and that of
            # an angle at least twice one minus its cosine
            turn, shift = 3.0, 0.0
            for a in range(3):
                for b in range(3):
                    turn -= at_rotations[j, a, b] * rotations[i, a, b]
                shift += (at_middles[j, a] - middles[i, a]) ** 2
            least = max(turn / widths[i, 0], shift / widths[i, 1])
            if logs[i] - power * math.log1p(least / freedom) + HALF_TURN < largest - NOTHING:
                continue
            for a in range(3):
                for b in range(3):
                    relative[a, b] = (
                        at_rotations[j, a, 0] * rotations[i, b, 0]
                        + at_rotations[j, a, 1] * rotations[i, b, 1]
                        + at_rotations[j, a, 2] * rotations[i, b, 2]
                    )
            log_rotation(relative, delta)
            for a in range(3):
                delta[3 + a] = at_middles[j, a] - middles[i, a]
            square = 0.0
            for a in range(6):
                z = 0.0
                for b in range(a + 1):
                    z += roots[i, a, b] * delta[b]
                square += z * z
            # of a turn by an angle the chart's volume is 2 (1 - cos angle) / angle^2 that of the rotations
            angle2 = delta[0] * delta[0] + delta[1] * delta[1] + delta[2] * delta[2]
            chart = 1.0
            if angle2 > 1e-8:
                chart = 2.0 * (1.0 - math.cos(math.sqrt(angle2))) / angle2
            value = logs[i] - power * math.log1p(square / freedom) - math.log(max(chart, 1e-6))
            if value > largest:
                total = total * math.exp(max(largest - value, -700.0)) + 1.0
                largest = value
            elif value > largest - NOTHING:
                total += math.exp(value - largest)
        out[j] = largest + math.log(total)
