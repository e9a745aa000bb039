"""The compiled rows of the joint solution: what pixels say of a pose, a depth scale and a bias, and what touch does.

A pixel at p is corrected by the depth scale s and the bias b of its place along its ray, p (1 - s) - b p / p_z, before
its distance d to the surface is looked up. What lies beside a pixel, and what a mesh leaves out, counts along the ray:
the residual is d divided by the cosine of the incidence.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT, fused
from scenes.evidence.kernels import cost_terms
from scenes.evidence.prior_kernels import prior_terms
from scenes.evidence.row_kernels import robust
from scenes.evidence.table import FACING, GATE_ABOVE, GATE_BELOW, OFFSET
from scenes.geometry.lattice import distance_at, led_back_at, seen_distance_at
from scenes.geometry.rotation_kernels import exp_times

# Rows that belong to the object with less than this weight say nothing: most free space is far from it.
LEAST_WEIGHT = 1e-9


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def vision_rows(
    lattice,
    rows,
    floors,
    is_pixel,
    sigma,
    weight,
    normals,
    slope,
    least_cosine,
    has_camera,
    rotation,
    middle,
    scale,
    bias,
    index,
    jac,
    along,
    residuals,
    information,
):
    """Cost of the vision rows at a pose; fills the first k entries of the outputs, and returns (cost, k).

    lattice: see kernels.cost_terms. rows (n, 13): see scenes.evidence.table. floors (n, 2): row_kernels.loss_floor of
    the gates above and below. is_pixel (n,): rows that are pixels of a surface. sigma (n,) m before slope (n,), the
    factor that the incidence makes of it; weight (n,). normals (n, 3): of the surface met, object frame. rotation (3,
    3), middle (3,): camera_from_object, of the centroid. scale; bias (n,) m.
    Outputs, all (n, ...): index of the row; jac by (turn, move, scale); along: by its bias; residuals in m;
    information: weight / sigma^2.
    """
    values, origin, spacing, lead, centroid = lattice
    total = 0.0
    k = 0
    for n in range(rows.shape[0]):
        px, py, pz = rows[n, 0], rows[n, 1], rows[n, 2]
        rx, ry, rz = px, py, pz
        if has_camera:
            rx, ry, rz = px / pz, py / pz, 1.0
        yx = px - scale * px - bias[n] * rx - middle[0]
        yy = py - scale * py - bias[n] * ry - middle[1]
        yz = pz - scale * pz - bias[n] * rz - middle[2]
        qx = rotation[0, 0] * yx + rotation[1, 0] * yy + rotation[2, 0] * yz + centroid[0]
        qy = rotation[0, 1] * yx + rotation[1, 1] * yy + rotation[2, 1] * yz + centroid[1]
        qz = rotation[0, 2] * yx + rotation[1, 2] * yy + rotation[2, 2] * yz + centroid[2]
        nx, ny, nz = rows[n, 3], rows[n, 4], rows[n, 5]
        d, ox, oy, oz = distance_at(values, origin, spacing, qx, qy, qz)
        if rows[n, FACING] > 0.0:
            # as lattice.seen_distance_at
            vx = rotation[0, 0] * nx + rotation[1, 0] * ny + rotation[2, 0] * nz
            vy = rotation[0, 1] * nx + rotation[1, 1] * ny + rotation[2, 1] * nz
            vz = rotation[0, 2] * nx + rotation[1, 2] * ny + rotation[2, 2] * nz
            if not ox * vx + oy * vy + oz * vz <= 0.0:
                d, ox, oy, oz = led_back_at(values, origin, spacing, lead, qx, qy, qz, vx, vy, vz)
        d -= rows[n, OFFSET]
        gate, floor = (rows[n, GATE_ABOVE], floors[n, 0]) if d > 0.0 else (rows[n, GATE_BELOW], floors[n, 1])
        if gate == 0.0:
            continue
        gx = rotation[0, 0] * ox + rotation[0, 1] * oy + rotation[0, 2] * oz
        gy = rotation[1, 0] * ox + rotation[1, 1] * oy + rotation[1, 2] * oz
        gz = rotation[2, 0] * ox + rotation[2, 1] * oy + rotation[2, 2] * oz
        tx = ty = tz = 0.0
        if is_pixel[n]:
            mx, my, mz = normals[n, 0], normals[n, 1], normals[n, 2]
            ax = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz
            ay = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz
            az = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz
            cosine = -(ax * nx + ay * ny + az * nz)
            if cosine < least_cosine:
                cosine = least_cosine
            else:
                # how the cosine falls as the object turns
                tx = az * ny - ay * nz
                ty = ax * nz - az * nx
                tz = ay * nx - ax * ny
            d /= cosine
            gx /= cosine
            gy /= cosine
            gz /= cosine
            tx *= d / cosine
            ty *= d / cosine
            tz *= d / cosine
        width = sigma[n] * slope[n]
        loss, belongs = robust((d / width) * (d / width) + 2.0 * math.log(slope[n]), gate, floor, 0.0)
        total += 0.5 * weight[n] * loss
        w = weight[n] * belongs
        if w <= LEAST_WEIGHT:
            continue
        index[k] = n
        jac[k, 0] = gy * yz - gz * yy - tx
        jac[k, 1] = gz * yx - gx * yz - ty
        jac[k, 2] = gx * yy - gy * yx - tz
        jac[k, 3] = -gx
        jac[k, 4] = -gy
        jac[k, 5] = -gz
        jac[k, 6] = -(gx * px + gy * py + gz * pz)
        along[k] = -(gx * rx + gy * ry + gz * rz)
        residuals[k] = d
        information[k] = w / (width * width)
        k += 1
    return total, k


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def surface_met(lattice, rows, is_pixel, rotation, middle, normals, cosines):
    """Fill, of rows that are pixels, normals (n, 3) of the surface met, object frame, and the incidence's cosines (n,).

    lattice, rows, is_pixel, rotation, middle: as of vision_rows.
    """
    values, origin, spacing, lead, centroid = lattice
    for n in range(rows.shape[0]):
        if not is_pixel[n]:
            continue
        x, y, z = rows[n, 0] - middle[0], rows[n, 1] - middle[1], rows[n, 2] - middle[2]
        qx, qy, qz = turned_back(rotation, x, y, z)
        a, b, c = rows[n, 3], rows[n, 4], rows[n, 5]
        vx, vy, vz = turned_back(rotation, a, b, c)
        qx, qy, qz = qx + centroid[0], qy + centroid[1], qz + centroid[2]
        _, gx, gy, gz = seen_distance_at(values, origin, spacing, lead, qx, qy, qz, vx, vy, vz)
        length = max(math.sqrt((gx * gx + gz * gz) + gy * gy), 1e-9)
        gx, gy, gz = gx / length, gy / length, gz / length
        normals[n, 0], normals[n, 1], normals[n, 2] = gx, gy, gz
        x = fused(gz, rotation[0, 2], fused(gy, rotation[0, 1], gx * rotation[0, 0]))
        y = fused(gz, rotation[1, 2], fused(gy, rotation[1, 1], gx * rotation[1, 0]))
        z = fused(gz, rotation[2, 2], fused(gy, rotation[2, 1], gx * rotation[2, 0]))
        cosines[n] = -((x * a + z * c) + y * b)


@numba.njit(inline="always")
def turned_back(rotation, x, y, z):
    """A vector in the frame that a rotation (3, 3) turns from, with the bits of NumPy's product."""
    return (
        fused(z, rotation[2, 0], fused(y, rotation[1, 0], x * rotation[0, 0])),
        fused(z, rotation[2, 1], fused(y, rotation[1, 1], x * rotation[0, 1])),
        fused(z, rotation[2, 2], fused(y, rotation[1, 2], x * rotation[0, 2])),
    )


