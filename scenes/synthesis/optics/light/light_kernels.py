"""Compiled loops over pixels: light that a lit scene sends to a camera. Camera frame, metres."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT


@numba.njit(cache=True, nogil=True, inline="always")
def _random(i, j, k):  # type: ignore[no-untyped-def]
    """A number from -1 to 1 that belongs to lattice point (i, j, k): integer mixing, the same on every machine."""
    h = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    h = (h ^ (h >> 13)) & 0xFFFFFFFF
    h = (h * 1274126177) & 0xFFFFFFFF
    h = (h ^ (h >> 16)) & 0xFFFFFFFF
    h = (h * 668265263) & 0xFFFFFFFF
    return ((h ^ (h >> 15)) & 0xFFFF) / 32767.5 - 1.0


@numba.njit(cache=True, nogil=True, **LENT)
def _spots(x, y, z, kept):  # type: ignore[no-untyped-def]
    """Trilinear interpolation of random numbers on the integer lattice, standard deviation about 0.3; kept (11,): the
    cell asked for last, NaN at first, and its eight numbers, for the next point is mostly in the same.
    """
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    a, b, c = x - i, y - j, z - k
    i, j, k = int(i), int(j), int(k)
    if kept[0] != i or kept[1] != j or kept[2] != k:
        kept[0], kept[1], kept[2] = i, j, k
        for di in range(2):
            for dj in range(2):
                for dk in range(2):
                    kept[3 + 4 * di + 2 * dj + dk] = _random(i + di, j + dj, k + dk)
    total = 0.0
    for di in range(2):
        wa = a if di else 1.0 - a
        for dj in range(2):
            wb = wa * (b if dj else 1.0 - b)
            for dk in range(2):
                total += wb * (c if dk else 1.0 - c) * kept[3 + 4 * di + 2 * dj + dk]
    return total


@numba.njit(cache=True, nogil=True)
def reflectance(material, mesh_from_camera, x, y, z):  # type: ignore[no-untyped-def]
    """Albedo of a material (albedo, texture, grain, ...) at a camera-frame point, textured in its mesh's frame (3, 4):
    spots of the grain's size and of four times that, the coarse ones as strong as the fine.
    """
    return spotted(material, mesh_from_camera, no_spots(), x, y, z)


@numba.njit(cache=True, nogil=True)
def no_spots():  # type: ignore[no-untyped-def]
    """(2, 11) what `spotted` keeps from point to point, before the first."""
    return np.full((2, 11), np.nan)


@numba.njit(cache=True, nogil=True, **LENT)
def spotted(material, mesh_from_camera, kept, x, y, z):  # type: ignore[no-untyped-def]
    """As `reflectance`; kept (2, 11): of fine and coarse spots, see _spots."""
    albedo = material[0]
    if material[1] <= 0.0:
        return albedo
    m, pitch = mesh_from_camera, 1.0 / max(material[2], 1e-4)
    p = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) * pitch
    q = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) * pitch
    r = (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]) * pitch
    spots = _spots(p, q, r, kept[0]) + _spots(0.25 * p + 0.5, 0.25 * q + 0.5, 0.25 * r + 0.5, kept[1])
    return min(max(albedo * (1.0 + 2.4 * material[1] * spots), 0.02), 0.98)


@numba.njit(cache=True, nogil=True, **LENT)
def _texel(image, column, row):  # type: ignore[no-untyped-def]
    """Bilinear value of image (h, w), 0 outside."""
    if not (0.0 <= column < image.shape[1] - 1 and 0.0 <= row < image.shape[0] - 1):
        return 0.0
    i, j = int(row), int(column)
    a, b = row - i, column - j
    above = (1.0 - b) * image[i, j] + b * image[i, j + 1]
    below = (1.0 - b) * image[i + 1, j] + b * image[i + 1, j + 1]
    return (1.0 - a) * above + a * below


@numba.njit(cache=True, nogil=True, **LENT)
def _lit(shadow, column, row, z, slack):  # type: ignore[no-untyped-def]
    """Whether a point of depth z before the projector is no deeper than what it sees around there (0: nothing)."""
    if not (0.0 <= column < shadow.shape[1] - 1 and 0.0 <= row < shadow.shape[0] - 1):
        return True
    i, j = int(row), int(column)
    for a in range(2):
        for b in range(2):
            seen = shadow[i + a, j + b]
            if seen <= 0.0 or z <= seen + slack:
                return True
    return False


@numba.njit(cache=True, nogil=True)
def pattern_light(  # type: ignore[no-untyped-def]
    first, last, samples, lens, depth, ids, normals, materials, meshes, projector, light, light_lens, shadow,
    shadow_lens, slack, ambient, lamp_share, lamp, laser_out, room_out,
):  # fmt: skip
    """Fill rows first to last of laser_out and room_out (h, w) with the light of projector and room.

    depth, ids (s h, s w) and normals (s h, s w, 3) of s * s rays a pixel, lens (fx, fy, cx, cy) of those rays;
    materials (k, 5), meshes (k, 3, 4) mesh_from_camera; projector (3, 4) projector_from_camera; light: its pattern,
    light_lens (scale, cx, cy); shadow: depth that it sees, shadow_lens (f, cx, cy), slack (m); lamp (3,) unit, towards
    the room's lamp.
    """
    images, shadows = (depth, ids, normals, materials, meshes), (shadow, shadow_lens, slack)
    lights = (projector, light, light_lens, ambient, lamp_share, lamp)
    _light_rows(first, last, samples, lens, images, lights, shadows, no_spots(), laser_out, room_out)


@numba.njit(cache=True, nogil=True, **LENT)
def _light_rows(first, last, samples, lens, images, lights, shadows, kept, laser_out, room_out):  # type: ignore[no-untyped-def]
    """As pattern_light, which has room (2, 11) for `spotted`: what allocates nothing need not count who holds it."""
    depth, ids, normals, materials, meshes = images
    projector, light, light_lens, ambient, lamp_share, lamp = lights
    shadow, shadow_lens, slack = shadows
    share = 1.0 / (samples * samples)
    ox = -(projector[0, 0] * projector[0, 3] + projector[1, 0] * projector[1, 3] + projector[2, 0] * projector[2, 3])
    oy = -(projector[0, 1] * projector[0, 3] + projector[1, 1] * projector[1, 3] + projector[2, 1] * projector[2, 3])
    oz = -(projector[0, 2] * projector[0, 3] + projector[1, 2] * projector[1, 3] + projector[2, 2] * projector[2, 3])
    for row in range(first, last):
        for column in range(laser_out.shape[1]):
            laser, room = 0.0, 0.0
            for v in range(row * samples, (row + 1) * samples):
                ry = (v - lens[3]) / lens[1]
                for u in range(column * samples, (column + 1) * samples):
                    index = ids[v, u]
                    if index < 0:
                        continue
                    z = np.float64(depth[v, u])
                    rx = (u - lens[2]) / lens[0]
                    x, y = rx * z, ry * z
                    nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
                    material = materials[index]
                    gloss, sharpness = materials[index, 3], materials[index, 4]
                    albedo = spotted(material, meshes[index], kept, x, y, z)
                    far = math.sqrt(x * x + y * y + z * z)
                    # the room: even light, and one lamp with its gloss
                    facing = max(nx * lamp[0] + ny * lamp[1] + nz * lamp[2], 0.0)
                    vx, vy, vz = -x / far, -y / far, -z / far
                    shine = _shine(gloss, sharpness, nx, ny, nz, lamp[0], lamp[1], lamp[2], vx, vy, vz)
                    room += ambient * ((1.0 - lamp_share) * albedo + lamp_share * facing * (albedo + shine))
                    # the projector
                    lx, ly, lz = ox - x, oy - y, oz - z
                    away = math.sqrt(lx * lx + ly * ly + lz * lz)
                    if away < 1e-6:
                        continue
                    lx, ly, lz = lx / away, ly / away, lz / away
                    cosine = nx * lx + ny * ly + nz * lz
                    if cosine <= 0.0:
                        continue
                    p = projector
                    pz = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
                    if pz <= 1e-3:
                        continue
                    a = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / pz
                    b = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / pz
                    f = shadow_lens[0]
                    if not _lit(shadow, f * a + shadow_lens[1], f * b + shadow_lens[2], pz, slack):
                        continue
                    dots = _texel(light, light_lens[0] * a + light_lens[1], light_lens[0] * b + light_lens[2])
                    shine = _shine(gloss, sharpness, nx, ny, nz, lx, ly, lz, vx, vy, vz)
                    laser += dots * cosine * (albedo + shine) / (away * away)
            laser_out[row, column] = laser * share
            room_out[row, column] = room * share


@numba.njit(cache=True, nogil=True, **LENT)
def _shine(gloss, sharpness, nx, ny, nz, lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """Blinn-Phong lobe of a material for unit directions to the lamp l and to the camera v, on an albedo's scale."""
    if gloss <= 0.0:
        return 0.0
    hx, hy, hz = lx + vx, ly + vy, lz + vz
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    if length < 1e-9:
        return 0.0
    cosine = (nx * hx + ny * hy + nz * hz) / length
    if cosine <= 0.0:
        return 0.0
    return gloss * (sharpness + 8.0) / 8.0 * cosine**sharpness
