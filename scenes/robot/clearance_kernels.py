"""Compiled: which few of a hand's samples may be nearest to an object, and points held against convex pieces.

The least of many distances needs few of them: bounds by blocks of the lattice's nodes leave out the others. What stays
has the bits that NumPy gives for products of whole arrays of two rows or more (see scenes._numba.fused). Metres.
"""

from __future__ import annotations

import numba
import numpy as np

from scenes._numba import LENT, fused
from scenes.geometry.lattice import bounds_at

# What rounding may make of a distance (m), at most: bounds give way by so much.
SLACK = 1e-9


@numba.njit(cache=True, nogil=True, **LENT)
def _moved(frame, points, n, out, m):  # type: ignore[no-untyped-def]
    """out[m] = points[n] moved by frame (4, 4)."""
    for i in range(3):
        sum_of = fused(points[n, 2], frame[i, 2], fused(points[n, 1], frame[i, 1], points[n, 0] * frame[i, 0]))
        out[m, i] = sum_of + frame[i, 3]


@numba.njit(cache=True, nogil=True, **LENT)
def may_be_least(frames, wanted, rows, points, starts, field, together, lower, out, group):  # type: ignore[no-untyped-def]
    """Points that may be the nearest of their link, or of all links together: how many, their places out (n, 3) and
    group (n,): the number of the frame together, else that times the number of links plus that of the link.

    frames (k, l, 4, 4): field from link; rows (b,) of l whose points (p, 3) are those from starts (b + 1,) on, of which
    those wanted (k, b) are asked for; field: as of DistanceField.blocks; lower (p,): room.
    """
    low, high, last, origin, spacing = field
    count = 0
    for k in range(frames.shape[0]):
        begin, most, total = count, np.inf, 0
        for b in range(len(rows)):
            if not wanted[k, b]:
                continue
            frame = frames[k, rows[b]]
            if not together:
                begin, most, total = count, np.inf, 0
            for n in range(starts[b], starts[b + 1]):
                at = begin + total
                _moved(frame, points, n, out, at)
                lower[total], upper = bounds_at(low, high, last, origin, spacing, out[at, 0], out[at, 1], out[at, 2])
                most = min(most, upper)
                total += 1
            if not together:
                count = _kept(lower, total, most + SLACK, out, begin, count, group, k * len(rows) + b)
        if together:
            count = _kept(lower, total, most + SLACK, out, begin, count, group, k)
    return count


@numba.njit(cache=True, nogil=True, **LENT)
def _kept(lower, total, most, out, begin, count, group, number):  # type: ignore[no-untyped-def]
    """Of `total` places of out from `begin` on, those with a lower bound up to `most`, put to `count` and after."""
    for n in range(total):
        if lower[n] <= most:
            at = begin + n
            out[count, 0], out[count, 1], out[count, 2] = out[at, 0], out[at, 1], out[at, 2]
            group[count] = number
            count += 1
    return count


@numba.njit(cache=True, nogil=True, **LENT)
def least_of_groups(distance, group, out):  # type: ignore[no-untyped-def]
    """Fill out (g,) with the least distance (n,) of each group (n,)."""
    for n in range(len(distance)):
        out[group[n]] = min(out[group[n]], distance[n])


@numba.njit(cache=True, nogil=True, **LENT)
def may_be_near(frames, rows, points, starts, field, within, lower, out, group):  # type: ignore[no-untyped-def]
    """Points of these rows together that may be nearer than `within` (m), or the nearest of all: how many, and their
    places out (n, 3), in order. Arguments as of `may_be_least`, frames (l, 4, 4), points those of all l links.
    """
    low, high, last, origin, spacing = field
    most, total = np.inf, 0
    for row in rows:
        for n in range(starts[row], starts[row + 1]):
            _moved(frames[row], points, n, out, total)
            place = out[total]
            lower[total], upper = bounds_at(low, high, last, origin, spacing, place[0], place[1], place[2])
            most = min(most, upper)
            total += 1
    return _kept(lower, total, max(most, within) + SLACK, out, 0, 0, group, 0)


@numba.njit(cache=True, nogil=True, **LENT)
def _in_piece(local, normals, offsets, begin, end, smallest):  # type: ignore[no-untyped-def]
    """The largest of a point's distances from a piece's planes; what it is does not matter from `smallest` on."""
    largest = -np.inf
    for m in range(begin, end):
        along = fused(local[2], normals[m, 2], fused(local[1], normals[m, 1], local[0] * normals[m, 0]))
        largest = max(largest, along - offsets[m])
        if largest >= smallest:
            break
    return largest


