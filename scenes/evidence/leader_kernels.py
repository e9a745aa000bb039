"""Compiled: of many poses those that stand for the ones near them, modulo an object's symmetry."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def closest_trace(r, s, discrete, axis, turns, m):
    """Largest trace of r^T s g over the symmetries g: 1 + 2 cos of the least angle between two rotations (3, 3).

    discrete (k, 3, 3): rotations of the finite members. turns: continuous axes, 0, 1 for a turn about axis (3,), or 2
    for every rotation. About an axis a the trace of m A(angle) is along + cos (tr m - along) + sin tr(m [a]x), along
    = a^T m a: its largest value is in closed form. m (3, 3): working room.
    """
    if turns == 2:
        return 3.0
    best = -3.0
    for k in range(discrete.shape[0]):
        for i in range(3):
            for j in range(3):
                # of r^T s g, from the left
                total = 0.0
                for a in range(3):
                    along = s[a, 0] * discrete[k, 0, j] + s[a, 1] * discrete[k, 1, j] + s[a, 2] * discrete[k, 2, j]
                    total += r[a, i] * along
                m[i, j] = total
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        if turns == 1:
            along = 0.0
            for i in range(3):
                for j in range(3):
                    along += axis[i] * m[i, j] * axis[j]
            across = axis[0] * (m[1, 2] - m[2, 1]) + axis[1] * (m[2, 0] - m[0, 2]) + axis[2] * (m[0, 1] - m[1, 0])
            trace = along + math.sqrt((trace - along) * (trace - along) + across * across)
        best = max(best, trace)
    return best


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lead(rotations, middles, discrete, axis, turns, radius, apart, chosen, group):
    """Fill chosen (n,) and group (n,): see search.leaders; returns how many lead.

    rotations (n, 3, 3), middles (n, 3): of the centroid, m. discrete, axis, turns: see closest_trace. A pose is of the
    first leader that it is nearer to than apart (m); radius (m) of the object scales turns.
    """
    room = np.zeros((3, 3))
    count = 0
    for n in range(rotations.shape[0]):
        group[n] = -1
        for k in range(count):
            other = chosen[k]
            dx = middles[n, 0] - middles[other, 0]
            dy = middles[n, 1] - middles[other, 1]
            dz = middles[n, 2] - middles[other, 2]
            moved = math.sqrt(dx * dx + dy * dy + dz * dz)
            if moved >= apart:
                continue
            trace = closest_trace(rotations[other], rotations[n], discrete, axis, turns, room)
            # the chord 2 sin(angle / 2) of the turn is its angle as far as near and far are told
            if math.sqrt(max(3.0 - trace, 0.0)) * radius + moved < apart:
                group[n] = k
                break
        if group[n] < 0:
            group[n] = count
            chosen[count] = n
            count += 1
    return count


@numba.njit(cache=True, nogil=True, **LENT)
def are_one(delta, hessian, own, radius, apart, sigmas, out):
    """Fill out (n,) with whether poses that are delta (n, 6) from another are of its mode: nearer than apart (m), by a
    point at the object's radius (m), or than so many sigmas both by its information hessian (6, 6) and by their own
    (n, 6, 6).
    """
    for n in range(delta.shape[0]):
        a, b, c, x, y, z = delta[n, 0], delta[n, 1], delta[n, 2], delta[n, 3], delta[n, 4], delta[n, 5]
        moved = math.sqrt(a * a + b * b + c * c) * radius + math.sqrt(x * x + y * y + z * z)
        square = own_square = 0.0
        for i in range(6):
            for j in range(6):
                square += delta[n, i] * hessian[i, j] * delta[n, j]
                own_square += delta[n, i] * own[n, i, j] * delta[n, j]
        out[n] = moved < apart or max(square, own_square) < sigmas * sigmas


@numba.njit(cache=True, nogil=True, **LENT)
def displacements(delta, radius, out):
    """Fill out (n,) with how far (m) at most a point at the object's radius (m) moves by delta (n, 6)."""
    for n in range(delta.shape[0]):
        a, b, c, x, y, z = delta[n, 0], delta[n, 1], delta[n, 2], delta[n, 3], delta[n, 4], delta[n, 5]
        out[n] = math.sqrt(a * a + b * b + c * c) * radius + math.sqrt(x * x + y * y + z * z)
