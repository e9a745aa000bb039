"""The published costs of tactile arrays over poses, compiled: T1 algorithms 5.2 and 5.3.

A pose is (R, t) frame_from_object, readings are given in that frame once. Everything in metres; one pose is worked by
one thread from start to end.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.lattice import value_at
from scenes.geometry.rotation_kernels import exp_times


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
    exp_times(x, start, rotations[0])
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
