"""Rows without a normal, in blocks that a processor works on several at a time: look-up, loss and derivatives.

A pixel and a point of empty space need no branch, so that one instruction does what it does for four or eight of them;
one row at a time costs three to eight times as much. Each step is a loop over the rows of a block: places in the
lattice, nodes (fetched one by one), the polynomial between them, the loss. What needs another look (points beyond a
thin wall's far side) is gathered and looked up again in the same way. What is worked out is that of kernels.cost_terms,
but for the order of sums and the last digits of the exponential.
"""

from __future__ import annotations

import numba
import numpy as np

from scenes._numba import LENT
from scenes.evidence.row_kernels import (
    FLOOR_ABOVE,
    FLOOR_BELOW,
    INVERSE,
    NARROW,
    NOTHING,
    decay,
    log_above_one,
)
from scenes.evidence.table import FACING, GATE_ABOVE, GATE_BELOW, OFFSET, WEIGHT
from scenes.geometry.lattice import END, STEPS, trilinear

# Rows of a block, and of what a processor does at once (the last ones of a block are filled up to a multiple of it).
LENGTH, LANES = 64, 8
# Where the columns of a block begin: point, ray or normal, 1 / sigma, weight, squares of the gates and the loss's
# constants on either side, offset, facing.
PX, PY, PZ, NX, NY, NZ, INVERSES, WEIGHTS, ABOVE, BELOW, CONSTANT_ABOVE, CONSTANT_BELOW, OFFSETS, FACES = (
    k * LENGTH for k in range(14)
)
BLOCK = 14 * LENGTH
# Where the columns of the working room begin: point before the middle; point in the lattice's frame; what it is beyond
# the box, in cells, and its place in the cell; eight nodes; distance and gradient; viewing direction in the object's
# frame and the gradient along it; residual in sigmas, and what the row weighs.
(
    YX,
    YY,
    YZ,
    QX,
    QY,
    QZ,
    OU,
    OV,
    OW,
    CA,
    CB,
    CC,
    N0,
    N1,
    N2,
    N3,
    N4,
    N5,
    N6,
    N7,
    D,
    GX,
    GY,
    GZ,
    VX,
    VY,
    VZ,
    ALONG,
    R,
    W,
) = (k * LENGTH for k in range(30))
ROOM = 30 * LENGTH
# A pose's sums: six of the gradient, then the lower triangle of the matrix, row by row.
SUMS = 27
# Sums may be taken in any order, and products fused with them: all numbers are finite.
QUICK = {"contract", "reassoc", "nsz", "nnan", "ninf"}


