"""Compiled: a tree of boxes around a mesh's triangles, and what is asked of it. All in one frame, metres.

Bounding volume hierarchy with its nodes in depth-first order: the first child of node i is i + 1, the second right[i];
count[i] triangles from start[i] on are in it when it is a leaf. Which triangles are together is planned once, where the
boxes are is told anew at every pose. Closest point on a triangle: Ericson, Real-Time Collision Detection, 2005, 5.1.5.
"""

from __future__ import annotations

import math

import numba
import numpy as np

# Nodes that wait at most: halves of halves of 2^60 triangles.
DEEPEST = 64
# What is beside a triangle by less than this (pixels) may be so by rounding, and is taken to be on its edge.
SLACK = 1e-7
# A length squared below this has no direction (m^2).
_TINY = 1e-300


@numba.njit(cache=True, nogil=True)
def _sort_run(order, low, high, keys, turned, places):  # type: ignore[no-untyped-def]
    """Stable merge sort of order[low:high] by keys (m,), which go with it, both in place; turned, places (m,): room.

    NumPy's argsort and the slices that it needs take numba ten times as long to compile.
    """
    length = 1
    while length < high - low:
        for left in range(low, high, 2 * length):
            middle, end = min(left + length, high), min(left + 2 * length, high)
            i, j = left, middle
            for k in range(left, end):
                if i < middle and (j >= end or keys[i] <= keys[j]):
                    turned[k], places[k] = keys[i], order[i]
                    i += 1
                else:
                    turned[k], places[k] = keys[j], order[j]
                    j += 1
        for k in range(low, high):
            keys[k], order[k] = turned[k], places[k]
        length *= 2


@numba.njit(cache=True, nogil=True)
def _longest(order, low, high, of, centres):  # type: ignore[no-untyped-def]
    """The axis along which centres (m, 3) of order[low:high] are farthest apart; of (m,): whose centre each has."""
    longest, along = -1.0, 0
    for d in range(3):
        least = most = centres[of[order[low]], d]
        for k in range(low + 1, high):
            value = centres[of[order[k]], d]
            least, most = min(least, value), max(most, value)
        if most - least > longest:
            longest, along = most - least, d
    return along


@numba.njit(cache=True, nogil=True)
def _parted(order, low, high, group):  # type: ignore[no-untyped-def]
    """The place nearest to the middle of low and high at which a run of a group ends."""
    middle = (low + high) // 2
    for away in range(high - low):
        after, before = middle + away, middle - away
        if low < after < high and group[order[after - 1]] != group[order[after]]:
            return after
        if low < before < high and group[order[before - 1]] != group[order[before]]:
            return before
    return middle


@numba.njit(cache=True, nogil=True)
def plan(centres, group, group_centres, leaf, order, right, start, count):  # type: ignore[no-untyped-def]
    """Sort order (m,) of triangles with centres (m, 3), in groups (m,) with centres (g, 3) each of which is one run of
    them, into leaves of at most `leaf`, groups parted first. Fills right, start, count (2 m,); returns how many nodes.
    """
    waiting = np.zeros((DEEPEST, 3), dtype=np.int64)
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, len(order), -1
    keys, turned, places = np.zeros(len(order)), np.zeros(len(order)), np.zeros(len(order), dtype=np.int64)
    own = np.arange(len(order))
    depth, nodes = 1, 0
    while depth:
        depth -= 1
        low, high, parent = waiting[depth, 0], waiting[depth, 1], waiting[depth, 2]
        node = nodes
        nodes += 1
        if parent >= 0:
            right[parent] = node
        start[node], count[node] = low, 0
        several = group[order[low]] != group[order[high - 1]]
        if high - low <= leaf and not several:
            count[node] = high - low
            continue
        of = group if several else own
        middles = group_centres if several else centres
        along = _longest(order, low, high, of, middles)
        for k in range(low, high):
            keys[k] = middles[of[order[k]], along]
        # stable, so that groups beside each other stay one run each
        _sort_run(order, low, high, keys, turned, places)
        middle = _parted(order, low, high, group) if several else (low + high) // 2
        waiting[depth, 0], waiting[depth, 1], waiting[depth, 2] = middle, high, node
        waiting[depth + 1, 0], waiting[depth + 1, 1], waiting[depth + 1, 2] = low, middle, -1
        depth += 2
    return nodes


