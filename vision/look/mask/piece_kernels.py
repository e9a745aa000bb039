"""Compiled: which pixels hang together, which are on a plane, and which plane most of them are on."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes.geometry.cameras import FARTHEST_READING


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _root(parent, n):  # type: ignore[no-untyped-def]
    """The first pixel of the piece that n belongs to; the way there is halved."""
    while parent[n] != n:
        parent[n] = parent[parent[n]]
        n = parent[n]
    return n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def number_pieces(z, candidates, step, step_share, parent, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w) with the number, from 0 in row-major order, of each candidate pixel's piece, -1 elsewhere.

    Neighbours in a row or a column hang together where depths z (h, w) differ by less than step (m) + step_share times
    the later one's. parent (h * w,): working room. Union-find: Galler and Fischer, CACM 7, 1964.
    """
    height, width = z.shape
    for i in range(height):
        for j in range(width):
            n = i * width + j
            parent[n] = n
            if not candidates[i, j]:
                continue
            for up in range(2):
                a, b = (i - 1, j) if up == 1 else (i, j - 1)
                if a < 0 or b < 0 or not candidates[a, b]:
                    continue
                if abs(z[i, j] - z[a, b]) < step + step_share * z[i, j]:
                    first, second = _root(parent, n), _root(parent, a * width + b)
                    # the earlier pixel leads, so that pieces are numbered by their first
                    if first < second:
                        parent[second] = first
                    else:
                        parent[first] = second
    count = 0
    for i in range(height):
        for j in range(width):
            if not candidates[i, j]:
                out[i, j] = -1
                continue
            root = _root(parent, i * width + j)
            if root == i * width + j:
                out[i, j] = count
                count += 1
            else:
                out[i, j] = out[root // width, root % width]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sizes_of(numbers):  # type: ignore[no-untyped-def]
    """(k,) how many pixels of numbers (h, w) each piece has, the last of which has some."""
    most = -1
    for i in range(numbers.shape[0]):
        for j in range(numbers.shape[1]):
            most = max(most, numbers[i, j])
    out = np.zeros(most + 1, dtype=np.int64)
    for i in range(numbers.shape[0]):
        for j in range(numbers.shape[1]):
            if numbers[i, j] >= 0:
                out[numbers[i, j]] += 1
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_on_plane(x, y, z, planes, noise, margins):  # type: ignore[no-untyped-def]
    """Whether a point is on one of planes (k, 6); see mark_planes."""
    floor, growth, least_from = noise
    margin, sigmas = margins
    smooth = margin / sigmas
    own = floor + growth * (z - least_from) * (z - least_from)
    for k in range(planes.shape[0]):
        height = x * planes[k, 0] + y * planes[k, 1] + z * planes[k, 2] + planes[k, 3]
        room = max(margin + sigmas * own, sigmas * planes[k, 4] * math.sqrt(own * own + smooth * smooth))
        if -max(room, planes[k, 5]) <= height <= room:
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mark_planes(points, planes, noise, margins, out):  # type: ignore[no-untyped-def]
    """Mark in out (n,) the points (n, 3) that are on one of planes (k, 6); see vision.look.mask.planes.on_planes.

    noise: floor, growth and depth it grows from of a DepthModel's independent sigma. margins: of a plane (m), and
    sigmas.
    """
    for n in range(points.shape[0]):
        out[n] = out[n] or is_on_plane(points[n, 0], points[n, 1], points[n, 2], planes, noise, margins)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def surface_points(depth, lens, step, planes, noise, margins, points, good):  # type: ignore[no-untyped-def]
    """Fill points (h, w, 3) with every `step`-th pixel of a depth image, z 0 for no reading, and good (h, w) with
    whether it has one, off planes (k, 6). lens (fx, fy, cx, cy); noise, margins: see mark_planes.
    """
    fx, fy, cx, cy = lens
    for row in range(good.shape[0]):
        for column in range(good.shape[1]):
            z = float(depth[row * step, column * step])
            # not true of NaN either
            if not 0.0 < z < FARTHEST_READING:
                z = 0.0
            x, y = (column * step - cx) / fx * z, (row * step - cy) / fy * z
            points[row, column, 0], points[row, column, 1], points[row, column, 2] = x, y, z
            good[row, column] = z > 0.0 and not is_on_plane(x, y, z, planes, noise, margins)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def list_cells(numbers, slot, first, cells):  # type: ignore[no-untyped-def]
    """Fill cells (n,) with the indices of the cells of numbers (m,) that are of chosen pieces, in order: those of piece
    p from first[slot[p]] on; none of a piece whose slot is -1, or without a number, -1.
    """
    seen = np.zeros(len(first), dtype=np.int64)
    for n in range(len(numbers)):
        if numbers[n] >= 0 and slot[numbers[n]] >= 0:
            own = slot[numbers[n]]
            cells[first[own] + seen[own]] = n
            seen[own] += 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def count_votes(points, tolerance, normals, offsets, every, votes):  # type: ignore[no-untyped-def]
    """Fill votes (k,): how many of every so manieth of points (n, 3) are within tolerance (n,) of planes with normals
    (k, 3) and offsets (k,).
    """
    for k in range(len(offsets)):
        a, b, c, off, own = normals[k, 0], normals[k, 1], normals[k, 2], offsets[k], 0
        for n in range(0, len(points), every):
            own += abs(points[n, 0] * a + points[n, 1] * b + points[n, 2] * c + off) < tolerance[n]
        votes[k] = own


@numba.njit(cache=True, nogil=True, error_model="numpy")
def runs_on_behind(points, tolerance, normal, offset, cell, far):  # type: ignore[no-untyped-def]
    """How many of points (n, 3), as a share of those within tolerance (n,) of a plane, lie where in the image most are
    beyond tolerance behind it, and no farther than `far` tolerances. cell: points of each part of the image, about.
    """
    count = len(points)
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for n in range(count):
        x, y = points[n, 0] / points[n, 2], points[n, 1] / points[n, 2]
        low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
    wide, high = max(high_x - low_x, 1e-9), max(high_y - low_y, 1e-9)
    step = math.sqrt(wide * high * cell / max(count, 1))
    columns, rows = int(wide / step) + 1, int(high / step) + 1
    on, behind = np.zeros((rows, columns)), np.zeros((rows, columns))
    whole = 0.0
    for n in range(count):
        x, y = points[n, 0] / points[n, 2], points[n, 1] / points[n, 2]
        i, j = min(int((y - low_y) / step), rows - 1), min(int((x - low_x) / step), columns - 1)
        height = points[n, 0] * normal[0] + points[n, 1] * normal[1] + points[n, 2] * normal[2] + offset
        if abs(height) < tolerance[n]:
            on[i, j] += 1.0
            whole += 1.0
        elif height < 0.0 and height > -far * tolerance[n]:
            behind[i, j] += 1.0
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            if behind[i, j] > on[i, j]:
                total += behind[i, j]
    return total / max(whole, 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def are_near(first, second, distance):  # type: ignore[no-untyped-def]
    """Whether any of points (n, 3) is nearer than `distance` to any of others (m, 3)."""
    for n in range(len(first)):
        for m in range(len(second)):
            x, y, z = first[n, 0] - second[m, 0], first[n, 1] - second[m, 1], first[n, 2] - second[m, 2]
            if x * x + y * y + z * z < distance * distance:
                return True
    return False
