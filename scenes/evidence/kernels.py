"""The compiled heart: value, gradient and Gauss-Newton terms of a table of evidence at a pose.

A pose is (R, m): rotation and the object's centroid m in the evidence's frame; the perturbation is
R <- exp(theta) R, m <- m + tau (poses.perturb). With y = p - m, q = R^T y + centroid, G = R grad d(q):

    dr/dtheta = (G x y) / sigma,   dr/dtau = -G / sigma

and for a contact normal n with the model's a = R g/|g| and M = R (I - gg^T/|g|^2)/|g| H R^T, H the lattice's second
differences:  r_n = (n - a) / sigma_n,  dr_n/dtheta = ([a]x - M [y]x) / sigma_n,  dr_n/dtau = M / sigma_n.
A contact that is felt sigma beside its true place meets a normal turned by M sigma there: sigma_n^2 grows by
sigma^2 |M|^2 / 2 and the loss by the logarithm of that growth (errors in variables). Without it a contact at an edge
would claim to know its place to micrometres.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT, spare_blas
from scenes.evidence.block_kernels import (
    ABOVE,
    BELOW,
    BLOCK,
    CONSTANT_ABOVE,
    CONSTANT_BELOW,
    GX,
    GY,
    GZ,
    INVERSES,
    LENGTH,
    OFFSETS,
    ROOM,
    SUMS,
    WEIGHTS,
    YX,
    YY,
    YZ,
    D,
    add_sums,
    add_terms,
    block_terms,
    blocks_of,
    is_silent,
    lay_blocks,
    look_up,
    place,
    rows_in,
    weigh,
    weigh_limited,
)
from scenes.evidence.prior_kernels import prior_terms
from scenes.evidence.row_kernels import FLOOR_ABOVE, FLOOR_BELOW, INVERSE, NARROW, PREPARED, prepare, robust
from scenes.evidence.table import FACING, GATE_ABOVE, GATE_BELOW, OFFSET, WEIGHT
from scenes.geometry.lattice import distance_at, led_back_at, normal_at

spare_blas()

# Where the lattice's smoothed gradient is shorter than this (medial axis, thin edges) the model has no one normal:
# the gradient is then divided by this instead of its length, so that the cost stays continuous and stays a cost.
SHORTEST_GRADIENT = 0.15


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def cost_terms(lattice, rows, huber, bend, rotation, middle, prior, need, hessian, gradient, scratch):
    """Cost (negative log posterior up to a constant) at a pose; fills hessian (6, 6) and gradient (6,) when `need`.

    rows (n, PREPARED): see row_kernels.prepare. huber: see robust, 0 = off. bend: share of a point's sigma that counts
    as not knowing where on a bent surface its normal was felt; that widening is taken as constant in the derivatives.
    lattice: values, origin, spacing, step by which points are led back, and the object's
    centroid. prior: rotation (3, 3), middle (3,) and information
    (6, 6) about them, zeros when there is none. scratch (10, 3): working room.
    """
    values, origin, spacing, lead, centroid = lattice
    total = 0.0
    if need:
        for i in range(6):
            gradient[i] = 0.0
            for j in range(6):
                hessian[i, j] = 0.0
    g = scratch[0]
    h = scratch[1:4]
    m = scratch[4:7]
    jac = scratch[7:9].reshape(6)
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    h00 = h10 = h11 = h20 = h21 = h22 = h30 = h31 = h32 = h33 = 0.0
    h40 = h41 = h42 = h43 = h44 = h50 = h51 = h52 = h53 = h54 = h55 = 0.0
    for n in range(rows.shape[0]):
        yx = rows[n, 0] - middle[0]
        yy = rows[n, 1] - middle[1]
        yz = rows[n, 2] - middle[2]
        qx = r00 * yx + r10 * yy + r20 * yz + centroid[0]
        qy = r01 * yx + r11 * yy + r21 * yz + centroid[1]
        qz = r02 * yx + r12 * yy + r22 * yz + centroid[2]
        narrow = rows[n, NARROW]
        with_normal = narrow > 0.0
        d, gx, gy, gz = distance_at(values, origin, spacing, qx, qy, qz)
        # where the normal is looked up: at the point, or where that was led back to
        fx, fy, fz = qx, qy, qz
        if rows[n, FACING] > 0.0:
            # a pixel brings its ray, a contact its outward normal: a finger comes from where that points to
            sign = -1.0 if with_normal else 1.0
            vx = sign * (r00 * rows[n, 3] + r10 * rows[n, 4] + r20 * rows[n, 5])
            vy = sign * (r01 * rows[n, 3] + r11 * rows[n, 4] + r21 * rows[n, 5])
            vz = sign * (r02 * rows[n, 3] + r12 * rows[n, 4] + r22 * rows[n, 5])
            if gx * vx + gy * vy + gz * vz > 0.0:
                d, gx, gy, gz = led_back_at(values, origin, spacing, lead, qx, qy, qz, vx, vy, vz)
                fx, fy, fz = qx - d * gx, qy - d * gy, qz - d * gz
        d -= rows[n, OFFSET]
        gate, floor = (
            (rows[n, GATE_ABOVE], rows[n, FLOOR_ABOVE]) if d > 0.0 else (rows[n, GATE_BELOW], rows[n, FLOOR_BELOW])
        )
        if gate == 0.0:
            continue
        inverse = rows[n, INVERSE]
        r = d * inverse
        s = r * r
        ax = ay = az = ex = ey = ez = length = inverse_normal = 0.0
        if with_normal:
            normal_at(values, origin, spacing, fx, fy, fz, g, h)
            length = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
            length = max(length, SHORTEST_GRADIENT)
            ux, uy, uz = g[0] / length, g[1] / length, g[2] / length
            # where the surface bends, the error of the point tilts the normal that it is compared with
            turning = 0.0
            for j in range(3):
                along = ux * h[0, j] + uy * h[1, j] + uz * h[2, j]
                turning += h[0, j] * h[0, j] + h[1, j] * h[1, j] + h[2, j] * h[2, j] - along * along
            turning *= 0.5 * bend * bend / (length * length)
            wide = narrow + rows[n, 6] * rows[n, 6] * max(turning, 0.0)
            inverse_normal = 1.0 / math.sqrt(wide)
            ax = r00 * ux + r01 * uy + r02 * uz
            ay = r10 * ux + r11 * uy + r12 * uz
            az = r20 * ux + r21 * uy + r22 * uz
            ex = (rows[n, 3] - ax) * inverse_normal
            ey = (rows[n, 4] - ay) * inverse_normal
            ez = (rows[n, 5] - az) * inverse_normal
            s += ex * ex + ey * ey + ez * ez + 2.0 * math.log(wide / narrow)
        rho, belongs = robust(s, gate, floor, huber)
        weight = rows[n, WEIGHT]
        total += 0.5 * weight * rho
        w = weight * belongs
        if not need or w < 1e-12:
            continue
        vx = (r00 * gx + r01 * gy + r02 * gz) * inverse
        vy = (r10 * gx + r11 * gy + r12 * gz) * inverse
        vz = (r20 * gx + r21 * gy + r22 * gz) * inverse
        # in registers, not in the arrays: this is most of what an aligner does
        j0 = vy * yz - vz * yy
        j1 = vz * yx - vx * yz
        j2 = vx * yy - vy * yx
        w0, w1, w2, w3, w4, w5 = w * j0, w * j1, w * j2, -w * vx, -w * vy, -w * vz
        g0 += w0 * r
        g1 += w1 * r
        g2 += w2 * r
        g3 += w3 * r
        g4 += w4 * r
        g5 += w5 * r
        h00 += w0 * j0
        h10 += w1 * j0
        h11 += w1 * j1
        h20 += w2 * j0
        h21 += w2 * j1
        h22 += w2 * j2
        h30 += w3 * j0
        h31 += w3 * j1
        h32 += w3 * j2
        h33 -= w3 * vx
        h40 += w4 * j0
        h41 += w4 * j1
        h42 += w4 * j2
        h43 -= w4 * vx
        h44 -= w4 * vy
        h50 += w5 * j0
        h51 += w5 * j1
        h52 += w5 * j2
        h53 -= w5 * vx
        h54 -= w5 * vy
        h55 -= w5 * vz
        if with_normal:
            # m = R (I - uu^T) H R^T / |g|, first in object axes; a gradient below the shortest is not of unit length
            ux, uy, uz = g[0] / length, g[1] / length, g[2] / length
            if ux * ux + uy * uy + uz * uz < 0.999999:
                ux = uy = uz = 0.0
            for j in range(3):
                along = ux * h[0, j] + uy * h[1, j] + uz * h[2, j]
                h[0, j] = (h[0, j] - ux * along) / length
                h[1, j] = (h[1, j] - uy * along) / length
                h[2, j] = (h[2, j] - uz * along) / length
            for i in range(3):
                p = rotation[i, 0] * h[0, 0] + rotation[i, 1] * h[1, 0] + rotation[i, 2] * h[2, 0]
                q = rotation[i, 0] * h[0, 1] + rotation[i, 1] * h[1, 1] + rotation[i, 2] * h[2, 1]
                t = rotation[i, 0] * h[0, 2] + rotation[i, 1] * h[1, 2] + rotation[i, 2] * h[2, 2]
                for j in range(3):
                    m[i, j] = p * rotation[j, 0] + q * rotation[j, 1] + t * rotation[j, 2]
            for i in range(3):
                # row i of [a]x - M [y]x, then of M
                if i == 0:
                    cx, cy, cz, e = 0.0, -az, ay, ex
                elif i == 1:
                    cx, cy, cz, e = az, 0.0, -ax, ey
                else:
                    cx, cy, cz, e = -ay, ax, 0.0, ez
                jac[0] = (cx - (m[i, 1] * yz - m[i, 2] * yy)) * inverse_normal
                jac[1] = (cy - (m[i, 2] * yx - m[i, 0] * yz)) * inverse_normal
                jac[2] = (cz - (m[i, 0] * yy - m[i, 1] * yx)) * inverse_normal
                jac[3] = m[i, 0] * inverse_normal
                jac[4] = m[i, 1] * inverse_normal
                jac[5] = m[i, 2] * inverse_normal
                for k in range(6):
                    wj = w * jac[k]
                    gradient[k] += wj * e
                    for j in range(k + 1):
                        hessian[k, j] += wj * jac[j]
    if need:
        for i, sum_g in enumerate((g0, g1, g2, g3, g4, g5)):
            gradient[i] += sum_g
        sums = (
            (h00, 0.0, 0.0, 0.0, 0.0, 0.0),
            (h10, h11, 0.0, 0.0, 0.0, 0.0),
            (h20, h21, h22, 0.0, 0.0, 0.0),
            (h30, h31, h32, h33, 0.0, 0.0),
            (h40, h41, h42, h43, h44, 0.0),
            (h50, h51, h52, h53, h54, h55),
        )
        for i in range(6):
            for j in range(i + 1):
                hessian[i, j] += sums[i][j]
    total += prior_terms(rotation, middle, prior, need, hessian, gradient, scratch)
    if need:
        for i in range(6):
            for j in range(i):
                hessian[j, i] = hessian[i, j]
    return total


@numba.njit(cache=True, nogil=True)
def sort_rows(rows, blur, blur_normal):
    """A table (n, COLUMNS) as the kernels work on it: prepared rows with a normal; the other rows in blocks, and how
    many; and of those the ones that say nothing where they are outside, in blocks, and how many.
    """
    prepared = prepare(rows, blur, blur_normal)
    counts = np.zeros(3, dtype=np.int64)
    for n in range(prepared.shape[0]):
        counts[0 if prepared[n, NARROW] > 0.0 else (2 if is_silent(prepared[n]) else 1)] += 1
    speaking, silent = blocks_of(counts[1]), blocks_of(counts[2])
    lay_blocks(prepared, False, speaking)
    lay_blocks(prepared, True, silent)
    contacts = np.zeros((counts[0], PREPARED))
    k = 0
    for n in range(prepared.shape[0]):
        if prepared[n, NARROW] > 0.0:
            contacts[k] = prepared[n]
            k += 1
    return contacts, speaking, counts[1], silent, counts[2]


@numba.njit(cache=True, nogil=True)
def working_room():
    """What `table_terms` works in: once for many poses."""
    nodes = np.zeros((2, LENGTH), dtype=np.int32)
    return np.zeros((10, 3)), np.zeros((2, ROOM)), nodes, np.zeros(SUMS), np.zeros(BLOCK)


@numba.njit(cache=True, nogil=True, **LENT)
def silent_terms(lattice, blocks, count, huber, rotation, middle, need, rooms, nodes, held, sums):
    """block_terms of rows that say nothing where they are outside, as most of what was seen to be empty is: the others
    are gathered into a block of their own, held (BLOCK,), and only that is weighed.
    """
    flat, room, other, total, k = lattice[0].reshape(-1), rooms[0], rooms[1], 0.0, 0
    for b in range((count + LENGTH - 1) // LENGTH):
        block, whole = blocks[b], rows_in(count, b)
        place(block, whole, room, rotation, middle, lattice[4])
        look_up(whole, room, nodes[0], flat, lattice)
        for i in range(min(count - b * LENGTH, LENGTH)):
            if room[D + i] - block[OFFSETS + i] > 0.0:
                continue
            for column in (INVERSES, WEIGHTS, ABOVE, BELOW, CONSTANT_ABOVE, CONSTANT_BELOW, OFFSETS):
                held[column + k] = block[column + i]
            for column in (YX, YY, YZ, D, GX, GY, GZ):
                other[column + k] = room[column + i]
            k += 1
            if k == LENGTH:
                total += _gathered(held, other, k, huber, rotation, need, sums)
                k = 0
    if k > 0:
        total += _gathered(held, other, k, huber, rotation, need, sums)
    return total


@numba.njit(cache=True, nogil=True, **LENT)
def _gathered(held, room, count, huber, rotation, need, sums):
    """Cost of so many rows that were gathered into a block and a room, at least one; see silent_terms."""
    whole = rows_in(count, 0)
    for i in range(count, whole):
        # copies of the last that weigh nothing
        for column in (INVERSES, WEIGHTS, ABOVE, BELOW, CONSTANT_ABOVE, CONSTANT_BELOW, OFFSETS):
            held[column + i] = held[column + count - 1]
        for column in (YX, YY, YZ, D, GX, GY, GZ):
            room[column + i] = room[column + count - 1]
        held[WEIGHTS + i] = 0.0
    total = weigh_limited(held, whole, room, huber) if huber > 0.0 else weigh(held, whole, room)
    if need:
        add_terms(held, whole, room, rotation, sums)
    return total


@numba.njit(cache=True, nogil=True, **LENT)
def table_terms(lattice, table, near, losses, pose, prior, need, derivatives, room):
    """cost_terms of a whole table: prepared rows with a normal, the other rows in blocks and how many. near: blocks of
    silent rows, and how many. losses: huber, bend. pose: rotation, middle. derivatives: hessian, gradient.
    room: see `working_room`.
    """
    contacts, speaking, count = table
    others, more = near
    huber, bend = losses
    rotation, middle = pose
    hessian, gradient = derivatives
    scratch, rooms, nodes, sums, held = room
    total = cost_terms(lattice, contacts, huber, bend, rotation, middle, prior, need, hessian, gradient, scratch)
    sums[:] = 0.0
    if count > 0:
        total += block_terms(lattice, speaking, count, huber, rotation, middle, need, rooms, nodes, sums)
    if more > 0:
        total += silent_terms(lattice, others, more, huber, rotation, middle, need, rooms, nodes, held, sums)
    if need and count + more > 0:
        add_sums(sums, hessian, gradient)
    return total


@numba.njit(cache=True, nogil=True)
def cost_poses(lattice, rows, stage, prior, rotations, middles, costs):
    """Costs (b,) of poses, without derivatives.

    rows (n, 13): see scenes.evidence.table. stage: blur (m), blur of normals (rad), huber, bend. lattice, prior: as in
    cost_terms.
    """
    blur, blur_normal, huber, bend = stage
    derivatives, room = (np.zeros((6, 6)), np.zeros(6)), working_room()
    contacts, speaking, count, silent, more = sort_rows(rows, blur, blur_normal)
    table, others = (contacts, speaking, count), (silent, more)
    _cost_each(lattice, table, others, (huber, bend), rotations, middles, prior, derivatives, room, costs)


@numba.njit(cache=True, nogil=True, **LENT)
def _cost_each(lattice, table, others, losses, rotations, middles, prior, derivatives, room, costs):
    """Fill costs (b,) of poses; see table_terms."""
    for b in range(rotations.shape[0]):
        pose = rotations[b], middles[b]
        costs[b] = table_terms(lattice, table, others, losses, pose, prior, False, derivatives, room)


@numba.njit(cache=True, nogil=True)
def terms_at(lattice, rows, stage, prior, rotation, middle, hessian, gradient):
    """Cost at one pose; fills hessian (6, 6) and gradient (6,). Arguments as of cost_poses."""
    blur, blur_normal, huber, bend = stage
    contacts, speaking, count, silent, more = sort_rows(rows, blur, blur_normal)
    table, others = (contacts, speaking, count), (silent, more)
    losses, pose, derivatives = (huber, bend), (rotation, middle), (hessian, gradient)
    return table_terms(lattice, table, others, losses, pose, prior, True, derivatives, working_room())