@numba.njit(cache=True, nogil=True)
def lay(vertices, faces, right, start, count, corners, normals, boxes):  # type: ignore[no-untyped-def]
    """Fill corners (m, 3, 3) and unit normals (m, 3) of faces (m, 3), in the tree's order, of vertices (n, 3), and
    boxes (k, 6) of the nodes: lowest corner, highest corner.
    """
    for k in range(len(faces)):
        for i in range(3):
            for d in range(3):
                corners[k, i, d] = vertices[faces[k, i], d]
        a, b, c = corners[k]
        ax, ay, az, bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = max(math.sqrt(x * x + y * y + z * z), _TINY)
        normals[k, 0], normals[k, 1], normals[k, 2] = x / length, y / length, z / length
    for node in range(len(boxes) - 1, -1, -1):
        for d in range(3):
            if count[node]:
                low = high = corners[start[node], 0, d]
                for k in range(start[node], start[node] + count[node]):
                    for i in range(3):
                        low, high = min(low, corners[k, i, d]), max(high, corners[k, i, d])
            else:
                low = min(boxes[node + 1, d], boxes[right[node], d])
                high = max(boxes[node + 1, 3 + d], boxes[right[node], 3 + d])
            boxes[node, d], boxes[node, 3 + d] = low, high


@numba.njit(cache=True, nogil=True, inline="always")
def _beside(box, x, y, z):  # type: ignore[no-untyped-def]
    """Square of a point's distance from a box (6,)."""
    a = max(box[0] - x, x - box[3], 0.0)
    b = max(box[1] - y, y - box[4], 0.0)
    c = max(box[2] - z, z - box[5], 0.0)
    return a * a + b * b + c * c


