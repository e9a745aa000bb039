"""Compiled loops over pixels: rays in a mesh's frame, hits made exact and merged into an image. Metres."""

from __future__ import annotations

import math

import numba
import numpy as np


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
            triangle = triangles[row, column]
            slope = 0.0
            height = offsets[triangle]
            for i in range(3):
                direction = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2]
                slope += normals[triangle, i] * direction
                height -= normals[triangle, i] * origin[i]
            exact = height / slope if slope != 0.0 else 0.0
            out[row, column] = exact if abs(exact - rough) < largest else rough


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
