"""Compiled loops over pixels: rays in a mesh's frame, hits made exact and merged into an image. Metres."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import fused


@numba.njit(cache=True, nogil=True)
def mesh_rays(fx, fy, cx, cy, u0, v0, origin, rotation, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w, 6) float32: origin (3,) and directions rotation (3, 3) @ ray of pixels from (u0, v0)."""
    for row in range(out.shape[0]):
        y = (v0 + row - cy) / fy
        for column in range(out.shape[1]):
            x = (u0 + column - cx) / fx
            for i in range(3):
                out[row, column, i] = origin[i]
                out[row, column, 3 + i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2]


@numba.njit(cache=True, nogil=True)
def _exact(x, y, origin, rotation, normals, offsets, largest, rough, triangle):  # type: ignore[no-untyped-def]
    """The z-depth of a hit, rough in single precision, from the plane of its triangle; see exact_hits."""
    slope = 0.0
    height = offsets[triangle]
    for i in range(3):
        direction = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2]
        slope += normals[triangle, i] * direction
        height -= normals[triangle, i] * origin[i]
    exact = height / slope if slope != 0.0 else 0.0
    return exact if abs(exact - rough) < largest else rough


@numba.njit(cache=True, nogil=True)
def exact_hits(fx, fy, cx, cy, u0, v0, origin, rotation, normals, offsets, largest, hits, triangles, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w) float64 with the z-depths of float32 hits (h, w), from the planes of the triangles hit; inf
    where nothing is. The correction is at most `largest`: beyond it the ray runs along its triangle.
    """
    for row in range(out.shape[0]):
        y = (v0 + row - cy) / fy
        for column in range(out.shape[1]):
            rough = np.float64(hits[row, column])
            if not math.isfinite(rough):
                out[row, column] = np.inf
                continue
            x = (u0 + column - cx) / fx
            planes = normals, offsets, largest
            out[row, column] = _exact(x, y, origin, rotation, *planes, rough, triangles[row, column])


@numba.njit(cache=True, nogil=True)
def pixels_about(fx, fy, cx, cy, pose, points, part, out):  # type: ignore[no-untyped-def]
    """How many pixels of part (u0, v0, u1, v1) a convex hull's points (n, 3), moved by pose (4, 4), may cover: those in
    the eight sides about the points and two pixels of room, all where there are no points; they are out (m, 2), row by
    row. All points are before the camera.
    """
    low, most, low_across, most_across = np.inf, -np.inf, np.inf, -np.inf
    for n in range(len(points)):
        p = points[n]
        z = p[0] * pose[2, 0] + p[1] * pose[2, 1] + p[2] * pose[2, 2] + pose[2, 3]
        u = fx * (p[0] * pose[0, 0] + p[1] * pose[0, 1] + p[2] * pose[0, 2] + pose[0, 3]) / z + cx
        v = fy * (p[0] * pose[1, 0] + p[1] * pose[1, 1] + p[2] * pose[1, 2] + pose[1, 3]) / z + cy
        low, most = min(low, u + v), max(most, u + v)
        low_across, most_across = min(low_across, u - v), max(most_across, u - v)
    if not len(points):
        low, most, low_across, most_across = -1e9, 1e9, -1e9, 1e9
    count = 0
    for v in range(part[1], part[3]):
        begin = max(part[0], math.floor(low) - 2 - v, math.floor(low_across) - 2 + v)
        end = min(part[2], math.ceil(most) + 3 - v, math.ceil(most_across) + 3 + v)
        for u in range(begin, end):
            out[count, 0], out[count, 1] = u, v
            count += 1
    return count


@numba.njit(cache=True, nogil=True)
def hit_pixels(fx, fy, cx, cy, origin, rotation, normals, offsets, largest, hits, triangles, pixels, own):  # type: ignore[no-untyped-def]
    """Of pixels (n, 2) those, put first, whose rays' float32 hits (n,) on triangles (n,) are any: how many. Their
    depths are own (n,), made exact as by exact_hits.
    """
    count = 0
    for n in range(len(hits)):
        if not math.isfinite(hits[n]):
            continue
        x, y = (pixels[n, 0] - cx) / fx, (pixels[n, 1] - cy) / fy
        own[count] = _exact(x, y, origin, rotation, normals, offsets, largest, np.float64(hits[n]), triangles[n])
        pixels[count, 0], pixels[count, 1] = pixels[n, 0], pixels[n, 1]
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def rays_at(fx, fy, cx, cy, pixels, region, origin, rotation, which, out):  # type: ignore[no-untyped-def]
    """How many of pixels (n, 2) are in a region (u0, v0, u1, v1): which (n,), and their rays (n, 6), as mesh_rays has
    them.
    """
    count = 0
    for n in range(len(pixels)):
        u, v = pixels[n]
        if not (region[0] <= u < region[2] and region[1] <= v < region[3]):
            continue
        x, y = (u - cx) / fx, (v - cy) / fy
        for i in range(3):
            out[count, i] = origin[i]
            out[count, 3 + i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2]
        which[count] = n
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def keep_seen(fx, fy, cx, cy, origin, rotation, normals, offsets, largest, hits, triangles, which, pixels, own):  # type: ignore[no-untyped-def]
    """Of pixels (n, 2) and own depths (n,) those, put first, that no nearer hit covers: how many. which (m,): pixels of
    float32 hits (m,) on triangles (m,), rising; the hits are made exact as by exact_hits.
    """
    count, k = 0, 0
    for n in range(len(own)):
        if k < len(which) and which[k] == n:
            rough = np.float64(hits[k])
            triangle = triangles[k]
            k += 1
            if math.isfinite(rough):
                x, y = (pixels[n, 0] - cx) / fx, (pixels[n, 1] - cy) / fy
                if own[n] > _exact(x, y, origin, rotation, normals, offsets, largest, rough, triangle):
                    continue
        own[count], pixels[count, 0], pixels[count, 1] = own[n], pixels[n, 0], pixels[n, 1]
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def keep_before(u0, v0, depth, pixels, own):  # type: ignore[no-untyped-def]
    """Of pixels (n, 2) and own depths (n,) those, put first, that depth (h, w), from (u0, v0) on, does not cover: how
    many.
    """
    count = 0
    for n in range(len(own)):
        row, column = pixels[n, 1] - v0, pixels[n, 0] - u0
        inside = 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]
        if inside and own[n] > depth[row, column]:
            continue
        own[count], pixels[count, 0], pixels[count, 1] = own[n], pixels[n, 0], pixels[n, 1]
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def box_of(fx, fy, cx, cy, pose, points):  # type: ignore[no-untyped-def]
    """What points (n, 3), moved by pose (4, 4), span in the image: least and most depth (m), least u, least v, most u,
    most v (px); of pixels those of the points before the camera.
    """
    low_z, high_z, low_u, low_v, high_u, high_v = np.inf, -np.inf, np.inf, np.inf, -np.inf, -np.inf
    for n in range(len(points)):
        p = points[n]
        z = fused(p[2], pose[2, 2], fused(p[1], pose[2, 1], p[0] * pose[2, 0])) + pose[2, 3]
        low_z, high_z = min(low_z, z), max(high_z, z)
        if z <= 0.0:
            continue
        x = fused(p[2], pose[0, 2], fused(p[1], pose[0, 1], p[0] * pose[0, 0])) + pose[0, 3]
        y = fused(p[2], pose[1, 2], fused(p[1], pose[1, 1], p[0] * pose[1, 0])) + pose[1, 3]
        u, v = fx * x / z + cx, fy * y / z + cy
        low_u, low_v, high_u, high_v = min(low_u, u), min(low_v, v), max(high_u, u), max(high_v, v)
    return low_z, high_z, low_u, low_v, high_u, high_v


@numba.njit(cache=True, nogil=True)
def merge(fx, fy, cx, cy, u0, v0, rotation, normals, index, found, triangles, depth, ids, seen_normals):  # type: ignore[no-untyped-def]
    """Where found (h, w) is nearer than depth (h, w): write depth, ids and the triangle's normal (h, w, 3), turned by
    rotation (3, 3) camera_from_mesh and to the camera. All are views of the same pixels.
    """
    for row in range(found.shape[0]):
        y = (v0 + row - cy) / fy
        for column in range(found.shape[1]):
            t = found[row, column]
            if not t < depth[row, column]:
                continue
            depth[row, column] = t
            ids[row, column] = index
            n = normals[triangles[row, column]]
            a = rotation[0, 0] * n[0] + rotation[0, 1] * n[1] + rotation[0, 2] * n[2]
            b = rotation[1, 0] * n[0] + rotation[1, 1] * n[1] + rotation[1, 2] * n[2]
            c = rotation[2, 0] * n[0] + rotation[2, 1] * n[1] + rotation[2, 2] * n[2]
            sign = -1.0 if a * (u0 + column - cx) / fx + b * y + c > 0.0 else 1.0
            seen_normals[row, column, 0] = sign * a
            seen_normals[row, column, 1] = sign * b
            seen_normals[row, column, 2] = sign * c


@numba.njit(cache=True, nogil=True)
def few_faces(fx, fy, cx, cy, u0, v0, corners, out, triangles):  # type: ignore[no-untyped-def]
    """Fill out (h, w) with z-depths, inf where nothing is, and triangles (h, w) with the nearest of a few triangles,
    corners (m, 3, 3) in the camera frame. A ray meets a triangle when it passes its three edges on the same side, and
    both that and the inverse depth are linear in the pixel.
    """
    sides, planes = np.zeros((len(corners), 3, 3)), np.zeros((len(corners), 3))
    for k in range(len(corners)):
        for i in range(3):
            sides[k, i] = np.cross(corners[k, i], corners[k, (i + 1) % 3])
        normal = np.cross(corners[k, 1] - corners[k, 0], corners[k, 2] - corners[k, 0])
        height = normal[0] * corners[k, 0, 0] + normal[1] * corners[k, 0, 1] + normal[2] * corners[k, 0, 2]
        if height != 0.0:
            planes[k] = normal / height
    for row in range(out.shape[0]):
        y = (v0 + row - cy) / fy
        for column in range(out.shape[1]):
            x = (u0 + column - cx) / fx
            best = 0.0
            for k in range(len(corners)):
                inverse = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
                if inverse <= best:
                    continue
                a = sides[k, 0, 0] * x + sides[k, 0, 1] * y + sides[k, 0, 2]
                b = sides[k, 1, 0] * x + sides[k, 1, 1] * y + sides[k, 1, 2]
                c = sides[k, 2, 0] * x + sides[k, 2, 1] * y + sides[k, 2, 2]
                if (a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0):
                    best = inverse
                    triangles[row, column] = k
            out[row, column] = 1.0 / best if best > 0.0 else np.inf


@numba.njit(cache=True, nogil=True)
def paint(ids, normals, table, toward, ambient, out):  # type: ignore[no-untyped-def]
    """Fill out (h, w, 3) uint8: colour table (k + 1, 3) of each id, the last one where nothing is seen, by how far the
    normal (h, w, 3) faces the lamp.
    """
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            index, light = ids[row, column], 1.0
            if index >= 0:
                n = normals[row, column]
                facing = n[0] * toward[0] + n[1] * toward[1] + n[2] * toward[2]
                light = ambient + (1.0 - ambient) * min(max(facing, 0.0), 1.0)
            else:
                index = len(table) - 1
            for i in range(3):
                out[row, column, i] = np.uint8(min(max(table[index, i] * light, 0.0), 255.0))