@numba.njit(cache=True, nogil=True)
def _foot(corner, x, y, z):  # type: ignore[no-untyped-def]
    """The closest point of a triangle with corners (3, 3), by the region of its plane that a point's foot is in."""
    ax, ay, az = corner[0, 0], corner[0, 1], corner[0, 2]
    ux, uy, uz = corner[1, 0] - ax, corner[1, 1] - ay, corner[1, 2] - az
    wx, wy, wz = corner[2, 0] - ax, corner[2, 1] - ay, corner[2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    d1, d2 = ux * px + uy * py + uz * pz, wx * px + wy * py + wz * pz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az
    uu, uw, ww = ux * ux + uy * uy + uz * uz, ux * wx + uy * wy + uz * wz, wx * wx + wy * wy + wz * wz
    d3, d4 = d1 - uu, d2 - uw
    if d3 >= 0.0 and d4 <= d3:
        return corner[1, 0], corner[1, 1], corner[1, 2]
    d5, d6 = d1 - uw, d2 - ww
    if d6 >= 0.0 and d5 <= d6:
        return corner[2, 0], corner[2, 1], corner[2, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / max(d1 - d3, _TINY)
        return ax + v * ux, ay + v * uy, az + v * uz
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / max(d2 - d6, _TINY)
        return ax + w * wx, ay + w * wy, az + w * wz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / max(d4 - d3 + d5 - d6, _TINY)
        return (
            corner[1, 0] + w * (corner[2, 0] - corner[1, 0]),
            corner[1, 1] + w * (corner[2, 1] - corner[1, 1]),
            corner[1, 2] + w * (corner[2, 2] - corner[1, 2]),
        )
    whole = max(va + vb + vc, _TINY)
    v, w = vb / whole, vc / whole
    return ax + v * ux + w * wx, ay + v * uy + w * wy, az + v * uz + w * wz


@numba.njit(cache=True, nogil=True)
def nearest(points, within, tree, corners, normals, boxes, face, foot):  # type: ignore[no-untyped-def]
    """Fill face (n,) with the triangle nearest to each of points (n, 3) and foot (n, 3) with its point there; -1 where
    none is nearer than `within` (m). tree: right, start, count of its nodes; normals (m, 3) of the triangles.
    """
    right, start, count = tree
    waiting, away = np.zeros(DEEPEST, dtype=np.int64), np.zeros(DEEPEST)
    before = -1
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        best, which = within * within, -1
        if before >= 0:
            # beside the point before, most often on the same triangle: little else has to be looked at
            a, b, c = _foot(corners[before], x, y, z)
            square = (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2
            if square < best:
                best, which = square, before
                foot[n, 0], foot[n, 1], foot[n, 2] = a, b, c
        waiting[0], away[0] = 0, _beside(boxes[0], x, y, z)
        depth = 1
        while depth:
            depth -= 1
            if away[depth] >= best:
                continue
            node = waiting[depth]
            if count[node]:
                for k in range(start[node], start[node] + count[node]):
                    # no triangle is nearer than its plane
                    a, b, c = x - corners[k, 0, 0], y - corners[k, 0, 1], z - corners[k, 0, 2]
                    above = a * normals[k, 0] + b * normals[k, 1] + c * normals[k, 2]
                    if above * above >= best:
                        continue
                    a, b, c = _foot(corners[k], x, y, z)
                    square = (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2
                    if square < best:
                        best, which = square, k
                        foot[n, 0], foot[n, 1], foot[n, 2] = a, b, c
                continue
            first, second = node + 1, right[node]
            one, other = _beside(boxes[first], x, y, z), _beside(boxes[second], x, y, z)
            if one < other:
                first, second, one, other = second, first, other, one
            # the nearer one on top
            if one < best:
                waiting[depth], away[depth] = first, one
                depth += 1
            if other < best:
                waiting[depth], away[depth] = second, other
                depth += 1
        face[n] = which
        before = which if which >= 0 else before


@numba.njit(cache=True, nogil=True)
def any_within(points, within, tree, corners, boxes, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with whether any triangle is nearer than `within` (m) to each of points (n, 3); see `nearest`."""
    right, start, count = tree
    waiting = np.zeros(DEEPEST, dtype=np.int64)
    limit, before = within * within, -1
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        found = False
        if before >= 0:
            a, b, c = _foot(corners[before], x, y, z)
            found = (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 < limit
        waiting[0], depth = 0, 0 if found else 1
        while depth:
            depth -= 1
            node = waiting[depth]
            if _beside(boxes[node], x, y, z) >= limit:
                continue
            if count[node] == 0:
                waiting[depth], waiting[depth + 1] = right[node], node + 1
                depth += 2
                continue
            for k in range(start[node], start[node] + count[node]):
                a, b, c = _foot(corners[k], x, y, z)
                if (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 < limit:
                    found, before, depth = True, k, 0
                    break
        out[n] = found


@numba.njit(cache=True, nogil=True)
def least(points, tree, corners, boxes):  # type: ignore[no-untyped-def]
    """Least distance (m) of any of points (n, 3) from any triangle, inf of none; see `nearest`."""
    right, start, count = tree
    waiting, away = np.zeros(DEEPEST, dtype=np.int64), np.zeros(DEEPEST)
    best = np.inf
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        waiting[0], away[0], depth = 0, _beside(boxes[0], x, y, z), 1
        while depth:
            depth -= 1
            if away[depth] >= best:
                continue
            node = waiting[depth]
            for k in range(start[node], start[node] + count[node]):
                a, b, c = _foot(corners[k], x, y, z)
                best = min(best, (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2)
            if count[node]:
                continue
            first, second = node + 1, right[node]
            one, other = _beside(boxes[first], x, y, z), _beside(boxes[second], x, y, z)
            if one < other:
                first, second, one, other = second, first, other, one
            waiting[depth], away[depth], waiting[depth + 1], away[depth + 1] = first, one, second, other
            depth += 2
    return math.sqrt(best)


@numba.njit(cache=True, nogil=True)
def inside(points, rays, tree, corners, boxes, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with whether two of three rays (3, 3) from points (n, 3), turned about to lead away from the middle
    of all triangles, cross an odd number of them; no component of a ray is 0.
    """
    right, start, count = tree
    waiting = np.zeros(DEEPEST, dtype=np.int64)
    ray, inverse, odd = np.zeros(3), np.zeros(3), np.zeros(3, dtype=np.int64)
    for n in range(len(points)):
        for r in range(3):
            if r == 2 and odd[0] == odd[1]:
                odd[2] = odd[0]
                break
            away = 0.0
            for d in range(3):
                away += rays[r, d] * (points[n, d] - 0.5 * (boxes[0, d] + boxes[0, 3 + d]))
            for d in range(3):
                ray[d] = -rays[r, d] if away < 0.0 else rays[r, d]
                inverse[d] = 1.0 / ray[d]
            crossings, depth = 0, 1
            waiting[0] = 0
            while depth:
                depth -= 1
                node = waiting[depth]
                first, last = 0.0, np.inf
                for d in range(3):
                    one = (boxes[node, d] - points[n, d]) * inverse[d]
                    other = (boxes[node, 3 + d] - points[n, d]) * inverse[d]
                    first, last = max(first, min(one, other)), min(last, max(one, other))
                if first > last:
                    continue
                if count[node] == 0:
                    waiting[depth], waiting[depth + 1] = right[node], node + 1
                    depth += 2
                    continue
                for k in range(start[node], start[node] + count[node]):
                    crossings += _crosses(corners[k], points[n], ray)
            odd[r] = crossings % 2
        out[n] = odd.sum() >= 2


@numba.njit(cache=True, nogil=True)
def _crosses(corner, point, ray):  # type: ignore[no-untyped-def]
    """Whether a ray (3,) from a point (3,) crosses the triangle with corners (3, 3) (Moeller and Trumbore 1997)."""
    ux, uy, uz = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
    wx, wy, wz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
    x, y, z = ray[1] * wz - ray[2] * wy, ray[2] * wx - ray[0] * wz, ray[0] * wy - ray[1] * wx
    whole = ux * x + uy * y + uz * z
    if whole == 0.0:
        return False
    px, py, pz = point[0] - corner[0, 0], point[1] - corner[0, 1], point[2] - corner[0, 2]
    v = (px * x + py * y + pz * z) / whole
    x, y, z = py * uz - pz * uy, pz * ux - px * uz, px * uy - py * ux
    w = (ray[0] * x + ray[1] * y + ray[2] * z) / whole
    return v >= 0.0 and w >= 0.0 and v + w <= 1.0 and (wx * x + wy * y + wz * z) / whole > 0.0


@numba.njit(cache=True, nogil=True)
def mark_near(corners, distance, origin, cell, covered):  # type: ignore[no-untyped-def]
    """Mark in covered (i, j, k) the cells of size `cell` (m) from origin (3,) that the box of any triangle, corners
    (m, 3, 3), widened by `distance` (m), reaches.
    """
    first, last = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for n in range(len(corners)):
        another = False
        for d in range(3):
            low = min(corners[n, 0, d], corners[n, 1, d], corners[n, 2, d]) - distance
            high = max(corners[n, 0, d], corners[n, 1, d], corners[n, 2, d]) + distance
            begin = max(math.floor((low - origin[d]) / cell), 0)
            end = min(math.floor((high - origin[d]) / cell) + 1, covered.shape[d])
            another = another or begin != first[d] or end != last[d]
            first[d], last[d] = begin, end
        if not another:  # the same cells as those of the triangle before
            continue
        for i in range(first[0], last[0]):
            for j in range(first[1], last[1]):
                for k in range(first[2], last[2]):
                    covered[i, j, k] = True


@numba.njit(cache=True, nogil=True)
def draw(vertices, faces, pose, lens, u0, v0, step, nearest_drawn, out):  # type: ignore[no-untyped-def]
    """Put the least depths (m) of triangles faces (m, 3) of vertices (n, 3) at pose (4, 4) camera_from_mesh into out
    (h, w), where they are less: through pixels u0 + column * step, v0 + row * step; lens (fx, fy, cx, cy).

    A triangle with a corner nearer than `nearest_drawn` (m) to the camera's plane is looked for in the whole image. A
    ray meets a triangle when it passes its three edges on the same side; that and the inverse depth are linear in the
    pixel, so that of each row one run of pixels does.
    """
    fx, fy, cx, cy = lens
    height, width = out.shape
    at, place = np.zeros((len(vertices), 3)), np.zeros((len(vertices), 2))
    for n in range(len(vertices)):
        for d in range(3):
            turned = pose[d, 0] * vertices[n, 0] + pose[d, 1] * vertices[n, 1] + pose[d, 2] * vertices[n, 2]
            at[n, d] = turned + pose[d, 3]
        if at[n, 2] >= nearest_drawn:
            place[n, 0] = (fx * at[n, 0] / at[n, 2] + cx - u0) / step
            place[n, 1] = (fy * at[n, 1] / at[n, 2] + cy - v0) / step
    across, first = step / fx, (u0 - cx) / fx
    edges, turn = np.zeros((3, 3)), np.zeros(3)
    for n in range(len(faces)):
        i, j, k = faces[n]
        nearest_z, farthest_z = min(at[i, 2], at[j, 2], at[k, 2]), max(at[i, 2], at[j, 2], at[k, 2])
        top, bottom, left, far = 0, height, 0, width
        if nearest_z >= nearest_drawn:
            low, high = min(place[i, 0], place[j, 0], place[k, 0]), max(place[i, 0], place[j, 0], place[k, 0])
            above, below = min(place[i, 1], place[j, 1], place[k, 1]), max(place[i, 1], place[j, 1], place[k, 1])
            # compared before they are made whole: what is far beside the image is no whole number
            if not (high > -1.0 and low < width and below > -1.0 and above < height):
                continue
            left, far = int(max(math.ceil(low - SLACK), 0.0)), int(min(math.floor(high + SLACK) + 1.0, width))
            top, bottom = int(max(math.ceil(above - SLACK), 0.0)), int(min(math.floor(below + SLACK) + 1.0, height))
        if farthest_z <= 0.0 or far <= left or bottom <= top:
            continue
        edges[0, 0], edges[0, 1], edges[0, 2] = _across(at[i], at[j])
        edges[1, 0], edges[1, 1], edges[1, 2] = _across(at[j], at[k])
        edges[2, 0], edges[2, 1], edges[2, 2] = _across(at[k], at[i])
        # the plane's normal is the sum of the three, and its height any corner's
        a = edges[0, 0] + edges[1, 0] + edges[2, 0]
        b = edges[0, 1] + edges[1, 1] + edges[2, 1]
        c = edges[0, 2] + edges[1, 2] + edges[2, 2]
        plane = a * at[i, 0] + b * at[i, 1] + c * at[i, 2]
        if plane == 0.0:
            continue
        # where the triangle is ahead, all three have the plane's sign inside
        sign = 1.0 if plane > 0.0 else -1.0
        for e in range(3):
            slope = sign * edges[e, 0] * across
            turn[e] = 1.0 / slope if slope != 0.0 else 0.0
        for row in range(top, bottom):
            y = (v0 + row * step - cy) / fy
            begin, end = float(left), far - 1.0
            for e in range(3):
                beside = sign * (edges[e, 0] * first + edges[e, 1] * y + edges[e, 2])
                if turn[e] > 0.0:
                    begin = max(begin, math.ceil(-beside * turn[e] - SLACK))
                elif turn[e] < 0.0:
                    end = min(end, math.floor(-beside * turn[e] + SLACK))
                elif beside < 0.0:
                    end = -1.0
            # not true of NaN either
            if not begin <= end:
                continue
            for column in range(int(begin), int(end) + 1):
                inverse = (a * (first + column * across) + b * y + c) / plane
                if inverse > 0.0:
                    # of a triangle seen from its edge rounding knows no depth, its corners do
                    depth = min(max(1.0 / inverse, nearest_z), farthest_z)
                    out[row, column] = min(out[row, column], depth)


@numba.njit(cache=True, nogil=True, inline="always")
def _across(a, b):  # type: ignore[no-untyped-def]
    """Cross product of (3,) and (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