@numba.njit(cache=True, nogil=True, **LENT)
def lay_blocks(prepared, silent, blocks):
    """Lay prepared rows without a normal (see row_kernels.prepare) into blocks (k, BLOCK): those that say nothing where
    they are outside (silent), or the others; returns how many.
    """
    count = 0
    for n in range(prepared.shape[0]):
        if prepared[n, NARROW] > 0.0 or is_silent(prepared[n]) != silent:
            continue
        block, i = blocks[count // LENGTH], count % LENGTH
        for axis in range(3):
            block[PX + axis * LENGTH + i] = prepared[n, axis]
            block[NX + axis * LENGTH + i] = prepared[n, 3 + axis]
        block[INVERSES + i] = prepared[n, INVERSE]
        block[WEIGHTS + i] = prepared[n, WEIGHT]
        block[ABOVE + i] = prepared[n, GATE_ABOVE] * prepared[n, GATE_ABOVE]
        block[BELOW + i] = prepared[n, GATE_BELOW] * prepared[n, GATE_BELOW]
        block[CONSTANT_ABOVE + i] = prepared[n, FLOOR_ABOVE]
        block[CONSTANT_BELOW + i] = prepared[n, FLOOR_BELOW]
        block[OFFSETS + i] = prepared[n, OFFSET]
        block[FACES + i] = prepared[n, FACING]
        count += 1
    fill_up(blocks, count)
    return count


@numba.njit(cache=True, nogil=True, inline="always")
def is_silent(row):
    """Whether a prepared row says nothing where it is outside: with a side that it must be seen from, a point may be
    inside from far away.
    """
    return row[GATE_ABOVE] == 0.0 and row[FACING] == 0.0


@numba.njit(cache=True, nogil=True)
def blocks_of(count):
    """Zeros (k, BLOCK) with room for so many rows."""
    return np.zeros(((count + LENGTH - 1) // LENGTH, BLOCK))


@numba.njit(cache=True, nogil=True, **LENT)
def fill_up(blocks, count):
    """Fill the last block behind its rows with copies of the last row that weigh nothing, up to whole lanes."""
    if count % LANES == 0:
        return
    block, last = blocks[count // LENGTH], (count - 1) % LENGTH
    for i in range(last + 1, (last // LANES + 1) * LANES):
        for column in range(0, BLOCK, LENGTH):
            block[column + i] = block[column + last]
        block[WEIGHTS + i] = 0.0


@numba.njit(cache=True, nogil=True, inline="always")
def rows_in(count, block):
    """Rows of a block to work on when so many are laid in all: a multiple of the lanes."""
    return min((count - block * LENGTH + LANES - 1) // LANES * LANES, LENGTH)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **LENT)
def place(block, count, room, rotation, middle, centroid):
    """Fill in the room where the points of a block are before the middle, and in the object's frame."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    mx, my, mz = middle[0], middle[1], middle[2]
    cx, cy, cz = centroid[0], centroid[1], centroid[2]
    for i in range(count):
        x, y, z = block[PX + i] - mx, block[PY + i] - my, block[PZ + i] - mz
        room[YX + i], room[YY + i], room[YZ + i] = x, y, z
        room[QX + i] = r00 * x + r10 * y + r20 * z + cx
        room[QY + i] = r01 * x + r11 * y + r21 * z + cy
        room[QZ + i] = r02 * x + r12 * y + r22 * z + cz


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **LENT)
def find_cells(count, room, nodes, origin, spacing, shape):
    """Fill in the room the places of points in the lattice's cells, and nodes (LENGTH,) with each cell's first node."""
    inverse = 1.0 / spacing
    ox, oy, oz = origin[0], origin[1], origin[2]
    ends = shape[0] - 1 - END, shape[1] - 1 - END, shape[2] - 1 - END
    row, sheet = np.int32(shape[2]), np.int32(shape[1] * shape[2])
    for i in range(count):
        u, v, w = (room[QX + i] - ox) * inverse, (room[QY + i] - oy) * inverse, (room[QZ + i] - oz) * inverse
        cu, cv, cw = min(max(u, 0.0), ends[0]), min(max(v, 0.0), ends[1]), min(max(w, 0.0), ends[2])
        iu, iv, iw = np.int32(cu), np.int32(cv), np.int32(cw)
        room[OU + i], room[OV + i], room[OW + i] = u - cu, v - cv, w - cw
        room[CA + i], room[CB + i], room[CC + i] = cu - iu, cv - iv, cw - iw
        nodes[i] = iu * sheet + iv * row + iw


@numba.njit(cache=True, nogil=True, **LENT)
def fetch(count, room, nodes, values, shape):
    """Fill in the room the eight nodes of every cell. values: the lattice's, flat."""
    one, row = np.uint64(1), np.uint64(shape[2])
    sheet = np.uint64(shape[1]) * row
    for i in range(count):
        k = np.uint64(nodes[i])
        room[N0 + i], room[N1 + i] = values[k], values[k + one]
        room[N2 + i], room[N3 + i] = values[k + row], values[k + row + one]
        k += sheet
        room[N4 + i], room[N5 + i] = values[k], values[k + one]
        room[N6 + i], room[N7 + i] = values[k + row], values[k + row + one]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **LENT)
def interpolate(count, room, spacing):
    """Fill in the room distance and gradient, as lattice.distance_at."""
    inverse = 1.0 / spacing
    for i in range(count):
        a, b, c = room[CA + i], room[CB + i], room[CC + i]
        d000, d001, d010, d011 = room[N0 + i], room[N1 + i], room[N2 + i], room[N3 + i]
        d100, d101, d110, d111 = room[N4 + i], room[N5 + i], room[N6 + i], room[N7 + i]
        d, gx, gy, gz = trilinear(d000, d001, d010, d011, d100, d101, d110, d111, a, b, c, inverse)
        ou, ov, ow = room[OU + i], room[OV + i], room[OW + i]
        beyond = ou * ou + ov * ov + ow * ow
        outside = beyond > 4.0 * END * END
        length = np.sqrt(beyond if outside else 1.0)
        # the clamped coordinates no longer move the interpolated part
        room[D + i] = d + (length * spacing if outside else 0.0)
        room[GX + i] = (0.0 if outside and ou != 0.0 else gx) + (ou / length if outside else 0.0)
        room[GY + i] = (0.0 if outside and ov != 0.0 else gy) + (ov / length if outside else 0.0)
        room[GZ + i] = (0.0 if outside and ow != 0.0 else gz) + (ow / length if outside else 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **LENT)
def view(block, count, room, rotation):
    """Fill in the room viewing directions in the object's frame, and the gradient along them where a row has a side."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for i in range(count):
        x, y, z = block[NX + i], block[NY + i], block[NZ + i]
        vx = r00 * x + r10 * y + r20 * z
        vy = r01 * x + r11 * y + r21 * z
        vz = r02 * x + r12 * y + r22 * z
        room[VX + i], room[VY + i], room[VZ + i] = vx, vy, vz
        room[ALONG + i] = block[FACES + i] * (room[GX + i] * vx + room[GY + i] * vy + room[GZ + i] * vz)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **LENT)
def step_back(count, there, other, step):
    """Fill in the other room the points of a list, led back by a step (m) along their rays."""
    for i in range(count):
        other[QX + i] = other[YX + i] - step * other[VX + i]
        other[QY + i] = other[YY + i] - step * other[VY + i]
        other[QZ + i] = other[YZ + i] - step * other[VZ + i]
    # whole lanes are looked up: what is behind the list is where the last one is
    for i in range(count, there):
        other[QX + i], other[QY + i], other[QZ + i] = (
            other[QX + count - 1],
            other[QY + count - 1],
            other[QZ + count - 1],
        )


@numba.njit(cache=True, nogil=True, **LENT)
def look_up(count, room, nodes, flat, lattice):
    """Fill in the room distance and gradient at its points in the lattice's frame. nodes (LENGTH,): working room; flat:
    the lattice's values in one row; lattice: as of kernels.cost_terms.
    """
    values, origin, spacing, _, _ = lattice
    find_cells(count, room, nodes, origin, spacing, values.shape)
    fetch(count, room, nodes, flat, values.shape)
    interpolate(count, room, spacing)


@numba.njit(cache=True, nogil=True, **LENT)
def lead_back(count, room, other, nodes, places, flat, lattice):
    """Rows of the room whose nearest surface looks away from where they were seen, as lattice.led_back_at has them.
    other: a second room; nodes, places (LENGTH,): working room.
    """
    step, listed = lattice[3], 0
    for i in range(count):
        if room[ALONG + i] > 0.0:
            places[listed] = i
            other[YX + listed], other[YY + listed], other[YZ + listed] = room[QX + i], room[QY + i], room[QZ + i]
            other[VX + listed], other[VY + listed], other[VZ + listed] = room[VX + i], room[VY + i], room[VZ + i]
            listed += 1
    for _ in range(STEPS):
        if listed == 0:
            return
        whole = rows_in(listed, 0)
        step_back(listed, whole, other, step)
        look_up(whole, other, nodes, flat, lattice)
        left = 0
        for k in range(listed):
            vx, vy, vz = other[VX + k], other[VY + k], other[VZ + k]
            gx, gy, gz = other[GX + k], other[GY + k], other[GZ + k]
            along = gx * vx + gy * vy + gz * vz
            i = places[k]
            if along < 0.0:
                room[D + i] = other[D + k] + step * along
                room[GX + i], room[GY + i], room[GZ + i] = gx, gy, gz
                continue
            places[left] = i
            other[YX + left], other[YY + left], other[YZ + left] = other[YX + k], other[YY + k], other[YZ + k]
            other[VX + left], other[VY + left], other[VZ + left] = vx, vy, vz
            left += 1
        listed = left
        step *= 2.0
    for k in range(listed):
        i = places[k]
        room[D + i] = -0.5 * step
        room[GX + i], room[GY + i], room[GZ + i] = -other[VX + k], -other[VY + k], -other[VZ + k]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, **LENT)
def weigh(block, count, room):
    """What the rows of a block cost; fills in the room residuals in sigmas, and what each row weighs: see
    row_kernels.robust, by the rows' gates.
    """
    total = 0.0
    for i in range(count):
        d = room[D + i] - block[OFFSETS + i]
        above = d > 0.0
        gate = block[ABOVE + i] if above else block[BELOW + i]
        constant = block[CONSTANT_ABOVE + i] if above else block[CONSTANT_BELOW + i]
        r = d * block[INVERSES + i]
        s = r * r
        over = 0.5 * (s - gate)
        e = decay(min(abs(over), NOTHING))
        loss = s - 2.0 * max(over, 0.0) - 2.0 * log_above_one(e) + constant
        w = block[WEIGHTS + i] if gate > 0.0 else 0.0
        total += 0.5 * w * loss
        room[R + i] = r
        room[W + i] = w * (e if over > 0.0 else 1.0) / (1.0 + e)
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, **LENT)
def weigh_limited(block, count, room, huber):
    """The same, where residuals beyond `huber` sigmas count linearly instead."""
    total = 0.0
    for i in range(count):
        d = room[D + i] - block[OFFSETS + i]
        gate = block[ABOVE + i] if d > 0.0 else block[BELOW + i]
        r = d * block[INVERSES + i]
        size = abs(r)
        beyond = size > huber
        w = block[WEIGHTS + i] if gate > 0.0 else 0.0
        total += 0.5 * w * (2.0 * huber * size - huber * huber if beyond else r * r)
        room[R + i] = r
        room[W + i] = w * (huber / max(size, huber))
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=QUICK, **LENT)
def add_terms(block, count, room, rotation, sums):
    """Add gradient and Gauss-Newton matrix of the weighed rows of a block to sums (SUMS,)."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    h00 = h10 = h11 = h20 = h21 = h22 = h30 = h31 = h32 = h33 = 0.0
    h40 = h41 = h42 = h43 = h44 = h50 = h51 = h52 = h53 = h54 = h55 = 0.0
    for i in range(count):
        inverse, r, w = block[INVERSES + i], room[R + i], room[W + i]
        gx, gy, gz = room[GX + i] * inverse, room[GY + i] * inverse, room[GZ + i] * inverse
        vx = r00 * gx + r01 * gy + r02 * gz
        vy = r10 * gx + r11 * gy + r12 * gz
        vz = r20 * gx + r21 * gy + r22 * gz
        yx, yy, yz = room[YX + i], room[YY + i], room[YZ + i]
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
    found = (
        *(g0, g1, g2, g3, g4, g5, h00, h10, h11, h20, h21, h22, h30, h31),
        *(h32, h33, h40, h41, h42, h43, h44, h50, h51, h52, h53, h54, h55),
    )
    for k, value in enumerate(found):
        sums[k] += value


@numba.njit(cache=True, nogil=True, **LENT)
def block_terms(lattice, blocks, count, huber, rotation, middle, need, rooms, nodes, sums):
    """Cost of so many rows in blocks at a pose; their gradient and matrix added to sums (SUMS,) when `need`.

    lattice, huber: as of kernels.cost_terms. rooms (2, ROOM), nodes (2, LENGTH): working room.
    """
    flat, room, total = lattice[0].reshape(-1), rooms[0], 0.0
    for b in range((count + LENGTH - 1) // LENGTH):
        block, whole = blocks[b], rows_in(count, b)
        place(block, whole, room, rotation, middle, lattice[4])
        look_up(whole, room, nodes[0], flat, lattice)
        view(block, whole, room, rotation)
        lead_back(whole, room, rooms[1], nodes[0], nodes[1], flat, lattice)
        total += weigh_limited(block, whole, room, huber) if huber > 0.0 else weigh(block, whole, room)
        if need:
            add_terms(block, whole, room, rotation, sums)
    return total


@numba.njit(cache=True, nogil=True, **LENT)
def near_blocks(lattice, silent, count, rotation, middle, reach, rooms, nodes, near):
    """Lay into blocks `near` those of so many silent rows in blocks that a pose, or one near it, may have within the
    surface or nearer to it than reach (m); returns how many, and how far (m) the farthest row left out is from the
    pose's middle.
    """
    flat, room = lattice[0].reshape(-1), rooms[0]
    k = 0
    lever = 0.0
    for b in range((count + LENGTH - 1) // LENGTH):
        block, whole = silent[b], rows_in(count, b)
        place(block, whole, room, rotation, middle, lattice[4])
        look_up(whole, room, nodes[0], flat, lattice)
        for i in range(min(count - b * LENGTH, LENGTH)):
            if room[D + i] > reach + block[OFFSETS + i]:
                x, y, z = room[YX + i], room[YY + i], room[YZ + i]
                lever = max(lever, x * x + y * y + z * z)
                continue
            to, j = near[k // LENGTH], k % LENGTH
            for column in range(0, BLOCK, LENGTH):
                to[column + j] = block[column + i]
            k += 1
    fill_up(near, k)
    return k, np.sqrt(lever)


@numba.njit(cache=True, nogil=True, **LENT)
def add_sums(sums, hessian, gradient):
    """Add a pose's sums to gradient (6,) and both halves of hessian (6, 6)."""
    k = 6
    for i in range(6):
        gradient[i] += sums[i]
        for j in range(i + 1):
            hessian[i, j] += sums[k]
            hessian[j, i] = hessian[i, j]
            k += 1
