"""Compiled look-ups in a signed-distance lattice: trilinear value, gradient and second differences.

Inside the box the value is the trilinear interpolation of eight nodes and its gradient is that
polynomial's own derivative. Outside, the distance to the box is added to the value at the nearest point
of the box, so that a point anywhere in space still knows the way back.
Input is assumed finite (checked at the door by the callers); object frame, metres.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT

# Nodes are addressed by the lower corner of their cell; the last cell ends this little before the last node.
END = 1e-4
# A gradient shorter than this has no direction.
_SHORTEST = 1e-12
# Nodes are found by unsigned numbers, which need no test for counting from the end.
_NEXT = np.uint64(1)


@numba.njit(cache=True, nogil=True, inline="always")
def _clamp(value, upper):
    return min(max(value, 0.0), upper)


@numba.njit(inline="always")
def trilinear(d000, d001, d010, d011, d100, d101, d110, d111, a, b, c, inverse):
    """The value between eight nodes at shares a, b, c of a cell along each axis, and its gradient by the inverse of the
    cell's side.
    """
    c00 = d000 + (d001 - d000) * c
    c01 = d010 + (d011 - d010) * c
    c10 = d100 + (d101 - d100) * c
    c11 = d110 + (d111 - d110) * c
    c0 = c00 + (c01 - c00) * b
    c1 = c10 + (c11 - c10) * b
    d = c0 + (c1 - c0) * a
    gx = (c1 - c0) * inverse
    gy = ((c01 - c00) * (1.0 - a) + (c11 - c10) * a) * inverse
    gz = (
        ((d001 - d000) * (1.0 - b) + (d011 - d010) * b) * (1.0 - a)
        + ((d101 - d100) * (1.0 - b) + (d111 - d110) * b) * a
    ) * inverse
    return d, gx, gy, gz


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def distance_at(values, origin, spacing, x, y, z):
    """Signed distance and its gradient at one point: (d, gx, gy, gz)."""
    nx, ny, nz = values.shape
    inverse = 1.0 / spacing
    u = (x - origin[0]) * inverse
    v = (y - origin[1]) * inverse
    w = (z - origin[2]) * inverse
    cu = _clamp(u, nx - 1 - END)
    cv = _clamp(v, ny - 1 - END)
    cw = _clamp(w, nz - 1 - END)
    i = int(cu)
    j = int(cv)
    k = int(cw)
    a = cu - i
    b = cv - j
    c = cw - k
    il, jl, kl = np.uint64(i), np.uint64(j), np.uint64(k)
    ih, jh, kh = il + _NEXT, jl + _NEXT, kl + _NEXT
    # differences of single-precision nodes are taken in double precision
    d000 = np.float64(values[il, jl, kl])
    d001 = np.float64(values[il, jl, kh])
    d010 = np.float64(values[il, jh, kl])
    d011 = np.float64(values[il, jh, kh])
    d100 = np.float64(values[ih, jl, kl])
    d101 = np.float64(values[ih, jl, kh])
    d110 = np.float64(values[ih, jh, kl])
    d111 = np.float64(values[ih, jh, kh])
    d, gx, gy, gz = trilinear(d000, d001, d010, d011, d100, d101, d110, d111, a, b, c, inverse)
    ou = u - cu
    ov = v - cv
    ow = w - cw
    beyond = ou * ou + ov * ov + ow * ow
    if beyond > 4.0 * END * END:
        length = math.sqrt(beyond)
        d += length * spacing
        # the clamped coordinates no longer move the interpolated part
        gx = (0.0 if ou != 0.0 else gx) + ou / length
        gy = (0.0 if ov != 0.0 else gy) + ov / length
        gz = (0.0 if ow != 0.0 else gz) + ow / length
    return d, gx, gy, gz


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def value_at(values, origin, spacing, x, y, z):
    """Signed distance alone, for searches that only rank."""
    nx, ny, nz = values.shape
    inverse = 1.0 / spacing
    u = (x - origin[0]) * inverse
    v = (y - origin[1]) * inverse
    w = (z - origin[2]) * inverse
    cu = _clamp(u, nx - 1 - END)
    cv = _clamp(v, ny - 1 - END)
    cw = _clamp(w, nz - 1 - END)
    i = int(cu)
    j = int(cv)
    k = int(cw)
    a = cu - i
    b = cv - j
    c = cw - k
    il, jl, kl = np.uint64(i), np.uint64(j), np.uint64(k)
    ih, jh, kh = il + _NEXT, jl + _NEXT, kl + _NEXT
    c00 = (1.0 - c) * values[il, jl, kl] + c * values[il, jl, kh]
    c01 = (1.0 - c) * values[il, jh, kl] + c * values[il, jh, kh]
    c10 = (1.0 - c) * values[ih, jl, kl] + c * values[ih, jl, kh]
    c11 = (1.0 - c) * values[ih, jh, kl] + c * values[ih, jh, kh]
    c0 = c00 + (c01 - c00) * b
    c1 = c10 + (c11 - c10) * b
    d = c0 + (c1 - c0) * a
    ou = u - cu
    ov = v - cv
    ow = w - cw
    beyond = ou * ou + ov * ov + ow * ow
    if beyond > 4.0 * END * END:
        d += math.sqrt(beyond) * spacing
    return d


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def normal_at(values, origin, spacing, x, y, z, gradient, hessian):
    """Smooth gradient g and its Jacobian, for normals: fills gradient (3,) and hessian (3, 3).

    g interpolates the nodes' central differences, so it is continuous where the plain trilinear
    gradient jumps; its Jacobian is exact, the lattice's second differences. Outside the box g is that
    of the nearest point of the box, which stays where it is when the point moves away from the box.
    """
    nx, ny, nz = values.shape
    inverse = 1.0 / spacing
    half = 0.5 * inverse
    cu = (x - origin[0]) * inverse
    cv = (y - origin[1]) * inverse
    cw = (z - origin[2]) * inverse
    u = _clamp(cu, nx - 1 - END)
    v = _clamp(cv, ny - 1 - END)
    w = _clamp(cw, nz - 1 - END)
    i = int(u)
    j = int(v)
    k = int(w)
    a = u - i
    b = v - j
    c = w - k
    for m in range(3):
        gradient[m] = 0.0
        for n in range(3):
            hessian[m, n] = 0.0
    for di in range(2):
        wa = a if di else 1.0 - a
        sa = inverse if di else -inverse
        ii = i + di
        il = max(ii - 1, 0)
        ih = min(ii + 1, nx - 1)
        for dj in range(2):
            wb = b if dj else 1.0 - b
            sb = inverse if dj else -inverse
            jj = j + dj
            jl = max(jj - 1, 0)
            jh = min(jj + 1, ny - 1)
            for dk in range(2):
                wc = c if dk else 1.0 - c
                sc = inverse if dk else -inverse
                kk = k + dk
                kl = max(kk - 1, 0)
                kh = min(kk + 1, nz - 1)
                gx = (np.float64(values[ih, jj, kk]) - np.float64(values[il, jj, kk])) * half
                gy = (np.float64(values[ii, jh, kk]) - np.float64(values[ii, jl, kk])) * half
                gz = (np.float64(values[ii, jj, kh]) - np.float64(values[ii, jj, kl])) * half
                weight = wa * wb * wc
                ta = sa * wb * wc
                tb = wa * sb * wc
                tc = wa * wb * sc
                gradient[0] += weight * gx
                gradient[1] += weight * gy
                gradient[2] += weight * gz
                hessian[0, 0] += gx * ta
                hessian[0, 1] += gx * tb
                hessian[0, 2] += gx * tc
                hessian[1, 0] += gy * ta
                hessian[1, 1] += gy * tb
                hessian[1, 2] += gy * tc
                hessian[2, 0] += gz * ta
                hessian[2, 1] += gz * tb
                hessian[2, 2] += gz * tc
    for m in range(3):
        if cu != u:
            hessian[m, 0] = 0.0
        if cv != v:
            hessian[m, 1] = 0.0
        if cw != w:
            hessian[m, 2] = 0.0


@numba.njit(cache=True, nogil=True)
def normals(values, origin, spacing, points, out):
    """Fill out (n, 3) with the smooth unit normals at points (n, 3); zeros on the medial axis."""
    gradient, hessian = np.zeros(3), np.zeros((3, 3))
    for n in range(points.shape[0]):
        normal_at(values, origin, spacing, points[n, 0], points[n, 1], points[n, 2], gradient, hessian)
        square = gradient[0] * gradient[0] + gradient[1] * gradient[1] + gradient[2] * gradient[2]
        length = max(math.sqrt(square), _SHORTEST)
        for i in range(3):
            out[n, i] = gradient[i] / length


# Coordinates (m) whose squares overflow are no places.
_FARTHEST = 1e100

# A seen point beyond the far side of a wall is led back towards the camera in so many steps, doubled.
STEPS = 4


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def seen_distance_at(values, origin, spacing, step, x, y, z, vx, vy, vz):
    """Signed distance of a seen point to the surface that faces the camera, and its gradient: (d, gx, gy, gz).

    v (unit) is the viewing direction, object frame; step (m): see DistanceField.step. Where the nearest surface looks
    away from the camera, it cannot be what was seen: the point is led back along v until the nearest surface faces it,
    and that face's distance is continued in a straight line. Across a thin wall the value then goes on falling instead
    of turning back to zero.
    """
    d, gx, gy, gz = distance_at(values, origin, spacing, x, y, z)
    if gx * vx + gy * vy + gz * vz <= 0.0:
        return d, gx, gy, gz
    return led_back_at(values, origin, spacing, step, x, y, z, vx, vy, vz)


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def led_back_at(values, origin, spacing, step, x, y, z, vx, vy, vz):
    """seen_distance_at of a point whose nearest surface is known to look away from the camera."""
    for _ in range(STEPS):
        d, gx, gy, gz = distance_at(values, origin, spacing, x - step * vx, y - step * vy, z - step * vz)
        along = gx * vx + gy * vy + gz * vz
        if along < 0.0:
            return d + step * along, gx, gy, gz
        step *= 2.0
    return -0.5 * step, -vx, -vy, -vz


@numba.njit(cache=True, nogil=True, **LENT)
def distances(values, origin, spacing, points, out, gradients):
    """Fill out (n,) and, when it has n rows, gradients (n, 3) at points (n, 3)."""
    want = gradients.shape[0] == points.shape[0]
    for n in range(points.shape[0]):
        d, gx, gy, gz = distance_at(values, origin, spacing, points[n, 0], points[n, 1], points[n, 2])
        out[n] = d
        if want:
            gradients[n, 0] = gx
            gradients[n, 1] = gy
            gradients[n, 2] = gz


@numba.njit(cache=True, nogil=True, **LENT)
def seen_distances(values, origin, spacing, step, points, rays, facing, out, gradients):
    """Fill out (n,) and gradients (n, 3): seen_distance_at where facing (n,) holds, distance_at elsewhere."""
    for n in range(points.shape[0]):
        if facing[n]:
            d, gx, gy, gz = seen_distance_at(
                values,
                origin,
                spacing,
                step,
                points[n, 0],
                points[n, 1],
                points[n, 2],
                rays[n, 0],
                rays[n, 1],
                rays[n, 2],
            )
        else:
            d, gx, gy, gz = distance_at(values, origin, spacing, points[n, 0], points[n, 1], points[n, 2])
        out[n] = d
        gradients[n, 0] = gx
        gradients[n, 1] = gy
        gradients[n, 2] = gz


# Cells a side of a block of which the least and the largest node are kept.
BLOCK = 4


@numba.njit(cache=True, nogil=True, **LENT)
def blocks(values, low, high):
    """Fill low and high (i, j, k) with the least and the largest node of each block of BLOCK cells a side."""
    for i in range(low.shape[0]):
        for j in range(low.shape[1]):
            for k in range(low.shape[2]):
                least, most = np.inf, -np.inf
                for a in range(i * BLOCK, min((i + 1) * BLOCK + 1, values.shape[0])):
                    for b in range(j * BLOCK, min((j + 1) * BLOCK + 1, values.shape[1])):
                        for c in range(k * BLOCK, min((k + 1) * BLOCK + 1, values.shape[2])):
                            value = np.float64(values[a, b, c])
                            least, most = min(least, value), max(most, value)
                low[i, j, k] = least
                high[i, j, k] = most


@numba.njit(cache=True, nogil=True, **LENT)
def bounds_at(low, high, last, origin, spacing, x, y, z):
    """Bounds (least, most) of the distance at one point, but for rounding: of the block (see `blocks`) it is in, or
    beyond which it is. last (3,): where the lattice ends, nodes along each axis less 1 and END.
    """
    inverse = 1.0 / spacing
    u, v, w = (x - origin[0]) * inverse, (y - origin[1]) * inverse, (z - origin[2]) * inverse
    cu, cv, cw = _clamp(u, last[0]), _clamp(v, last[1]), _clamp(w, last[2])
    i, j, k = int(cu) // BLOCK, int(cv) // BLOCK, int(cw) // BLOCK
    ou, ov, ow = u - cu, v - cv, w - cw
    beyond = ou * ou + ov * ov + ow * ow
    if beyond == 0.0:
        return low[i, j, k], high[i, j, k]
    length = spacing * math.sqrt(beyond)
    # a hair beyond the end counts as inside
    return low[i, j, k] + (length if beyond > 5.0 * END * END else 0.0), high[i, j, k] + length


def check_finite(points: np.ndarray, name: str) -> np.ndarray:
    """(n, 3) contiguous float64 copy-if-needed; raises InputError when a value is not finite."""
    from scenes.errors import InputError

    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name}: expected points of shape (n, 3), got {array.shape}")
    # not true of NaN either
    good = np.abs(array) < _FARTHEST
    if not good.all():
        raise InputError(f"{name}: expected finite points, got {int((~good).any(axis=1).sum())} bad rows")
    return array