@numba.njit(cache=True, nogil=True)
def touch_rows(lattice, rows, bend, rotation, middle, xi, centre, prior, hessian, gradient, scratch):
    """Cost of prepared touch rows (row_kernels.prepare), as the robot reports them, moved by xi (6,) about centre (3,).

    Moving all contacts by xi is moving the object back. Fills hessian (6, 6) and gradient (6,) by the pose (turn, move;
    camera axes). prior: one that says nothing; scratch (10, 3): working room.
    """
    turn = np.zeros((3, 3))
    exp_times(xi, np.eye(3), turn)
    back = np.zeros(3)
    for i in range(3):
        for j in range(3):
            back[i] += turn[j, i] * (middle[j] - centre[j] - xi[3 + j])
        back[i] += centre[i]
    turned = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turned[i, j] += turn[k, i] * rotation[k, j]
    cost = cost_terms(lattice, rows, 0.0, bend, turned, back, prior, True, hessian, gradient, scratch)
    # back to camera axes: turn and move each turned, by hand since a call of BLAS costs more than so few products
    half = np.zeros((6, 6))
    slope = gradient.copy()
    gradient[:] = 0.0
    for block in range(0, 6, 3):
        for i in range(3):
            for k in range(3):
                gradient[block + i] += turn[i, k] * slope[block + k]
                for j in range(6):
                    half[block + i, j] += turn[i, k] * hessian[block + k, j]
    hessian[:] = 0.0
    for block in range(0, 6, 3):
        for j in range(3):
            for k in range(3):
                for i in range(6):
                    hessian[i, block + j] += half[i, block + k] * turn[j, k]
    return cost


