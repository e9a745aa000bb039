"""The costs of tactile arrays over poses, compiled: T1 algorithms 5.2 and 5.3, and predicted pressures against felt.

A pose is (R, t) frame_from_object, readings are given in that frame once. Everything in metres; one pose is worked by
one thread from start to end.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.alignment.kernels import _exp_times
from scenes.lattice import distance_at, value_at

# Reaches of a column into the layer are followed in so many steps of the distance itself (sphere tracing).
TRACE_STEPS = 5
# A surface met at a smaller cosine than this is followed as if it were met at this one.
GRAZING = 0.3


@numba.njit(cache=True, nogil=True)
def covariance_costs(
    values,
    origin,
    spacing,
    cloud,
    first,
    shape,
    corner,
    voxel,
    frames,
    origins,
    centroids,
    covariances,
    thirds,
    boxes,
    skins,
    weights,
    rotations,
    translations,
    out,
):
    """T1 algorithm 5.2 with eq. 5.8 for every pose; fills out (b,), metres.

    cloud (n, 3): points of the object's surface sorted by voxel, z fastest; first (v + 1,): where each voxel's begin;
    shape (3,), corner (3,) and voxel (m) of that grid. Per contact k, in its tangent frame: frames (k, 3, 3) and
    origins (k, 3) frame_from_tangent; centroids (k, 3); covariances (k, 3, 3), which stands for E Lambda E^T since
    the Frobenius norm is the same in any basis; thirds (k, 3): e3; boxes (k, 6): x, y and z limits of the sensing box;
    skins (k, 7): height of the skin a + bx + cy + dx^2 + exy + fy^2 and how far from it points count.
    weights (4,): epsilon (m), h1, h2, h3 (1/m).
    """
    epsilon, h1, h2, h3 = weights[0], weights[1], weights[2], weights[3]
    a = np.zeros((3, 3))
    sums = np.zeros(9)
    for p in range(rotations.shape[0]):
        r = rotations[p]
        total = 0.0
        for k in range(frames.shape[0]):
            f = frames[k]
            dx = origins[k, 0] - translations[p, 0]
            dy = origins[k, 1] - translations[p, 1]
            dz = origins[k, 2] - translations[p, 2]
            bx = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
            by = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
            bz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
            for i in range(3):
                for j in range(3):
                    a[i, j] = r[0, i] * f[0, j] + r[1, i] * f[1, j] + r[2, i] * f[2, j]
            cx, cy, cz = centroids[k, 0], centroids[k, 1], centroids[k, 2]
            away = abs(
                value_at(
                    values,
                    origin,
                    spacing,
                    bx + a[0, 0] * cx + a[0, 1] * cy + a[0, 2] * cz,
                    by + a[1, 0] * cx + a[1, 1] * cy + a[1, 2] * cz,
                    bz + a[2, 0] * cx + a[2, 1] * cy + a[2, 2] * cz,
                )
            )
            c = covariances[k]
            missed = 0.0
            for i in range(3):
                for j in range(3):
                    missed += c[i, j] * c[i, j]
            missed = h1 * away + h3 * math.sqrt(missed)
            if away > epsilon:
                total += missed
                continue
            count, penetration = _patch(cloud, first, shape, corner, voxel, a, bx, by, bz, boxes[k], skins[k],
                                        centroids[k], thirds[k], sums)  # fmt: skip
            if count <= 3:
                total += missed
                continue
            mx, my, mz = sums[0] / count, sums[1] / count, sums[2] / count
            scale = 1.0 / (count - 1)
            xx = (sums[3] - count * mx * mx) * scale - c[0, 0]
            yy = (sums[4] - count * my * my) * scale - c[1, 1]
            zz = (sums[5] - count * mz * mz) * scale - c[2, 2]
            xy = (sums[6] - count * mx * my) * scale - c[0, 1]
            xz = (sums[7] - count * mx * mz) * scale - c[0, 2]
            yz = (sums[8] - count * my * mz) * scale - c[1, 2]
            norm = math.sqrt(max(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz), 0.0))
            total += h3 * norm + math.sqrt(mx * mx + my * my + mz * mz) + h2 * penetration
        out[p] = total


@numba.njit(cache=True, nogil=True)
def _patch(cloud, first, shape, corner, voxel, a, bx, by, bz, box, skin, centroid, third, sums):
    """Range query: the surface's points in a sensing box. a (3, 3), b: object_from_tangent.

    Fills sums (9,) of s and of its products about the centroid (xx, yy, zz, xy, xz, yz) and returns how many points
    there are and how far in all they lie behind the contact plane (m).
    """
    for i in range(9):
        sums[i] = 0.0
    count, penetration = 0, 0.0
    inverse = 1.0 / voxel
    mid0, mid1, mid2 = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]), 0.5 * (box[4] + box[5])
    half0, half1, half2 = 0.5 * (box[1] - box[0]), 0.5 * (box[3] - box[2]), 0.5 * (box[5] - box[4])
    ox = bx + a[0, 0] * mid0 + a[0, 1] * mid1 + a[0, 2] * mid2
    oy = by + a[1, 0] * mid0 + a[1, 1] * mid1 + a[1, 2] * mid2
    oz = bz + a[2, 0] * mid0 + a[2, 1] * mid1 + a[2, 2] * mid2
    ex = abs(a[0, 0]) * half0 + abs(a[0, 1]) * half1 + abs(a[0, 2]) * half2
    ey = abs(a[1, 0]) * half0 + abs(a[1, 1]) * half1 + abs(a[1, 2]) * half2
    ez = abs(a[2, 0]) * half0 + abs(a[2, 1]) * half1 + abs(a[2, 2]) * half2
    i0 = max(math.floor((ox - ex - corner[0]) * inverse), 0)
    i1 = min(math.floor((ox + ex - corner[0]) * inverse), shape[0] - 1)
    j0 = max(math.floor((oy - ey - corner[1]) * inverse), 0)
    j1 = min(math.floor((oy + ey - corner[1]) * inverse), shape[1] - 1)
    # a column of voxels is cut by the box made wider by half the column's own width
    reach0 = half0 + 0.5 * voxel * (abs(a[0, 0]) + abs(a[1, 0]))
    reach1 = half1 + 0.5 * voxel * (abs(a[0, 1]) + abs(a[1, 1]))
    reach2 = half2 + 0.5 * voxel * (abs(a[0, 2]) + abs(a[1, 2]))
    for i in range(i0, i1 + 1):
        lx = corner[0] + (i + 0.5) * voxel - ox
        for j in range(j0, j1 + 1):
            ly = corner[1] + (j + 0.5) * voxel - oy
            low, high = -ez, ez
            low, high = _slab(a[0, 0] * lx + a[1, 0] * ly, a[2, 0], reach0, low, high)
            low, high = _slab(a[0, 1] * lx + a[1, 1] * ly, a[2, 1], reach1, low, high)
            low, high = _slab(a[0, 2] * lx + a[1, 2] * ly, a[2, 2], reach2, low, high)
            if low > high:
                continue
            k0 = max(math.floor((oz + low - corner[2]) * inverse), 0)
            k1 = min(math.floor((oz + high - corner[2]) * inverse), shape[2] - 1)
            if k0 > k1:
                continue
            column = (i * shape[1] + j) * shape[2]
            for n in range(first[column + k0], first[column + k1 + 1]):
                x, y, z = cloud[n, 0] - bx, cloud[n, 1] - by, cloud[n, 2] - bz
                s0 = a[0, 0] * x + a[1, 0] * y + a[2, 0] * z
                s1 = a[0, 1] * x + a[1, 1] * y + a[2, 1] * z
                if s0 < box[0] or s0 > box[1] or s1 < box[2] or s1 > box[3]:
                    continue
                s2 = a[0, 2] * x + a[1, 2] * y + a[2, 2] * z
                floor = skin[0] + s0 * (skin[1] + skin[3] * s0 + skin[4] * s1) + s1 * (skin[2] + skin[5] * s1)
                if abs(s2 - floor) > skin[6]:
                    continue
                s0 -= centroid[0]
                s1 -= centroid[1]
                s2 -= centroid[2]
                count += 1
                behind = third[0] * s0 + third[1] * s1 + third[2] * s2
                if behind < 0.0:
                    penetration -= behind
                sums[0] += s0
                sums[1] += s1
                sums[2] += s2
                sums[3] += s0 * s0
                sums[4] += s1 * s1
                sums[5] += s2 * s2
                sums[6] += s0 * s1
                sums[7] += s0 * s2
                sums[8] += s1 * s2
    return count, penetration


@numba.njit(cache=True, nogil=True, inline="always")
def _slab(at, slope, reach, low, high):
    """The part of low..high where |at + z slope| <= reach."""
    if abs(slope) < 1e-9:
        return (low, high) if abs(at) <= reach else (1.0, 0.0)
    one, other = (-reach - at) / slope, (reach - at) / slope
    return max(low, min(one, other)), min(high, max(one, other))


@numba.njit(cache=True, nogil=True)
def place(x, start, middle, centroid, rotations, translations):
    """poses.perturb for one pose: x (6,) from a start (3, 3) whose centroid (3,) is at `middle` (3,); fills rotations
    (1, 3, 3) and translations (1, 3).
    """
    _exp_times(x, start, rotations[0])
    r = rotations[0]
    for i in range(3):
        moved = r[i, 0] * centroid[0] + r[i, 1] * centroid[1] + r[i, 2] * centroid[2]
        translations[0, i] = middle[i] + x[3 + i] - moved


@numba.njit(cache=True, nogil=True)
def distance_costs(values, origin, spacing, points, first, rotations, translations, out):
    """T1 algorithm 5.3 for every pose: the mean squared distance of each contact's elements, summed over contacts.

    points (n, 3) in the poses' frame, those of contact k are first[k]:first[k + 1]; fills out (b,), m^2.
    """
    for p in range(rotations.shape[0]):
        r = rotations[p]
        total = 0.0
        for k in range(first.shape[0] - 1):
            square = 0.0
            for n in range(first[k], first[k + 1]):
                x = points[n, 0] - translations[p, 0]
                y = points[n, 1] - translations[p, 1]
                z = points[n, 2] - translations[p, 2]
                d = value_at(
                    values,
                    origin,
                    spacing,
                    r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
                    r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
                    r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
                )
                square += d * d
            total += square / max(first[k + 1] - first[k], 1)
        out[p] = total


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
            if height <= 0.0 or height >= depth or abs(d) < 2e-5:
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
