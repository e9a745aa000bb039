"""Compiled steps of the unscented particle filters: one contact, every particle (T2 section 4.3, algorithm 2).

A particle is (R, m, P): rotation and object centroid m in the contacts' frame, P (6, 6) in the chart of poses.perturb,
R <- exp(theta) R, m <- m + tau. The published state has Euler angles; exponential coordinates have no singularity, and
a sigma point turned by more than pi wraps by itself. Distances and closest points come from the lattice.
One particle is worked by one thread and random numbers are drawn outside: bits do not depend on the threads.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.lattice import distance_at, value_at
from scenes.geometry.rotation_kernels import exp_times, log_rotation

# The lattice's gradient is shorter than one on the medial axis: no surface point is farther than distance / this.
SHORTEST_GRADIENT = 0.3
# A gradient whose square is this near to one belongs to one face, edge or corner: its foot is one step away, to some
# per cent of a cell for every cell of distance.
STRAIGHT = 0.02
# Components that are this many nats below the largest met so far add nothing to a mixture (e^-25).
NOTHING = 25.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def closest_points(values, origin, spacing, points, square):
    """Move each of points (n, 3), object frame, to a surface point near it, the nearest but on a medial axis: steps of
    the distance itself down the lattice's gradient, from its box. square (n,): working room.

    All take their first step before any takes a second, which few need: what one look-up waits for, others need not.
    """
    last = (
        origin[0] + spacing * (values.shape[0] - 1),
        origin[1] + spacing * (values.shape[1] - 1),
        origin[2] + spacing * (values.shape[2] - 1),
    )
    for n in range(points.shape[0]):
        x = min(max(points[n, 0], origin[0]), last[0])
        y = min(max(points[n, 1], origin[1]), last[1])
        z = min(max(points[n, 2], origin[2]), last[2])
        d, gx, gy, gz = distance_at(values, origin, spacing, x, y, z)
        # where faces meet the gradient is their mean and short: a Newton step would leap past the surface
        straight = gx * gx + gy * gy + gz * gz
        step = d / max(math.sqrt(straight), SHORTEST_GRADIENT)
        points[n, 0], points[n, 1], points[n, 2] = x - step * gx, y - step * gy, z - step * gz
        # so near, or so far from any edge's shadow, one step is exact to the lattice's own rounding
        square[n] = 1.0 if abs(d) < spacing else straight
    for n in range(points.shape[0]):
        if abs(square[n] - 1.0) < STRAIGHT:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for _ in range(3):
            d, gx, gy, gz = distance_at(values, origin, spacing, x, y, z)
            straight = gx * gx + gy * gy + gz * gz
            step = d / max(math.sqrt(straight), SHORTEST_GRADIENT)
            x -= step * gx
            y -= step * gy
            z -= step * gz
            if abs(d) < spacing or abs(straight - 1.0) < STRAIGHT:
                break
        points[n, 0], points[n, 1], points[n, 2] = x, y, z


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cholesky(matrix, factor):
    """Lower factor of a symmetric 6x6 matrix; a pivot that round-off made negative becomes tiny instead."""
    for i in range(6):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(total, 1e-14 * matrix[i, i] + 1e-300))
            else:
                factor[i, j] = total / factor[j, j]
        for j in range(i + 1, 6):
            factor[i, j] = 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def unscented_update(
    values,
    origin,
    spacing,
    centroid,
    point,
    variance,
    scaling,
    rotation,
    middle,
    covariance,
    factor,
    turned,
    measured,
    room,
):
    """UKF correction of one particle by one contact, in place (T2 algorithm 1, SUT of eq. 4.9).

    point (3,) metres; variance m^2 of its noise per axis. scaling (4,): spread of the sigma points, their weight, and
    the central point's weights for mean and covariance. factor (6, 6), turned (9, 3, 3), measured (13, 3), room
    (20, 6): working room, the last of turned the identity.
    """
    cholesky(covariance, factor)
    spread, weight, mean_weight, covariance_weight = scaling[0], scaling[1], scaling[2], scaling[3]
    theta, mean, delta, s, cross, gain = (
        room[0],
        room[1],
        room[2],
        room[3:6],
        room[6:9].reshape(6, 3),
        room[9:12].reshape(6, 3),
    )
    apart, square = room[12:15].reshape(6, 3), room[15:18].reshape(18)[:13]
    # sigma points 1 + 2 c and 2 + 2 c: up and down column c, a turn and its inverse; a lower factor: the last three
    # columns only move. turned[n] is the rotation of one of the first seven points, turned[7] that of the turn
    for i in range(3):
        for j in range(3):
            turned[0, i, j] = rotation[i, j]
    for c in range(3):
        for i in range(3):
            theta[i] = spread * factor[i, c]
        exp_times(theta, turned[8], turned[7])
        up, down, turn = turned[1 + 2 * c], turned[2 + 2 * c], turned[7]
        for i in range(3):
            for j in range(3):
                up[i, j] = turn[i, 0] * rotation[0, j] + turn[i, 1] * rotation[1, j] + turn[i, 2] * rotation[2, j]
                down[i, j] = turn[0, i] * rotation[0, j] + turn[1, i] * rotation[1, j] + turn[2, i] * rotation[2, j]
    # the measurement predicted at each (T2 eq. 4.17): the surface point nearest to the contact
    for n in range(13):
        c = (n - 1) // 2
        reach = 0.0 if n == 0 else spread if n % 2 == 1 else -spread
        r = turned[n if n < 7 else 0]
        yx = point[0] - middle[0] - reach * factor[3, c]
        yy = point[1] - middle[1] - reach * factor[4, c]
        yz = point[2] - middle[2] - reach * factor[5, c]
        measured[n, 0] = r[0, 0] * yx + r[1, 0] * yy + r[2, 0] * yz + centroid[0]
        measured[n, 1] = r[0, 1] * yx + r[1, 1] * yy + r[2, 1] * yz + centroid[1]
        measured[n, 2] = r[0, 2] * yx + r[1, 2] * yy + r[2, 2] * yz + centroid[2]
    closest_points(values, origin, spacing, measured, square)
    for n in range(13):
        c = (n - 1) // 2
        reach = 0.0 if n == 0 else spread if n % 2 == 1 else -spread
        r = turned[n if n < 7 else 0]
        px, py, pz = measured[n, 0] - centroid[0], measured[n, 1] - centroid[1], measured[n, 2] - centroid[2]
        for i in range(3):
            measured[n, i] = r[i, 0] * px + r[i, 1] * py + r[i, 2] * pz + middle[i] + reach * factor[3 + i, c]
    for i in range(3):
        mean[i] = mean_weight * measured[0, i]
        for n in range(1, 13):
            mean[i] += weight * measured[n, i]
        for c in range(6):
            apart[c, i] = measured[1 + 2 * c, i] - measured[2 + 2 * c, i]
    for n in range(13):
        for i in range(3):
            measured[n, i] -= mean[i]
    for i in range(3):
        for j in range(i + 1):
            total = covariance_weight * measured[0, i] * measured[0, j]
            for n in range(1, 13):
                total += weight * measured[n, i] * measured[n, j]
            s[i, j] = total
            s[j, i] = total
        s[i, i] += variance
        for a in range(6):
            total = 0.0
            for c in range(a + 1):
                total += factor[a, c] * apart[c, i]
            cross[a, i] = weight * spread * total
    # gain = cross s^-1 by cofactors: s is symmetric and at least `variance` in every direction
    c00 = s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1]
    c01 = s[0, 2] * s[2, 1] - s[0, 1] * s[2, 2]
    c02 = s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1]
    c11 = s[0, 0] * s[2, 2] - s[0, 2] * s[2, 0]
    c12 = s[0, 2] * s[1, 0] - s[0, 0] * s[1, 2]
    c22 = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    inverse = 1.0 / (s[0, 0] * c00 + s[1, 0] * c01 + s[2, 0] * c02)
    for a in range(6):
        delta[a] = 0.0
        gain[a, 0] = (cross[a, 0] * c00 + cross[a, 1] * c01 + cross[a, 2] * c02) * inverse
        gain[a, 1] = (cross[a, 0] * c01 + cross[a, 1] * c11 + cross[a, 2] * c12) * inverse
        gain[a, 2] = (cross[a, 0] * c02 + cross[a, 1] * c12 + cross[a, 2] * c22) * inverse
        for i in range(3):
            delta[a] += gain[a, i] * (point[i] - mean[i])
    for a in range(6):
        for b in range(a + 1):
            total = 0.0
            for i in range(3):
                total += gain[a, i] * cross[b, i]
            covariance[a, b] -= total
            covariance[b, a] = covariance[a, b]
    _move(rotation, middle, delta, turned[7])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _move(rotation, middle, delta, room):
    """Perturb one pose in place by delta (6,)."""
    exp_times(delta, rotation, room)
    for i in range(3):
        middle[i] += delta[3 + i]
        for j in range(3):
            rotation[i, j] = room[i, j]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def filter_step(
    values,
    origin,
    spacing,
    centroid,
    window,
    exponents,
    variance,
    update_variance,
    process,
    scaling,
    sampled,
    draws,
    rotations,
    middles,
    covariances,
    log_likelihood,
    log_estimate,
    log_proposal,
):
    """Lines 6 to 16 of T2 algorithm 2 for every particle, in place: predict, correct, sample, weigh.

    window (m, 3): the newest contacts, the newest last; exponents (m,): their powers in the estimate's weights.
    process (6, 6): Q, diagonal. draws (n, 6): standard normal. sampled: the new particle is drawn from its Gaussian
    (line 14); else it is that Gaussian's mean, and the draws are the artificial motion before the correction. Fills the
    logs of the window's likelihood, of its product with the exponents, and of the proposal's density at the drawn
    particle (up to one constant, 0 when not sampled).
    """
    factor = np.zeros((6, 6))
    turned = np.zeros((9, 3, 3))
    turned[8] = np.eye(3)
    measured = np.zeros((13, 3))
    room = np.zeros((20, 6))
    delta = np.zeros(6)
    newest = window[window.shape[0] - 1]
    half = 0.5 / variance
    for n in range(rotations.shape[0]):
        rotation, middle, covariance = rotations[n], middles[n], covariances[n]
        for i in range(6):
            for j in range(6):
                covariance[i, j] += process[i, j]
        if not sampled:
            for i in range(6):
                delta[i] = math.sqrt(process[i, i]) * draws[n, i]
            _move(rotation, middle, delta, turned[7])
        unscented_update(
            values,
            origin,
            spacing,
            centroid,
            newest,
            update_variance,
            scaling,
            rotation,
            middle,
            covariance,
            factor,
            turned,
            measured,
            room,
        )
        proposal = 0.0
        if sampled:
            cholesky(covariance, factor)
            for i in range(6):
                delta[i] = 0.0
                for j in range(i + 1):
                    delta[i] += factor[i, j] * draws[n, j]
                proposal -= 0.5 * draws[n, i] * draws[n, i] + math.log(factor[i, i])
            _move(rotation, middle, delta, turned[7])
        log_proposal[n] = proposal
        plain = 0.0
        powered = 0.0
        for k in range(window.shape[0]):
            yx, yy, yz = window[k, 0] - middle[0], window[k, 1] - middle[1], window[k, 2] - middle[2]
            d = value_at(
                values,
                origin,
                spacing,
                rotation[0, 0] * yx + rotation[1, 0] * yy + rotation[2, 0] * yz + centroid[0],
                rotation[0, 1] * yx + rotation[1, 1] * yy + rotation[2, 1] * yz + centroid[1],
                rotation[0, 2] * yx + rotation[1, 2] * yy + rotation[2, 2] * yz + centroid[2],
            )
            plain -= half * d * d
            powered -= exponents[k] * half * d * d
        log_likelihood[n] = plain
        log_estimate[n] = powered


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mixture_density(rotations, middles, covariances, log_weights, at_rotations, at_middles, out):
    """Log of sum_i w_i N(x_j; x_i, P_i) at every x_j (T2 eq. 4.29), up to one constant.

    Components (k) as rotations (k, 3, 3), middles (k, 3), covariances (k, 6, 6), log_weights (k,); x_j as at_rotations
    (n, 3, 3), at_middles (n, 3); fills out (n,).
    """
    count = rotations.shape[0]
    inverses = np.zeros((count, 6, 6))
    logs = np.zeros(count)
    factor = np.zeros((6, 6))
    for i in range(count):
        cholesky(covariances[i], factor)
        logs[i] = log_weights[i]
        for a in range(6):
            logs[i] -= math.log(factor[a, a])
            # rows of the factor's inverse, so that the Mahalanobis distance is a triangular product
            for b in range(a + 1):
                total = 1.0 if a == b else 0.0
                for k in range(b, a):
                    total -= factor[a, k] * inverses[i, k, b]
                inverses[i, a, b] = total / factor[a, a]
    relative = np.zeros((3, 3))
    delta = np.zeros(6)
    for j in range(at_rotations.shape[0]):
        largest = -np.inf
        total = 0.0
        for i in range(count):
            # z^2 is at least that of the turn, and of the shift, alone against the trace of its covariance; and the
            # square of an angle is at least twice one minus its cosine
            turn, shift = 3.0, 0.0
            for a in range(3):
                for b in range(3):
                    turn -= at_rotations[j, a, b] * rotations[i, a, b]
                shift += (at_middles[j, a] - middles[i, a]) ** 2
            turn /= covariances[i, 0, 0] + covariances[i, 1, 1] + covariances[i, 2, 2]
            shift /= covariances[i, 3, 3] + covariances[i, 4, 4] + covariances[i, 5, 5]
            if logs[i] - 0.5 * max(turn, shift) < largest - NOTHING:
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
            value = logs[i]
            for a in range(6):
                z = 0.0
                for b in range(a + 1):
                    z += inverses[i, a, b] * delta[b]
                value -= 0.5 * z * z
            if value > largest:
                total = total * math.exp(largest - value) + 1.0
                largest = value
            else:
                total += math.exp(value - largest)
        out[j] = largest + math.log(total)
