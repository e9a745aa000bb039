"""Compiled loops: swinging light from surface to surface, into pixels, and distance out of its phases. Metres."""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.synthesis.optics.light.light_kernels import no_spots, spotted


@numba.njit(cache=True, nogil=True)
def gather(first, last, points, normals, senders, sender_normals, areas, sent, waves, out):  # type: ignore[no-untyped-def]
    """Fill rows first to last of out (n, f) complex: light that patches send to points (n, 3) with unit normals (n, 3).

    senders (k, 3), their unit normals (k, 3), areas (k,) m^2 and light sent (k, f) complex (radiosity); waves (f,): rad
    a metre of way. Each patch counts as a disc of its area: cos cos A / (pi r^2 + A), which stays finite where patches
    meet. Whether something stands between is not asked.
    """
    count = len(waves)
    for p in range(first, last):
        for q in range(len(senders)):
            dx, dy, dz = senders[q, 0] - points[p, 0], senders[q, 1] - points[p, 1], senders[q, 2] - points[p, 2]
            here = normals[p, 0] * dx + normals[p, 1] * dy + normals[p, 2] * dz
            if here <= 0.0:
                continue
            there = -(sender_normals[q, 0] * dx + sender_normals[q, 1] * dy + sender_normals[q, 2] * dz)
            if there <= 0.0:
                continue
            square = dx * dx + dy * dy + dz * dz
            if square < 1e-12:
                continue
            way = math.sqrt(square)
            share = here * there / square * areas[q] / (math.pi * square + areas[q])
            for f in range(count):
                turn = waves[f] * way
                swing = complex(math.cos(turn), -math.sin(turn))
                out[p, f] += share * swing * sent[q, f]


@numba.njit(cache=True, nogil=True)
def phasors(  # type: ignore[no-untyped-def]
    first, last, samples, lens, depth, ids, normals, materials, meshes, waves, step, near_ids, near_normals, near_depth,
    detoured, ambient, swing_out, steady_out,
):  # fmt: skip
    """Fill rows first to last of swing_out (h, w, f) complex and steady_out (h, w): light of a lamp at the lens.

    depth, ids, normals, lens, materials, meshes as of pattern_light; waves (f,): rad a metre of way. near_* (r, c, ...)
    and detoured (r, c, f) complex: surfaces at every `step`-th ray from step // 2 on, and the light that comes to them
    by way of others, over that which would come straight at their distance.
    """
    images, near = (depth, ids, normals, materials, meshes), (near_ids, near_normals, near_depth, detoured)
    room = no_spots(), np.zeros(len(waves), dtype=np.complex128)
    _phasor_rows(first, last, samples, lens, images, waves, step, near, ambient, room, swing_out, steady_out)


@numba.njit(cache=True, nogil=True, **LENT)
def _phasor_rows(first, last, samples, lens, images, waves, step, near, ambient, room, swing_out, steady_out):  # type: ignore[no-untyped-def]
    """As phasors, which has room for `spotted` (2, 11) and for sums (f,) complex."""
    depth, ids, normals, materials, meshes = images
    near_ids, near_normals, near_depth, detoured = near
    kept, total = room
    share = 1.0 / (samples * samples)
    count = len(waves)
    for row in range(first, last):
        for column in range(swing_out.shape[1]):
            for v in range(row * samples, (row + 1) * samples):
                ry = (v - lens[3]) / lens[1]
                for u in range(column * samples, (column + 1) * samples):
                    index = ids[v, u]
                    if index < 0:
                        continue
                    z = np.float64(depth[v, u])
                    rx = (u - lens[2]) / lens[0]
                    x, y = rx * z, ry * z
                    far = math.sqrt(x * x + y * y + z * z)
                    nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
                    cosine = max(-(nx * x + ny * y + nz * z) / far, 0.0)
                    material = materials[index]
                    albedo = spotted(material, meshes[index], kept, x, y, z)
                    shine = 0.0
                    if material[3] > 0.0:
                        shine = material[3] * (material[4] + 8.0) / 8.0 * cosine ** material[4]
                    straight = cosine * (albedo + shine) / (far * far)
                    steady_out[row, column] += share * (straight + ambient * albedo)
                    weight = 0.0
                    for f in range(count):
                        total[f] = 0.0
                    if detoured.shape[2] == count:
                        a, b = (v - step // 2) / step, (u - step // 2) / step
                        i0, j0 = math.floor(a), math.floor(b)
                        for i in range(max(i0, 0), min(i0 + 2, near_ids.shape[0])):
                            for j in range(max(j0, 0), min(j0 + 2, near_ids.shape[1])):
                                if near_ids[i, j] != index:
                                    continue
                                m = near_normals[i, j]
                                alike = m[0] * nx + m[1] * ny + m[2] * nz
                                if alike < 0.7 or abs(near_depth[i, j] - z) > 0.05 * z:
                                    continue
                                w = (1.0 - abs(a - i)) * (1.0 - abs(b - j)) * alike**8 + 1e-6
                                weight += w
                                for f in range(count):
                                    total[f] += w * detoured[i, j, f]
                    for f in range(count):
                        turn = 2.0 * waves[f] * far
                        swing = complex(math.cos(turn), -math.sin(turn))
                        light = complex(straight, 0.0)
                        if weight > 0.0:
                            light += albedo * total[f] / weight / (far * far)
                        swing_out[row, column, f] += share * light * swing


@numba.njit(cache=True, nogil=True)
def distances(first, last, swings, keep, waves, farthest, disagreement, out):  # type: ignore[no-untyped-def]
    """Fill rows first to last of out (h, w) with half the way of light from measured swings (h, w, f) complex, 0 where
    keep (h, w) is false or the frequencies disagree by more than `disagreement` (m, root mean square).

    The phase of the first frequency leaves whole turns open: those are taken at which the others agree best. Distances
    are averaged with weights wave^2 amplitude^2, which is one over their variance.
    """
    room = np.zeros((2, len(waves)))
    _distance_rows(first, last, swings, keep, waves, farthest, disagreement, room, out)


@numba.njit(cache=True, nogil=True, **LENT)
def _distance_rows(first, last, swings, keep, waves, farthest, disagreement, room, out):  # type: ignore[no-untyped-def]
    """As distances, which has room (2, f)."""
    count = len(waves)
    phase, weight = room[0], room[1]
    for row in range(first, last):
        for column in range(out.shape[1]):
            if not keep[row, column]:
                continue
            power = 0.0
            for f in range(count):
                swing = swings[row, column, f]
                phase[f] = -math.atan2(swing.imag, swing.real)
                weight[f] = waves[f] ** 2 * (swing.real**2 + swing.imag**2)
                power += weight[f]
            best, least = 0.0, np.inf
            if power <= 0.0:
                continue
            turns = int(farthest * waves[0] / math.pi) + 1
            for k in range(turns + 1):
                guess = (phase[0] + 2.0 * math.pi * k) / (2.0 * waves[0])
                if guess <= 0.0 or guess > farthest:
                    continue
                mean, square = 0.0, 0.0
                for f in range(count):
                    off = phase[f] - 2.0 * waves[f] * guess
                    off -= 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5)
                    off /= 2.0 * waves[f]
                    mean += weight[f] * off / power
                    square += weight[f] * off * off / power
                if square - mean * mean < least:
                    least, best = square - mean * mean, guess + mean
            if best > 0.0 and least <= disagreement**2:
                out[row, column] = best