@numba.njit(cache=True, nogil=True)
def prior_row(rotation, middle, prior, hessian, gradient):
    """Cost of a Gaussian on the pose; fills hessian (6, 6) and gradient (6,)."""
    hessian[:] = 0.0
    gradient[:] = 0.0
    cost = prior_terms(rotation, middle, prior, True, hessian, gradient, np.zeros((10, 3)))
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return cost


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def places(points, lens, uv, bounds):
    """Fill uv (n, 2) with the pixels of points (n, 3), NaN at z <= 0, and bounds (2, 2) with the least and the largest
    of them along both axes; lens (fx, fy, cx, cy).
    """
    fx, fy, cx, cy = lens
    bounds[0], bounds[1] = math.inf, -math.inf
    for n in range(points.shape[0]):
        z = points[n, 2] if points[n, 2] > 0.0 else math.nan
        uv[n, 0], uv[n, 1] = fx * points[n, 0] / z + cx, fy * points[n, 1] / z + cy
        for i in range(2):
            bounds[0, i], bounds[1, i] = min(bounds[0, i], uv[n, i]), max(bounds[1, i], uv[n, i])


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def hand_rows(points, directions, centre, basis, jacobian):
    """Fill jacobian (n, 7 + k): how the distances of a hand's pixels (n, 3) change, whose gradients are directions
    (n, 3), with a turn and a move of the hand about centre (3,), with a scale of depth, and with k parts of a bias
    along their rays, which have basis (n, k) there.
    """
    for n in range(points.shape[0]):
        x, y, z = points[n, 0] - centre[0], points[n, 1] - centre[1], points[n, 2] - centre[2]
        a, b, c = directions[n, 0], directions[n, 1], directions[n, 2]
        jacobian[n, 0], jacobian[n, 1], jacobian[n, 2] = -(y * c - z * b), -(z * a - x * c), -(x * b - y * a)
        jacobian[n, 3], jacobian[n, 4], jacobian[n, 5] = -a, -b, -c
        depth = points[n, 2]
        along = -(a * (points[n, 0] / depth) + b * (points[n, 1] / depth) + c * (depth / depth))
        jacobian[n, 6] = along * depth
        for k in range(basis.shape[1]):
            jacobian[n, 7 + k] = along * basis[n, k]


@numba.njit(cache=True, nogil=True, **LENT)
def mark_near(grid, points, reach, out):
    """Fill out (k,) with whether any of points (n, 2) is nearer than reach to each of grid (k, 2)."""
    for k in range(grid.shape[0]):
        for n in range(points.shape[0]):
            a, b = grid[k, 0] - points[n, 0], grid[k, 1] - points[n, 1]
            if a * a + b * b < reach * reach:
                out[k] = True
                break