@numba.njit(cache=True, nogil=True, **LENT)
def least_to_pieces(points, frames, rows, pieces, smallest, local, seen, first):  # type: ignore[no-untyped-def]
    """The least of `smallest` and the distances of points (n, 3) from convex pieces of these rows' links, of each piece
    those in its box; and whether a piece has one point in its box, which is left to the caller.

    frames (l, 4, 4): target from link, of the points' target. pieces: normals (p, 3), offsets (p,), boxes low and high
    (k, 3), where their planes begin (k + 1,), where links' pieces do (l + 1,), and balls (l, 4) about a link's boxes,
    middle and radius. seen (k,): how many points are in a box of those rows, first (k, 3): the place of the first, in
    the link; local (3,): room.
    """
    normals, offsets, low, high, starts, links, balls = pieces
    alone = False
    for row in rows:
        begin, end = links[row], links[row + 1]
        if begin == end:
            continue
        frame, ball = frames[row], balls[row]
        middle_x = frame[0, 0] * ball[0] + frame[0, 1] * ball[1] + frame[0, 2] * ball[2] + frame[0, 3]
        middle_y = frame[1, 0] * ball[0] + frame[1, 1] * ball[1] + frame[1, 2] * ball[2] + frame[1, 3]
        middle_z = frame[2, 0] * ball[0] + frame[2, 1] * ball[1] + frame[2, 2] * ball[2] + frame[2, 3]
        farthest = ball[3] * ball[3]
        for k in range(begin, end):
            seen[k] = 0
        for n in range(len(points)):
            x, y, z = points[n, 0] - middle_x, points[n, 1] - middle_y, points[n, 2] - middle_z
            if x * x + y * y + z * z > farthest:
                continue
            x, y, z = points[n, 0] - frame[0, 3], points[n, 1] - frame[1, 3], points[n, 2] - frame[2, 3]
            for i in range(3):
                local[i] = fused(z, frame[2, i], fused(y, frame[1, i], x * frame[0, i]))
            for k in range(begin, end):
                if not (
                    low[k, 0] < local[0] < high[k, 0]
                    and low[k, 1] < local[1] < high[k, 1]
                    and low[k, 2] < local[2] < high[k, 2]
                ):
                    continue
                seen[k] += 1
                if seen[k] == 1:
                    first[k, 0], first[k, 1], first[k, 2] = local[0], local[1], local[2]
                    continue
                if seen[k] == 2:
                    smallest = min(smallest, _in_piece(first[k], normals, offsets, starts[k], starts[k + 1], smallest))
                smallest = min(smallest, _in_piece(local, normals, offsets, starts[k], starts[k + 1], smallest))
        for k in range(begin, end):
            alone = alone or seen[k] == 1
    return smallest, alone


@numba.njit(cache=True, nogil=True, **LENT)
def in_box(points, low, high, out):  # type: ignore[no-untyped-def]
    """How many of points (n, 3) are within low and high (3,), and those, in order, in out (n, 3)."""
    count = 0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if low[0] < x < high[0] and low[1] < y < high[1] and low[2] < z < high[2]:
            out[count, 0], out[count, 1], out[count, 2] = x, y, z
            count += 1
    return count


@numba.njit(cache=True, nogil=True, **LENT)
def posed_links(origins, parents, turning, sines, halves, skew, square, local, out):  # type: ignore[no-untyped-def]
    """Fill out (b, l, 4, 4) with the poses of links in the root's frame, parents before children.

    origins (l - 1, 4, 4): parent from joint, at 0; parents (l - 1,); turning (t,): joints that turn, by angles of these
    sines (b, t), and sines of half the angles, about axes of these skew matrices (t, 3, 3) and their squares. local
    (l - 1, 4, 4): a copy of origins, to work on.
    """
    for b in range(out.shape[0]):
        for t in range(len(turning)):
            joint, share = turning[t], (2.0 * halves[b, t]) * halves[b, t]
            for k in range(3):
                x = (1.0 if k == 0 else 0.0) + sines[b, t] * skew[t, 0, k] + share * square[t, 0, k]
                y = (1.0 if k == 1 else 0.0) + sines[b, t] * skew[t, 1, k] + share * square[t, 1, k]
                z = (1.0 if k == 2 else 0.0) + sines[b, t] * skew[t, 2, k] + share * square[t, 2, k]
                for i in range(3):
                    a = origins[joint, i]
                    local[joint, i, k] = fused(a[2], z, fused(a[1], y, a[0] * x))
        for i in range(4):
            for k in range(4):
                out[b, 0, i, k] = 1.0 if i == k else 0.0
        for joint in range(len(parents)):
            before, own = out[b, parents[joint]], local[joint]
            for i in range(4):
                for k in range(4):
                    a = fused(before[i, 1], own[1, k], before[i, 0] * own[0, k])
                    out[b, joint + 1, i, k] = fused(before[i, 3], own[3, k], fused(before[i, 2], own[2, k], a))
