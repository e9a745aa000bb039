"""Predicted pressures against felt ones, compiled: what a taxel would feel at a pose, how likely what it felt is.

A pose is (R, t) frame_from_object, readings are given in that frame once. Everything in metres; one pose is worked by
one thread from start to end.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.lattice import distance_at

# Reaches of a column into the layer are followed in so many steps of the distance itself (sphere tracing).
TRACE_STEPS = 5
# The trace ends this near to the surface (m).
TRACED = 2e-5
# A surface met at a smaller cosine than this is followed as if it were met at this one.
GRAZING = 0.3


@numba.njit(cache=True, nogil=True)
def _predict(values, origin, spacing, r, tx, ty, tz, feet, shares, normal, depth, blur, place, lever, jac):
    """Indentation (m) that one taxel feels, negative for how far the object is away; fills jac (6,), its derivative
    by the array's turn and move about `lever`, poses' frame.

    feet (j, 3): ends of the layer's columns under it, shares (j,) of each, depth (m) of the layer, blur (m) the
    farthest column's distance from the middle one.
    """
    for i in range(6):
        jac[i] = 0.0
    # directions of the object's frame
    nx = r[0, 0] * normal[0] + r[1, 0] * normal[1] + r[2, 0] * normal[2]
    ny = r[0, 1] * normal[0] + r[1, 1] * normal[1] + r[2, 1] * normal[2]
    nz = r[0, 2] * normal[0] + r[1, 2] * normal[1] + r[2, 2] * normal[2]
    felt = 0.0
    for j in range(feet.shape[0]):
        wx, wy, wz = feet[j, 0] - tx, feet[j, 1] - ty, feet[j, 2] - tz
        x = r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz
        y = r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz
        z = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz
        d, gx, gy, gz = distance_at(values, origin, spacing, x, y, z)
        if j == 0 and d > depth + blur:
            break  # no column reaches the object
        height = d
        for _ in range(TRACE_STEPS):
            if height <= 0.0 or height >= depth or abs(d) < TRACED:
                break
            d, gx, gy, gz = distance_at(values, origin, spacing, x + height * nx, y + height * ny, z + height * nz)
            height += d
        if height >= depth:
            continue
        felt += shares[j] * (depth - height)
        along = gx * nx + gy * ny + gz * nz
        along = min(along, -GRAZING)
        height = max(height, 0.0)
        scale = shares[j] / along
        vx = scale * (r[0, 0] * gx + r[0, 1] * gy + r[0, 2] * gz)
        vy = scale * (r[1, 0] * gx + r[1, 1] * gy + r[1, 2] * gz)
        vz = scale * (r[2, 0] * gx + r[2, 1] * gy + r[2, 2] * gz)
        px = feet[j, 0] + height * normal[0] - lever[0]
        py = feet[j, 1] + height * normal[1] - lever[1]
        pz = feet[j, 2] + height * normal[2] - lever[2]
        jac[0] += py * vz - pz * vy
        jac[1] += pz * vx - px * vz
        jac[2] += px * vy - py * vx
        jac[3] += vx
        jac[4] += vy
        jac[5] += vz
    if felt > 0.0:
        return felt
    wx, wy, wz = place[0] - tx, place[1] - ty, place[2] - tz
    x = r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz
    y = r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz
    z = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz
    d, gx, gy, gz = distance_at(values, origin, spacing, x, y, z)
    if d <= blur:
        return 0.0
    vx = -(r[0, 0] * gx + r[0, 1] * gy + r[0, 2] * gz)
    vy = -(r[1, 0] * gx + r[1, 1] * gy + r[1, 2] * gz)
    vz = -(r[2, 0] * gx + r[2, 1] * gy + r[2, 2] * gz)
    px, py, pz = place[0] - lever[0], place[1] - lever[1], place[2] - lever[2]
    jac[0] = py * vz - pz * vy
    jac[1] = pz * vx - px * vz
    jac[2] = px * vy - py * vx
    jac[3] = vx
    jac[4] = vy
    jac[5] = vz
    return blur - d


@numba.njit(cache=True, nogil=True)
def predictions(
    values, origin, spacing, places, normals, feet, shares, depths, blurs, rotation, translation, levers, owner, out
):
    """Indentation (m) of every taxel at one pose; fills out (n,). See _predict and forward_costs."""
    jac = np.zeros(6)
    for n in range(places.shape[0]):
        k = owner[n]
        out[n] = _predict(values, origin, spacing, rotation, translation[0], translation[1], translation[2], feet[n],
                          shares, normals[n], depths[k], blurs[k], places[n], levers[k], jac)  # fmt: skip


@numba.njit(cache=True, nogil=True)
def forward_costs(
    values,
    origin,
    spacing,
    centroid,
    places,
    normals,
    feet,
    shares,
    felt,
    status,
    sigmas,
    first,
    depths,
    blurs,
    levers,
    sigma_turn,
    sigma_move,
    gate,
    rotations,
    translations,
    need,
    out,
    gradients,
    hessians,
):
    """Negative log likelihood of felt indentations at every pose, each array's own pose error profiled out.

    Per taxel: places and normals (n, 3), feet (n, j, 3) with shares (j,), felt (n,) m, status (n,): 0 felt nothing
    (felt is the least that it would report), 1 felt, 2 saturated; sigmas (n,) m. Per array: its taxels
    first[k]:first[k + 1], depths, blurs (m), levers (k, 3): the point about which its pose errs by sigma_turn (rad)
    and sigma_move (m) per axis. gate: residuals of more sigmas count less and less (Cauchy).
    Fills out (b,) and, when `need`, gradients (b, 6) and hessians (b, 6, 6) in the chart of poses.perturb.
    """
    jac, step, residual = np.zeros((64, 6)), np.zeros(6), np.zeros(64)
    normal, inverse, side = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    most = 0
    for k in range(first.shape[0] - 1):
        most = max(most, first[k + 1] - first[k])
    if most > 64:
        jac, residual = np.zeros((most, 6)), np.zeros(most)
    white = np.zeros(6)
    white[:3] = sigma_turn
    white[3:] = sigma_move
    for p in range(rotations.shape[0]):
        r = rotations[p]
        tx, ty, tz = translations[p, 0], translations[p, 1], translations[p, 2]
        total = 0.0
        if need:
            gradients[p, :] = 0.0
            hessians[p, :, :] = 0.0
        for k in range(first.shape[0] - 1):
            for i in range(6):
                step[i] = 0.0
                for j in range(6):
                    normal[i, j] = 1.0 if i == j else 0.0
            begin, end = first[k], first[k + 1]
            for n in range(begin, end):
                m = n - begin
                row = jac[m]
                e = _predict(values, origin, spacing, r, tx, ty, tz, feet[n], shares, normals[n], depths[k], blurs[k],
                             places[n], levers[k], row)  # fmt: skip
                if status[n] == 2 and felt[n] < e:
                    e = max(e - depths[k], 0.0)
                else:
                    e -= felt[n]
                if status[n] == 0 and e < 0.0:
                    e = 0.0
                if e == 0.0:
                    residual[m] = 0.0
                    row[:] = 0.0
                    continue
                scale = 1.0 / sigmas[n]
                residual[m] = e * scale
                weight = 1.0 / (1.0 + residual[m] * residual[m] / (gate * gate))
                for i in range(6):
                    row[i] *= scale * white[i]
                for i in range(6):
                    wj = weight * row[i]
                    step[i] -= wj * residual[m]
                    for j in range(i + 1):
                        normal[i, j] += wj * row[j]
            _invert(normal, inverse)
            cost = 0.0
            for i in range(6):
                along = 0.0
                for j in range(6):
                    along += inverse[i, j] * step[j]
                side[0, i] = along
                cost += 0.5 * along * along
            for i in range(6):
                step[i] = side[0, i]
            for m in range(end - begin):
                e = residual[m]
                for i in range(6):
                    e += jac[m, i] * step[i]
                cost += 0.5 * gate * gate * math.log1p(e * e / (gate * gate))
            total += cost
            if need:
                _to_pose(step, inverse, white, r, centroid, tx, ty, tz, levers[k], side, gradients[p], hessians[p])
        out[p] = total


@numba.njit(cache=True, nogil=True)
def _to_pose(step, inverse, white, r, centroid, tx, ty, tz, lever, chain, gradient, hessian):
    """Add an array's share to the pose's gradient and Hessian: moving the object is moving the array back."""
    ax = lever[0] - (r[0, 0] * centroid[0] + r[0, 1] * centroid[1] + r[0, 2] * centroid[2] + tx)
    ay = lever[1] - (r[1, 0] * centroid[0] + r[1, 1] * centroid[1] + r[1, 2] * centroid[2] + ty)
    az = lever[2] - (r[2, 0] * centroid[0] + r[2, 1] * centroid[1] + r[2, 2] * centroid[2] + tz)
    for i in range(6):
        for j in range(6):
            chain[i, j] = -1.0 / white[i] if i == j else 0.0
    s = 1.0 / white[3]
    # v = -(tau + theta x arm)
    chain[3, 1], chain[3, 2] = -s * az, s * ay
    chain[4, 0], chain[4, 2] = s * az, -s * ax
    chain[5, 0], chain[5, 1] = -s * ay, s * ax
    for i in range(6):
        along = 0.0
        for j in range(6):
            # at the minimum over the array's own error, the likelihood's gradient is minus that error
            along -= chain[j, i] * step[j]
        gradient[i] += along
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for a in range(6):
                for b in range(6):
                    information = (1.0 if a == b else 0.0) - inverse[a, b]
                    value += chain[a, i] * information * chain[b, j]
            hessian[i, j] += value
            if i != j:
                hessian[j, i] += value


@numba.njit(cache=True, nogil=True)
def _invert(matrix, out):
    """Inverse of a symmetric matrix (6, 6), at least the identity, from its lower half; by Cholesky's factor."""
    factor = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(value, 1e-12))
            else:
                factor[i, j] = value / factor[j, j]
    # the factor's own inverse, in place of its lower half
    for i in range(6):
        factor[i, i] = 1.0 / factor[i, i]
        for j in range(i):
            value = 0.0
            for k in range(j, i):
                value -= factor[i, k] * factor[k, j]
            factor[i, j] = value * factor[i, i]
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, 6):
                value += factor[k, i] * factor[k, j]
            out[i, j] = value
            out[j, i] = value