@numba.njit(cache=True, nogil=True)
def number_blocks(uv, index, count, least, out):
    """Fill out (n,) with the block of the image that each of the pixels `index` (n,), at least one, of uv (m, 2) is in:
    squares about `count` of which cover them all, no side shorter than `least` px, numbered column by column, without
    gaps. Returns how many there are.
    """
    low_u, high_u, low_v, high_v = math.inf, -math.inf, math.inf, -math.inf
    for k in range(index.shape[0]):
        u, v = uv[index[k], 0], uv[index[k], 1]
        low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    side = max(least, math.sqrt((high_u - low_u + 1.0) * (high_v - low_v + 1.0) / count))
    columns, rows = math.floor((high_u - low_u) / side) + 1, math.floor((high_v - low_v) / side) + 1
    number = np.zeros(columns * rows, dtype=np.int64)
    for k in range(index.shape[0]):
        u, v = uv[index[k], 0], uv[index[k], 1]
        block = math.floor((u - low_u) / side) * rows + math.floor((v - low_v) / side)
        out[k] = block
        number[block] = 1
    found = 0
    for block in range(columns * rows):
        found += number[block]
        number[block] = found - 1
    for k in range(index.shape[0]):
        out[k] = number[out[k]]
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def blocks_off(uv, on, index, residuals, information, count, least):
    """How far (b,) m blocks of the image (`number_blocks`) are off on average, and their weights (b,) 1/m^2, by those
    of the rows `index` (n,) that are on (m,) the surface and tell something; none where none does. uv (m, 2), residuals
    (n,) m, information (n,) 1/m^2.
    """
    mine, places = np.zeros(index.shape[0], dtype=np.int64), np.zeros(index.shape[0], dtype=np.int64)
    told = 0
    for n in range(index.shape[0]):
        if on[index[n]] and information[n] > 0.0:
            mine[told], places[told] = index[n], n
            told += 1
    if told == 0:
        return np.zeros(0), np.zeros(0)
    block = np.zeros(told, dtype=np.int64)
    found = number_blocks(uv, mine[:told], count, least, block)
    off, weight = np.zeros(found), np.zeros(found)
    for k in range(told):
        own = information[places[k]]
        weight[block[k]] += own
        off[block[k]] += own * residuals[places[k]]
    for b in range(found):
        off[b] /= weight[b]
    return off, weight


@numba.njit(cache=True, nogil=True)
def lay_bells(uv, columns, column, rows, row, sharpness, out):
    """Fill out (n, k) with exp(sharpness |uv - place|^2) of pixels uv (n, 2) and of k places on a grid's lines: place j
    is on columns[column[j]] and rows[row[j]]. A bell is the product of those along the axes, of which there are few.
    """
    along, across = np.zeros(columns.shape[0]), np.zeros(rows.shape[0])
    for n in range(uv.shape[0]):
        for i in range(columns.shape[0]):
            along[i] = math.exp(sharpness * (uv[n, 0] - columns[i]) ** 2)
        for i in range(rows.shape[0]):
            across[i] = math.exp(sharpness * (uv[n, 1] - rows[i]) ** 2)
        for j in range(out.shape[1]):
            out[n, j] = along[column[j]] * across[row[j]]


@numba.njit(cache=True, nogil=True)
def log_mixture(z, means, factors, counts, out):
    """Fill out (n,) with the log density, up to a constant, of a mixture of Gaussians at points z (n, d): counts (k,)
    of each, means (k, d), lower factors (k, d, d).
    """
    size, each = z.shape[1], np.zeros(means.shape[0])
    white = np.zeros(size)
    for n in range(z.shape[0]):
        for k in range(means.shape[0]):
            each[k] = math.log(counts[k])
            for i in range(size):
                total = z[n, i] - means[k, i]
                for j in range(i):
                    total -= factors[k, i, j] * white[j]
                white[i] = total / factors[k, i, i]
                each[k] -= 0.5 * white[i] * white[i] + math.log(abs(factors[k, i, i]))
        most = each.max()
        total = 0.0
        for k in range(means.shape[0]):
            total += math.exp(each[k] - most)
        out[n] = most + math.log(total)
