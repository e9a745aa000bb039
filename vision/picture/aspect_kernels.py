"""The compiled look at poses by an object's aspects: points are projected and compared, no ray is cast.

What each point is, and what they add up to, is as of rays (vision.picture.kernels). Camera frame, metres, pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING
from vision.picture.columns import (
    AGREE,
    BEHIND,
    BEHIND_HAND,
    BY_HAND,
    DARK,
    ENDS,
    HIDDEN,
    HIT,
    HITS,
    NEAR,
    OUTLINE,
    PAST,
    SCATTER,
    SEEN,
    UNREAD,
    WITHIN,
)
from vision.picture.kernels import NEAREST, ends_at, leads_to, smooth_sigma, what_is
from vision.picture.scoring_kernels import of_parts, scatter_of


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def aspect_at(cells, x, y, z):
    """Which of 6 cells^2 directions (x, y, z), of any length, is nearest to, the first for none; see
    vision.picture.aspects.directions.
    """
    face, a, b, c = 0, x, y, z
    if abs(y) > abs(a) and abs(y) >= abs(z):
        face, a, b, c = 2, y, z, x
    elif abs(z) > abs(x):
        face, a, b, c = 4, z, x, y
    if not abs(a) > 0.0:
        return 0  # from its own centroid an object shows nothing: any will do
    half = 0.5 * cells
    i = int(half * (1.0 + math.atan(b / abs(a)) * (4.0 / math.pi)))
    j = int(half * (1.0 + math.atan(c / abs(a)) * (4.0 / math.pi)))
    return ((face + (a < 0.0)) * cells + min(i, cells - 1)) * cells + min(j, cells - 1)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always", **LENT)
def aspect_of(cells, centroid, r, t):
    """Which of 6 cells^2 directions an object at a pose, r (4, 4) with translation t (3,), is seen from, and the depth
    (m) of its centroid (3,), which is in the object's frame.
    """
    # the camera as the centroid sees it
    x, y, z = t[0], t[1], t[2]
    for i in range(3):
        x += r[0, i] * centroid[i]
        y += r[1, i] * centroid[i]
        z += r[2, i] * centroid[i]
    which = aspect_at(
        cells,
        -(r[0, 0] * x + r[1, 0] * y + r[2, 0] * z),
        -(r[0, 1] * x + r[1, 1] * y + r[2, 1] * z),
        -(r[0, 2] * x + r[1, 2] * y + r[2, 2] * z),
    )
    return which, z


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def sum_aspects(aspects, cells, centroid, poses, image, camera, noise, limits, running, parts, work, words, told):
    """What the points that the object shows at poses (n, 4, 4) add up to: fills told, that is sums (n, SUMS), in
    shares, and beyond and area (n,), as share_out and part_pieces of vision.picture.scoring_kernels do.

    aspects: points, near, count, cell of Aspects from 6 cells^2 directions around centroid (3,). image, camera, noise,
    limits: of compare_pixels. running: smooth (m), its share of depth, reach of an edge (px), and the share of points
    without a reading that is left out. parts: pieces, step, sizes and beside of part_pieces. work: seen, fade (m,),
    state (m,), column and row (m,) to work in, words (2, k): of as many parts.
    """
    points, near, count, cell = aspects
    depth = image[0]
    fx, fy, cx, cy, width, height = camera
    smooth, smooth_share, reach, unread = running
    plane_margin, plane_sigmas = limits[6], limits[7]
    pieces, piece_step, sizes, off_outline = parts
    seen, fade, state, column, row = work
    sums, beyond, area = told
    for n in range(poses.shape[0]):
        r, t = poses[n], poses[n, :3, 3]
        which, z = aspect_of(cells, centroid, r, t)
        distance, ahead, inside = z, z > NEAREST, 0
        out = sums[n]
        out[:] = 0.0
        agreeing = total_off = squares = 0.0
        for k in range(count[which]):
            px, py, pz = (
                np.float64(points[which, k, 0]),
                np.float64(points[which, k, 1]),
                np.float64(points[which, k, 2]),
            )
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            if not z > NEAREST:
                ahead = False
                break
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            # beyond these it is far outside of any image
            u = int(np.rint(min(max(fx * x / z + cx, -width), 2.0 * width)))
            v = int(np.rint(min(max(fy * y / z + cy, -width), 2.0 * width)))
            column[k], row[k] = u, v
            seen[k] = fade[k] = 0.0
            state[k] = 0
            if not (0 <= u < width and 0 <= v < height):
                continue
            inside += 1
            reading = np.float64(depth[v, u])
            out[HITS] += 1.0
            if not 0.0 < reading < FARTHEST_READING:
                state[k] = HIT
                out[UNREAD] += 1.0
                continue
            seen[k] = reading
            bits, past, agrees = what_is(image, camera, noise, limits, u, v, reading, z)
            state[k], fade[k] = bits, agrees
            out[SEEN] += agrees
            out[PAST] += past
            if bits & NEAR:
                out[AGREE] += 1.0
                off = (reading - z) / smooth_sigma(noise, z)
                agreeing, total_off, squares = agreeing + 1.0, total_off + off, squares + off * off
            elif bits & HIDDEN:
                out[BEHIND] += 1.0
            elif bits & BY_HAND:
                out[BEHIND_HAND] += 1.0
        if not ahead:
            out[:] = 0.0
            beyond[n] = area[n] = 0.0
            continue
        edges = goes_on = within = ends = dark = 0
        for k in range(count[which]):
            if not state[k] & HIT:
                continue
            for way in range(4):
                beside = near[which, k, way]
                inner = beside >= 0 and (state[beside] & HIT) > 0
                edges += not inner
                back = near[which, k, (way + 2) % 4]
                if back < 0 or not state[k] & NEAR:
                    continue
                if not inner:
                    du, dv = column[k] - column[back], row[k] - row[back]
                    more = 1.0 + 0.5 * reach / max(math.sqrt(float(du * du + dv * dv)), 1.0)
                    i, j = int(np.rint(column[k] + more * du)), int(np.rint(row[k] + more * dv))
                    end = ends_at(depth, i, j, seen[k], 2.0 * (smooth + smooth_share * seen[k]))
                    ends, dark = ends + (end == ENDS), dark + (end == DARK)
                if not state[back] & NEAR:
                    continue
                slope = seen[k] - seen[back]
                room = smooth + smooth_share * seen[k]
                if inner:
                    within += (state[beside] & HIDDEN) > 0 and abs(seen[beside] - seen[k] - slope) < room
                    continue
                # where the next point would be, and one so far on that no smeared edge reaches it
                du, dv = column[k] - column[back], row[k] - row[back]
                i, j = column[k] + du, row[k] + dv
                lead = seen[k] + slope
                if not (0 <= i < width and 0 <= j < height) or not abs(np.float64(depth[j, i]) - lead) < room:
                    continue
                length = max(math.sqrt(float(du * du + dv * dv)), 1.0)
                on = reach / length
                i, j = int(np.rint(i + on * du)), int(np.rint(j + on * dv))
                lead += slope * on
                goes_on += leads_to(image, camera, noise, i, j, lead, room, plane_margin, plane_sigmas)
        out[OUTLINE] = goes_on / max(edges, 1)
        out[WITHIN] = within / max(edges, 1)
        out[ENDS], out[DARK] = ends / max(edges, 1), dark / max(edges, 1)
        out[SCATTER] = scatter_of(agreeing, total_off, squares)
        share = inside / max(count[which], 1)
        total = max(out[HITS] - unread * out[UNREAD], 1.0) / max(share, 1e-3)
        each = cell[which] * fx * fy / (distance * distance)
        area[n] = total * each
        beyond[n] = 0.0
        if sizes.shape[0] > 0:
            words[:] = 0.0
            for k in range(count[which]):
                if not state[k] & HIT:
                    continue
                label = pieces[row[k] // piece_step, column[k] // piece_step]
                if 0 <= label < sizes.shape[0]:
                    words[0, label] += fade[k]
                    words[1, label] += 1.0
            beyond[n] = of_parts(words, sizes, total, each, off_outline)
        for i in (SEEN, AGREE, PAST, BEHIND, BEHIND_HAND):
            out[i] /= total
        out[BEHIND] += 1.0 - share
        for i in (OUTLINE, WITHIN, ENDS, DARK):
            out[i] *= share
