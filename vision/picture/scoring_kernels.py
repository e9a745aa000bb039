"""What the rays of a predicted picture amount to, compiled: shares of its outline, and what they cost.

The twin in plain NumPy is in the tests. Camera frame, metres, pixels, nats.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import FUSED, LENT
from vision.picture.columns import (
    AGREE,
    BEHIND,
    BEHIND_HAND,
    DARK,
    ENDS,
    HIT,
    HITS,
    OUTLINE,
    PAST,
    SCATTER,
    SEEN,
    SIDES,
    UNREAD,
    WITHIN,
)

# Least share that nothing hides of which one is taken.
LEAST_OPEN = 0.05


@numba.njit(cache=True, nogil=True)
def share_out(step, inside, unread, sums, total, area):
    """Make shares of what the rays of each pose add up to, sums (n, SUMS), in place; fills total (n,): rays of which
    shares are taken, and area (n,): of the outline (px^2) that they tell of, what the image's border cuts off included.

    Where nothing is read little is known: surfaces that give no reading are the object's or not, so that this share of
    them, unread, is left out. What the image's border hides is hidden, too: the corner of an object tells little of it.
    step (n, 4), inside (n,): as of outline_rays.
    """
    for n in range(sums.shape[0]):
        seen = max(inside[n], 1e-3)
        total[n] = max(sums[n, HITS] - unread * sums[n, UNREAD], 1.0) / seen
        for k in (SEEN, AGREE, PAST, BEHIND, BEHIND_HAND):
            sums[n, k] /= total[n]
        sums[n, BEHIND] += 1.0 - inside[n]
        # of the whole outline's border: a corner that reaches into the image ends there, and shows little of it
        for k in (OUTLINE, SIDES, WITHIN, ENDS, DARK):
            sums[n, k] *= inside[n]
        area[n] = total[n] * cell_of(step[n])


@numba.njit(cache=True, nogil=True, **LENT)
def cost_of_shares(poses, centroid, shares, beyond, area, outline, nats, cells, out):
    """Fill out (n,) with what poses (n, 4, 4) cost by shares (n, SUMS), and beyond (n,): of what is seen, on what goes
    on beyond the outline.

    An outline counts by its area (n,) (px^2) beside the object's from a usual side at its distance, and beside what as
    many cells need: shares alone would have a can's end that nothing hides tell as much as its side of which a hand
    hides a third. outline: that usual area at a distance of a metre. nats: see PictureScore.nats. cells: of a whole
    outline, pixels (px^2) that one has at least, and the least share of them that a small outline amounts to.
    """
    seen, most_seen, goes_on, past, past_open, hidden, runs_on, within, most_within, ends, dark, scatter, by_size = nats
    count, pixels, least = cells
    for n in range(poses.shape[0]):
        if not shares[n, HITS] > 0.0:
            # an object that is nowhere in the image is hidden by the image's border
            out[n] = hidden
            continue
        z = poses[n, 2, 3]
        for i in range(3):
            z += poses[n, 2, i] * centroid[i]
        usual = outline / max(z, 1e-3) ** 2
        size = min(max(area[n] / max(usual, count * pixels), least), 1.0)
        open_to_view = max(1.0 - shares[n, BEHIND] - shares[n, BEHIND_HAND], LEAST_OPEN)
        against = (past + past_open / open_to_view) * shares[n, PAST] + hidden * shares[n, BEHIND] + goes_on * beyond[n]
        agreeing = seen * min(shares[n, SEEN], most_seen) - scatter * shares[n, AGREE] * shares[n, SCATTER]
        border = ends * shares[n, ENDS] + dark * shares[n, DARK] - runs_on * shares[n, OUTLINE]
        border -= min(within * shares[n, WITHIN], most_within)
        out[n] = size**by_size * (against - agreeing - border)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def part_pieces(pieces, apart, sizes, u, v, step, fade, state, total, beside, beyond):
    """Fill beyond (n,): the share of the rays that are seen on parts of one colour that go on beyond the outline, each
    as far as it does.

    pieces (h, w) at every `apart` pixels, from 0, -1 for none; sizes (m,): pixels of the first m, those of one colour.
    u, v (n, side^2), step (n, 4): of outline_rays; fade, state (n side^2,): of compare_pixels. total (n,): rays of
    which shares are taken. beside: see of_parts.
    """
    words = np.zeros((2, sizes.shape[0]))
    for n in range(u.shape[0]):
        words[:] = 0.0
        for at in range(u.shape[1]):
            k = n * u.shape[1] + at
            if not state[k] & HIT:
                continue
            row = min(max(v[n, at] // apart, 0), pieces.shape[0] - 1)
            label = pieces[row, min(max(u[n, at] // apart, 0), pieces.shape[1] - 1)]
            if 0 <= label < sizes.shape[0]:
                words[0, label] += fade[k]
                words[1, label] += 1.0
        beyond[n] = of_parts(words, sizes, total[n], cell_of(step[n]), beside)


@numba.njit(cache=True, nogil=True, **LENT)
def cell_of(step):
    """Pixels (px^2) that each ray of a grid stands for; step (4,): see outline_rays."""
    return abs(step[0] * step[3] - step[1] * step[2])


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def of_parts(words, sizes, total, area, beside):
    """The share of all rays that are seen on parts that go on beyond the outline: of each as large a share as it has
    beyond what the outline holds, and no more than is seen of it.

    words (2, m): how well the rays on each part agree, and how many there are. area: pixels (px^2) that each ray stands
    for. beside: share of a part that may be beside the outline. All else as of part_pieces.
    """
    lost = 0.0
    for label in range(sizes.shape[0]):
        outside = max((1.0 - beside) * sizes[label] - words[1, label] * area, 0.0) / max(total * area, 1.0)
        lost += min(outside, words[0, label] / total)
    return lost


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def scatter_of(count, total, squares):
    """Standard deviation of `count` numbers of this sum and sum of squares; 0 of none."""
    mean = total / max(count, 1.0)
    return math.sqrt(max(squares / max(count, 1.0) - mean * mean, 0.0))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, **LENT)
def share_beneath(points, floors, poses, own, margin, sigmas, out):
    """Fill out (n,) with the share of points (k, 3), object frame, that are under one of floors (m, 6) at poses
    (n, 4, 4), the largest of all floors; own (n,): noise (m) of readings there. See vision.picture.floor.beneath.
    """
    for n in range(poses.shape[0]):
        most = 0
        r = poses[n]
        for f in range(floors.shape[0]):
            a, b, c, scatter = floors[f, 0], floors[f, 1], floors[f, 2], floors[f, 4]
            x = a * r[0, 0] + b * r[1, 0] + c * r[2, 0]
            y = a * r[0, 1] + b * r[1, 1] + c * r[2, 1]
            z = a * r[0, 2] + b * r[1, 2] + c * r[2, 2]
            ratio = margin / sigmas
            room = max(margin + sigmas * own[n], sigmas * scatter * math.sqrt(own[n] * own[n] + ratio * ratio))
            lowest = -room - (a * r[0, 3] + b * r[1, 3] + c * r[2, 3] + floors[f, 3])
            under = 0
            for k in range(points.shape[0]):
                under += x * points[k, 0] + y * points[k, 1] + z * points[k, 2] < lowest
            most = max(most, under)
        out[n] = most / points.shape[0]
